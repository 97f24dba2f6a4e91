// Irradiance: flux over a rectangle of pixels.

fn record_irradiance(ray: Ray, sensor: Sensor, ends: bool) {
    splat_pixels(ray, sensor, local_position(ray, sensor), sensor.cell, 1u, ends);
}
