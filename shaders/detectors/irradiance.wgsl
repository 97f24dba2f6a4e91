// Irradiance: flux over a rectangle of pixels.

fn record_irradiance(ray: Ray, detector: Detector, ends: bool) {
    splat_pixels(ray, detector, local_position(ray, detector), detector.cell, 1u, ends);
}
