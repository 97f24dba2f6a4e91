// The tables of BSDFs, one after the other. A surface's record holds where its own table begins.
@group(GROUP_SCENE) @binding(BINDING_BSDF_TABLE) var<storage, read> bsdf_table: array<real>;

// The interval of ascending knots that holds x: the last one whose lower knot is not above x.
fn interval_of(x: real, first: u32, count: u32) -> u32 {
    var low = 0u;
    var high = count - 1u;
    var step = 0u;
    loop {
        let middle = (low + high) / 2u;
        if always_true() & (high - low > 1u) {
            if bsdf_table[first + middle] <= x {
                low = middle;
            } else {
                high = middle;
            }
        }
        step += 1u;
        if step >= 32u || high - low <= 1u {
            break;
        }
    }
    return low;
}
