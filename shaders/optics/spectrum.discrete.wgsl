// A discrete spectrum per source: entries (threshold, wavelength), with threshold = floor(cdf 2^32). The first entry
// with bits <= threshold is drawn: Optiland's decision u <= cdf, in integers.

@group(GROUP_SCENE) @binding(BINDING_SPECTRA) var<storage, read> spectra: array<vec2<u32>>;

fn draw_wavelength(key: RayKey, e: Source) -> u32 {
    // Optiland draws nothing for a spectrum of one line. The extra draw changes nothing here, since draws are keyed by
    // slot.
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
