// Notices loops that a driver cut short. Twin of stages/rounds.few.wgsl.
// Some drivers leave loops before their end and say nothing: lavapipe does once the loops of an invocation, those of all
// lanes of its vector together, have made 65,535 rounds. Every later loop then makes one round. So each invocation ends
// with a loop that should make two, and marks what the host must not believe.

fn notice_cut_loops() {
    // Of a constant a compiler would unroll the loop.
    let wanted = select(3u, 2u, is_dispatched());
    var rounds = 0u;
    for (var i = 0u; i < wanted; i++) {
        rounds += 1u;
    }
    if rounds < wanted {
        atomicStore(&queue_counts.cut, 1u);
    }
}
