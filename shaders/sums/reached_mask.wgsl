// Which primitives were reached: few primitives, one bit each, kept in a register until the dispatch ends.

var<private> reached: u32 = 0u;

fn mark_reached(primitive: u32) {
    reached |= 1u << primitive;
}

// The host says what passes before this one have reached: that spares the atomic.
fn flush_reached() {
    if (reached & ~range.reached) != 0u {
        atomicOr(&counters[COUNTER_REACHED], reached);
    }
}
