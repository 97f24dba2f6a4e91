// Where rays end, added up by the device. Twin of ends_logged.wgsl.

fn end_in(cell: u32, weight: real) {
    book(cell, weight);
}

fn end_in_taps(taps: FourTaps, weight: real) {
    book_taps(taps, weight);
}

fn end_without_place() {
    count(INVALID_DEPOSITS);
}

fn log_end(index: u32) {}
