// The device adds up where rays end. In the twin cpu/log/ends.logged.wgsl, the host does.

fn end_in(cell: u32, weight: real) {
    deposit_counted(cell, weight);
}

fn end_in_taps(taps: FourTaps, weight: real) {
    deposit_taps(taps, weight);
}

fn end_without_position() {
    count(INVALID_DEPOSITS);
}

fn log_end(index: u32) {}
