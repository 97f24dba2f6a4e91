// The ledger accounts for all flux: every event deposits what it took, as weight before minus weight after in quanta.
// Differences of quantised weights telescope, so the bins add up to what was launched, to the last bit.
//
// Bins that rays meet on their way are kept in registers (composed: `add_to_bin`, `flush_bins`). A bin goes to memory
// once an invocation. Where a ray ends, it deposits once.

fn deposit_counted(cell: u32, weight: real) {
    count(cell);
    sum_weight(cell, weight);
}

// Deposits before - after if that is positive.
fn deposit_loss(cell: u32, before: real, after: real) {
    if after < before {
        add_to_bin(cell, q_sub(quantize(before), quantize(after)));
    }
}

fn flush_bin(cell: u32, events: u32, quanta: Quanta) {
    if events != 0u {
        atomicAdd(&counters[cell], events);
        deposit(cell, quanta);
    }
}

fn flush_count(cell: u32, events: u32) {
    if events != 0u {
        atomicAdd(&counters[cell], events);
    }
}
