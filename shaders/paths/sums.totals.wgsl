// Sums up a deposit by its path: the number of rays, their quanta, and the squares of their weights. Twin of
// sums.maps.wgsl, sums.events.wgsl and sums.none.wgsl.
//
// An invocation keeps the sums of one path. The sums go to the table when another path comes, and at the end. Where an
// invocation follows several rays, most of which take one path, that spares most atomics.

var<private> kept_key: vec3<u32>;
var<private> kept_row: u32;
var<private> kept_count: u32 = 0u;
var<private> kept_quanta: Quanta = NO_QUANTA;
var<private> kept_squares: Quanta = NO_QUANTA;

// True: the deposit is recorded as without a table.
fn sum_up_path(ray: Ray, kind: u32, number: u32, place: u32) -> bool {
    let key = ended_key(kind, number);
    if kept_count == 0u || any(key != kept_key) {
        flush_path();
        kept_key = key;
        kept_row = path_row(slot_for(ray, key, kind, number), place, ray.index);
    }
    kept_count += 1u;
    if PATH_WEIGHTS_VARY {
        kept_quanta = q_add(kept_quanta, quantize(ray.weight));
        keep_square(ray.weight * ray.weight);
    }
    return true;
}

// The slot of a key, which this ray may be the first to have.
fn slot_for(ray: Ray, key: vec3<u32>, kind: u32, number: u32) -> u32 {
    let is_open = path_head.is_open != 0u;
    let slot = find_path_slot(key, is_open);
    if slot == NONE {
        if is_open {
            atomicStore(&path_table[PATHS_OVERFLOW], 1u);
        }
    } else if was_set {
        // The key is whole by this invocation, so no other writes these words.
        let at = path_slot(slot);
        let position = ray.index & PATH_INDEX_MASK;
        let id_lo = range.first_lo + position;
        let id_hi = range.first_hi + select(0u, 1u, id_lo < position);
        atomicStore(&path_table[at + SLOT_END], (number << 3u) | kind);
        atomicStore(&path_table[at + SLOT_RAY], id_lo);
        // ray_id = launched ray + number * 2^40.
        atomicStore(&path_table[at + SLOT_RAY + 1u], id_hi + (family_number(ray.index) << 8u));
        atomicStore(&path_table[at + SLOT_SOURCE], range.source);
    }
    return slot;
}

// Rounded up, as all squares of weights (sums/moments.on.wgsl).
fn keep_square(square: real) {
    if square >= LARGEST_SQUARE || !is_depositable(square) {
        atomicStore(&path_table[PATHS_LARGE_SQUARE], 1u);
        return;
    }
    kept_squares = q_add(kept_squares, quantize(ceil(square * 4503599627370496.0) * 2.220446049250313e-16));
}

// Sends what is kept to the table.
fn flush_path() {
    if kept_count == 0u {
        return;
    }
    atomicAdd(&path_table[kept_row], kept_count);
    kept_count = 0u;
    if PATH_WEIGHTS_VARY {
        add_to_path(kept_row + 1u, kept_quanta);
        add_to_path(kept_row + 4u, kept_squares);
        kept_quanta = NO_QUANTA;
        kept_squares = NO_QUANTA;
    }
}

fn report_step(ray: Ray, primitive: u32) {}
