// What a derivative sees of a trace, and where it goes. Twin of sums/deposit.plain.wgsl. A trace without derivatives
// has other text.
//
// Decisions and draws are detached: they have the values of the plain trace, and no derivative goes through them. The
// weight of a ray is attached. Where a branch was drawn with a probability p, the weight carries p / detached(p). This
// factor has the value 1 and the derivative of ln p. Source: Zeltner et al., Monte Carlo Estimators for Differential
// Light Transport (SIGGRAPH 2021), section 4: detached sampling.

// The value, with the derivative of the carrier.
fn attached(value: real, carrier: real) -> real {
    return value;
}

// The value, without a derivative.
fn detached(value: real) -> real {
    return value;
}

// Sends the derivative of a value to the sums of a cell.
fn note(cell: u32, value: real) {}

fn note_detected(cell: u32, value: real) {
    if cell >= FIRST_DETECTOR_CELL {
        note(cell, value);
    }
}

fn deposit_weight(cell: u32, w: real) {
    plain_deposit_weight(cell, w);
    note_detected(cell, w);
}

fn deposit_tap(cell: u32, share: real, rest: ptr<function, Quanta>) {
    plain_deposit_tap(cell, share, rest);
    note_detected(cell, share);
}
