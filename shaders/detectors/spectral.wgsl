// Spectral: flux over pixels and wavelength bins. The bin of each wavelength of the scene was found on the host.

@group(GROUP_SCENE) @binding(BINDING_SPECTRAL_BINS) var<storage, read> spectral_bins: array<u32>;

fn record_spectral(ray: Ray, detector: Detector, ends: bool) {
    let bin = spectral_bins[detector.bins + ray.wavelength];
    splat_pixels(ray, detector, local_position(ray, detector), detector.cell + bin, detector.num_bins, ends);
}
