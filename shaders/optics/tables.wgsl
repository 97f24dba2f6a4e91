// The tables of shapes and sources, then of BSDFs, of targets and of coatings. A surface's record holds where its own
// tables begin.
@group(GROUP_SCENE) @binding(BINDING_TABLES) var<storage, read> tables: array<real>;

// The interval of ascending knots that holds x: the last one whose lower knot is not above x.
fn interval_of(x: real, first: u32, count: u32) -> u32 {
    var low = 0u;
    var high = count - 1u;
    var step = 0u;
    loop {
        let middle = (low + high) / 2u;
        if always_true() & (high - low > 1u) {
            if tables[first + middle] <= x {
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

// Where x lies between this knot and the next: 0 at this knot, 1 at the next.
fn position_in(x: real, knot: u32) -> real {
    return (x - tables[knot]) / (tables[knot + 1u] - tables[knot]);
}
