// The ledger: every event books what it took, weight before minus weight after in quanta. Differences of quantised
// weights telescope, so the bins add up to what was launched to the last bit.

fn book(cell: u32, weight: real) {
    count(cell);
    deposit_weight(cell, weight);
}

// Books before - after if that is positive.
fn book_loss(cell: u32, before: real, after: real) {
    if after < before {
        count(cell);
        deposit(cell, q_sub(quantize(before), quantize(after)));
    }
}

// Reading first spares the atomic in all but the first few events.
fn mark_reached(primitive: u32) {
    if atomicLoad(&counters[COUNTER_REACHED + primitive]) == 0u {
        atomicStore(&counters[COUNTER_REACHED + primitive], 1u);
    }
}
