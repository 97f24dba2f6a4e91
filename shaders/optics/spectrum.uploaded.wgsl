// A discrete spectrum per source, as in spectrum.discrete.wgsl, where some rays are uploaded and may have wavelengths of
// their own. Twin of spectrum.discrete.wgsl.

@group(GROUP_SCENE) @binding(BINDING_SPECTRA) var<storage, read> spectra: array<vec2<u32>>;

fn draw_wavelength(key: RayKey, e: Source) -> u32 {
    if has_uploaded_rays(e) {
        let own = tables[uploaded_row(e)];
        if own >= 0.0 {
            return u32(own);
        }
    }
    let bits = draw_first(key, SOURCE_WAVELENGTH);
    var low = 0u;
    var high = e.spectrum_count - 1u;
    var step = 0u;
    loop {
        let middle = (low + high) / 2u;
        if always_true() & (low < high) {
            if spectra[e.spectrum_first + middle].x >= bits {
                high = middle;
            } else {
                low = middle + 1u;
            }
        }
        step += 1u;
        if step >= 32u || low >= high {
            break;
        }
    }
    return spectra[e.spectrum_first + low].y;
}
