// Far field: flux over directions. num_x bins of the azimuth, num_y of the polar angle; cell (theta, phi) in C order.

const HALF_TURN: real = 3.141592653589793;

fn record_far_field(ray: Ray, sensor: Sensor, ends: bool) {
    let d = to_sensor(sensor, ray.direction);
    // The angle from the tangent: acos of a cosine near 1 would lose half the digits. Both hemispheres fold into one.
    let theta = atan2_real(sqrt(d.x * d.x + d.y * d.y), abs(d.z));
    let phi = atan2_real(d.y, d.x);
    let i_theta = pixel_of(theta, 0.0, sensor.pitch_y, sensor.num_y);
    let i_phi = pixel_of(phi, HALF_TURN, sensor.pitch_x, sensor.num_x);
    let cell = sensor.cell + i_theta * sensor.num_x + i_phi;
    book_arrival(cell, ray.weight, ends);
    add_cell_moment(ray.weight, sensor, cell);
}
