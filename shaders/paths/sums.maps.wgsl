// Maps by path, from a second trace of the same rays, when it is known which paths matter. Some paths get a map. For
// each path is summed where its light lies on the detector. No path is added to the table. Twin of sums.totals.wgsl.

// The map of the ray's path, or NONE.
var<private> path_map: u32 = NONE;

fn sum_up_path(ray: Ray, kind: u32, number: u32, place: u32) -> bool {
    if kind != ON_DETECTOR {
        return false;
    }
    let slot = find_path_slot(ended_key(kind, number), false);
    if slot == NONE {
        return false;
    }
    // Distances are from a point where some ray of this path has arrived, so that a small spot keeps its digits. They are
    // in units of the detector's size, so that their sums do not outgrow the sums of weights.
    let at = path_slot(slot);
    let detector = detector_of(number);
    let p = local_position(ray, detector);
    let size = detector.half_width + detector.half_height;
    let dx = (p.x - real(bitcast<f32>(atomicLoad(&path_table[at + SLOT_RAY])))) / size;
    let dy = (p.y - real(bitcast<f32>(atomicLoad(&path_table[at + SLOT_RAY + 1u])))) / size;
    let row = path_row(slot, place, ray.index);
    add_signed_to_path(row, ray.weight * dx);
    add_signed_to_path(row + 3u, ray.weight * dy);
    add_signed_to_path(row + 6u, ray.weight * (dx * dx + dy * dy));
    path_map = atomicLoad(&path_table[at + SLOT_MAP]);
    return path_map != NONE;
}

// Adds a number of either sign: one below zero as the complement of its quanta.
fn add_signed_to_path(at: u32, value: real) {
    if !is_depositable(abs(value)) {
        atomicStore(&path_table[PATHS_LARGE_SQUARE], 1u);
        return;
    }
    let q = quantize(abs(value));
    if value < 0.0 {
        add_to_path(at, q_sub(NO_QUANTA, q));
    } else {
        add_to_path(at, q);
    }
}

fn flush_path() {}

fn report_step(ray: Ray, primitive: u32) {}
