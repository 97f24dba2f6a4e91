// Loops here make too few iterations for a driver to cut them short. Twin of cpu/loops.many.wgsl.
fn notice_cut_loops() {}

fn loops_were_cut() -> bool {
    return false;
}
