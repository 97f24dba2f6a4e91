// Loops here make too few rounds for a driver to cut them short. Twin of cpu/rounds.many.wgsl.
fn notice_cut_loops() {}

fn loops_were_cut() -> bool {
    return false;
}
