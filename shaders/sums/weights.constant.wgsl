// Every ray weighs for ever what all are born with: the host knows each sum from its count (engine::intake), and the
// dearest atomics are spared. Twin of weights.vary.wgsl.
fn sum_weight(cell: u32, weight: real) {}
