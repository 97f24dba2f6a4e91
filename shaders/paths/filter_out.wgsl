// What a filter keeps from maps. The ledger has a line for it.

fn filter_out(weight: real, ends: bool) {
    if ends {
        deposit_counted(CELL_FILTERED, weight);
    }
}
