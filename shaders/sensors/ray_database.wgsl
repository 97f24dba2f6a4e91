// Ray database: every ray that crosses.

fn record_ray_database(ray: Ray, sensor: Sensor, index: u32) {
    book(sensor.cell, ray.weight);
    add_cell_moment(ray.weight, sensor, sensor.cell);
    append_event(ray, EVENT_RECORDED, index);
}
