// Weights change on the way, so sums are kept beside the counts. Twin of weights.constant.wgsl.
fn sum_weight(cell: u32, weight: real) {
    deposit_weight(cell, weight);
}
