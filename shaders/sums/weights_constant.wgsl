// Every ray weighs for ever what all are born with: the host knows each sum from its count (trace::intake), and the
// dearest atomics are spared.
fn sum_weight(cell: u32, weight: real) {}
