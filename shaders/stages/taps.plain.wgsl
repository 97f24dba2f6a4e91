// The deposit of four taps, under the name that callers use. An addition to the plain loop may take the place of this file.

fn deposit_taps(taps: FourTaps, weight: real) {
    plain_deposit_taps(taps, weight);
}
