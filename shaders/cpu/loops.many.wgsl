// Notices loops that a driver cut short. Twin of stages/loops.few.wgsl.
//
// Some drivers silently leave loops before their end. Lavapipe counts the iterations of all loops of an invocation, over
// all lanes of its vector. Once these have made 65,535 iterations, every later loop makes one. So each invocation ends
// with a loop that should make two iterations. If the loop makes fewer, the invocation marks its results as void.

fn loops_were_cut() -> bool {
    // With a constant, a compiler would unroll the loop.
    let wanted = select(3u, 2u, always_true());
    var iterations = 0u;
    for (var i = 0u; i < wanted; i++) {
        iterations += 1u;
    }
    return iterations < wanted;
}

fn notice_cut_loops() {
    if loops_were_cut() {
        atomicStore(&queue_counts.cut, 1u);
    }
}
