// Far field over the whole sphere. The directions forwards have a far field, and behind it lies another one of the
// directions backwards. There the polar angle is counted from the backward axis.

fn record_far_field_sphere(ray: Ray, detector: Detector, ends: bool) {
    var own = detector;
    if to_detector(detector, ray.direction).z < 0.0 {
        own.cell += detector.num_x * detector.num_y;
    }
    record_far_field(ray, own, ends);
}
