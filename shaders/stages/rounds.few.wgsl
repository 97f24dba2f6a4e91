// Loops make so few rounds that no driver cuts them short. Twin of software/rounds.many.wgsl.
fn notice_cut_loops() {}
