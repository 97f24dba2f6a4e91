// Spectral: flux over pixels and wavelength bins. The bin of each wavelength of the scene was found on the host.

@group(GROUP_SCENE) @binding(BINDING_SPECTRAL_BINS) var<storage, read> spectral_bins: array<u32>;

fn record_spectral(ray: Ray, sensor: Sensor, ends: bool) {
    let bin = spectral_bins[sensor.bins + ray.wavelength];
    splat_pixels(ray, sensor, local_position(ray, sensor), sensor.cell + bin, sensor.num_bins, ends);
}
