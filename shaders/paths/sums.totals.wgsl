// Sums up a deposit by its path: the number of rays, their quanta, and the squares of their weights. Twin of
// sums.maps.wgsl and sums.none.wgsl.

// True: the deposit is recorded as without a table.
fn sum_up_path(ray: Ray, kind: u32, number: u32, place: u32) -> bool {
    let key = ended_key(kind, number);
    let is_open = atomicLoad(&path_table[PATHS_CLOSED]) == 0u;
    let slot = find_path_slot(key, is_open);
    if slot == NONE {
        if is_open {
            atomicStore(&path_table[PATHS_OVERFLOW], 1u);
        }
    } else if was_set {
        // The key is whole by this invocation, so no other writes these words.
        let at = path_slot(slot);
        atomicStore(&path_table[at + SLOT_END], (number << 3u) | kind);
        let position = ray.index & PATH_INDEX_MASK;
        let id_lo = range.first_lo + position;
        atomicStore(&path_table[at + SLOT_RAY], id_lo);
        let id_hi = range.first_hi + select(0u, 1u, id_lo < position);
        atomicStore(&path_table[at + SLOT_RAY + 1u], id_hi + family_number(ray.index) * 256u);
        atomicStore(&path_table[at + SLOT_SOURCE], range.source);
    }
    let row = path_row(slot, place, ray.index);
    atomicAdd(&path_table[row], 1u);
    if PATH_WEIGHTS_VARY {
        add_to_path(row + 1u, quantize(ray.weight));
        add_square_to_path(row + 4u, ray.weight * ray.weight);
    }
    return true;
}

// Rounded up, as all squares of weights (sums/moments.on.wgsl).
fn add_square_to_path(at: u32, square: real) {
    if square >= LARGEST_SQUARE || !is_depositable(square) {
        atomicStore(&path_table[PATHS_LARGE_SQUARE], 1u);
        return;
    }
    add_to_path(at, quantize(ceil(square * 4503599627370496.0) * 2.220446049250313e-16));
}

fn tell_step(ray: Ray, primitive: u32) {}
