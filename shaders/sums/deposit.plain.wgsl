// Deposits, under the names that callers use. An addition to the plain loop may take the place of this file.

fn deposit_weight(cell: u32, w: real) {
    plain_deposit_weight(cell, w);
}

fn deposit_tap(cell: u32, share: real, rest: ptr<function, Quanta>) {
    plain_deposit_tap(cell, share, rest);
}
