// So few rounds of loops that no driver cuts them.
fn notice_cut_loops() {}
