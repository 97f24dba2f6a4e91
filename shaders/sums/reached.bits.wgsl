// Marks which primitives were reached, where they are few: one bit each, kept in a register until the dispatch ends. Twin
// of reached.counters.wgsl.

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
