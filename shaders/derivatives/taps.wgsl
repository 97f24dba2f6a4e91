// The derivatives of four taps. Twin of stages/taps.plain.wgsl.

fn deposit_taps(taps: FourTaps, weight: real) {
    plain_deposit_taps(taps, weight);
    let shares = first_shares(weight, taps.fractions);
    note_detected(taps.cells.x, shares.x);
    note_detected(taps.cells.y, shares.y);
    note_detected(taps.cells.z, shares.z);
    note_detected(taps.cells.w, weight - (shares.x + shares.y + shares.z));
}
