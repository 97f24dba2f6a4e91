// What a launched ray left on detectors that let it pass, or its children after it was split. Twin of visits.none.wgsl.
// Its later deposits on those detectors are correlated with these. The visits of most weight, so many of them, are known
// each by its place. Of the others only the weight is known, by detector, and is taken for the whole of it wherever the ray
// comes again to the same one. So squares of cells may be too large, never too small; those of a detector's total are
// exact.

const MAX_VISITS: u32 = 8u;

struct Visit {
    // The detector's number.
    detector: u32,
    // The cell that took all, or NONE where the weight was spread about a position from the cell `base` on.
    cell: u32,
    base: u32,
    x: real,
    y: real,
    weight: real,
}

var<private> visits: array<Visit, MAX_VISITS>;
var<private> num_visits: u32 = 0u;
// By detector; of very many, some share a place, and then even the squares of totals may be too large.
var<private> forgotten: array<real, FORGOTTEN_PLACES>;
// The detector that the ray is on.
var<private> met: u32 = 0u;

fn meet(index: u32) {
    met = index;
}

fn forget(detector: u32, weight: real) {
    forgotten[detector % FORGOTTEN_PLACES] += weight;
}

fn forgotten_here() -> real {
    return forgotten[met % FORGOTTEN_PLACES];
}

fn remember(cell: u32, base: u32, position: vec2<real>, weight: real) {
    var place = num_visits;
    if num_visits < MAX_VISITS {
        num_visits += 1u;
    } else {
        place = least_visit();
        if weight <= visits[place].weight {
            forget(met, weight);
            return;
        }
        forget(visits[place].detector, visits[place].weight);
    }
    visits[place] = Visit(met, cell, base, position.x, position.y, weight);
}

fn least_visit() -> u32 {
    var least = 0u;
    for (var i = 1u; i < MAX_VISITS; i++) {
        least = select(least, i, visits[i].weight < visits[least].weight);
    }
    return least;
}

fn taken_by_detector() -> real {
    var taken = forgotten_here();
    for (var i = 0u; i < num_visits; i++) {
        taken += choose(0.0, visits[i].weight, visits[i].detector == met);
    }
    return taken;
}

fn taken_by_cell(cell: u32) -> real {
    var taken = forgotten_here();
    for (var i = 0u; i < num_visits; i++) {
        taken += choose(0.0, visits[i].weight, visits[i].cell == cell);
    }
    return taken;
}

fn taken_by_pixel(detector: Detector, base: u32, column: i32, row: i32) -> real {
    var taken = forgotten_here();
    for (var i = 0u; i < num_visits; i++) {
        let visit = visits[i];
        if (visit.detector == met) & (visit.base == base) {
            let share_x = pixel_share(taps_of(visit.x, detector), column, i32(detector.num_x) - 1, detector);
            let share_y = pixel_share(taps_of(visit.y, detector), row, i32(detector.num_y) - 1, detector);
            taken += visit.weight * share_x * share_y;
        }
    }
    return taken;
}
