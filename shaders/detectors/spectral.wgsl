// Spectral: flux over pixels and wavelength bins.

fn record_spectral(ray: Ray, detector: Detector, ends: bool) {
    let bin = spectral_bins[detector.bins + ray.wavelength];
    splat_pixels(ray, detector, local_position(ray, detector), detector.cell + bin, detector.num_bins, ends);
}
