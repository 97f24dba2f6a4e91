// Which primitives were reached: few primitives, one bit each, kept in a register until the dispatch ends.

var<private> reached: u32 = 0u;

fn mark_reached(primitive: u32) {
    reached |= 1u << primitive;
}

// Reading first spares the atomic in all but the first few rays.
fn flush_reached() {
    let known = atomicLoad(&counters[COUNTER_REACHED]);
    if (reached & ~known) != 0u {
        atomicOr(&counters[COUNTER_REACHED], reached);
    }
}
