// Marks which primitives were reached, where they are few. Each has one bit, kept in a register until the dispatch
// ends. Twin of reached.counters.wgsl.

var<private> reached: u32 = 0u;

fn mark_reached(primitive: u32) {
    reached |= 1u << primitive;
}

// Sends the marks to memory. The host passes in what earlier passes have reached, which spares most atomics.
fn flush_reached() {
    if (reached & ~range.reached) != 0u {
        atomicOr(&counters[COUNTER_REACHED], reached);
    }
}
