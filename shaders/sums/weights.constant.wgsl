// Every ray keeps the weight that all rays are born with. The host computes each sum from its count (engine::readback),
// which spares the most expensive atomics. Twin of weights.vary.wgsl.
fn sum_weight(cell: u32, weight: real) {}
