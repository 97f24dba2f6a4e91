// What a derivative sees of a trace, and where it goes. The functions of the loop that are named here take the place of the
// plain ones, which have other names then (program::wgsl::derivatives). Without derivatives nothing of this is in the text.
//
// Decisions and draws are detached: their values are those of the plain trace, and no derivative goes through them. The
// weight of a ray is attached: where a branch was drawn with a probability p, the weight carries p / detached(p), whose
// value is 1 and whose derivative is that of ln p. Source: Zeltner et al., Monte Carlo Estimators for Differential Light
// Transport (SIGGRAPH 2021), section 4: detached sampling.

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
    deposit_weight_of_value(cell, w);
    note_detected(cell, w);
}

fn deposit_tap(cell: u32, share: real, rest: ptr<function, Quanta>) {
    deposit_tap_of_value(cell, share, rest);
    note_detected(cell, share);
}

fn deposit_taps(taps: FourTaps, weight: real) {
    deposit_taps_of_value(taps, weight);
    let shares = first_shares(weight, taps.fractions);
    note_detected(taps.cells.x, shares.x);
    note_detected(taps.cells.y, shares.y);
    note_detected(taps.cells.z, shares.z);
    note_detected(taps.cells.w, weight - (shares.x + shares.y + shares.z));
}
