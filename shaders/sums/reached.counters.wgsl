// Marks which primitives were reached, by a counter each. Twin of reached.bits.wgsl.

// Reading first spares the store in all but the first few events.
fn mark_reached(primitive: u32) {
    if atomicLoad(&counters[COUNTER_REACHED + primitive]) == 0u {
        atomicStore(&counters[COUNTER_REACHED + primitive], 1u);
    }
}

fn flush_reached() {}
