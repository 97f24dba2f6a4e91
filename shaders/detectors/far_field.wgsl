// Far field: flux over directions. num_x bins of the azimuth, num_y of the polar angle; cell (theta, phi) in C order.

const HALF_TURN: real = 3.141592653589793;

fn record_far_field(ray: Ray, detector: Detector, ends: bool) {
    let d = to_detector(detector, ray.direction);
    // The angle from the tangent: acos of a cosine near 1 would lose half the digits. Both hemispheres fold into one.
    let theta = atan2_real(sqrt(d.x * d.x + d.y * d.y), abs(d.z));
    let phi = atan2_real(d.y, d.x);
    let i_theta = pixel_of(theta, 0.0, detector.pitch_y, detector.num_y);
    let i_phi = pixel_of(phi, HALF_TURN, detector.pitch_x, detector.num_x);
    let cell = detector.cell + i_theta * detector.num_x + i_phi;
    deposit_arrival(cell, ray.weight, ends);
    add_cell_moment(ray.weight, detector, cell);
}
