// Ray database: every ray that crosses.

fn record_ray_database(ray: Ray, detector: Detector, index: u32, ends: bool) {
    deposit_arrival(detector.cell, ray.weight, ends);
    add_cell_moment(ray.weight, detector, detector.cell);
    append_event(ray, EVENT_RECORDED, index);
}
