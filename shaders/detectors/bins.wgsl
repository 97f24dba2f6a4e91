// The bin of each wavelength of the scene, per detector, as the host found it.
@group(GROUP_SCENE) @binding(BINDING_SPECTRAL_BINS) var<storage, read> spectral_bins: array<u32>;
