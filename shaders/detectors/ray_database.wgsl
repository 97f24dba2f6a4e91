// Ray database: every ray that crosses.

fn record_ray_database(ray: Ray, sensor: Sensor, index: u32, ends: bool) {
    book_arrival(sensor.cell, ray.weight, ends);
    add_cell_moment(ray.weight, sensor, sensor.cell);
    append_event(ray, EVENT_RECORDED, index);
}
