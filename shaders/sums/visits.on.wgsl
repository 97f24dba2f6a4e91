// Remembers what a launched ray, or its children after a split, left on detectors. Later deposits of that ray on the
// same detectors are correlated with these. Twin of visits.none.wgsl.
//
// The MAX_VISITS visits of most weight are kept with their positions. Of all others only the weight is kept, by
// detector. Wherever the ray comes again to such a detector, that whole weight is assumed to lie there. So squares of
// cells may be too large, never too small. Squares of a detector's total are exact.

const MAX_VISITS: u32 = 8u;

struct Visit {
    // The detector's number.
    detector: u32,
    // The cell that took all. NONE: the weight was spread around a position, in cells from `base` on.
    cell: u32,
    base: u32,
    x: real,
    y: real,
    weight: real,
}

var<private> visits: array<Visit, MAX_VISITS>;
var<private> num_visits: u32 = 0u;
// Weights that are not remembered by position, by detector. Where detectors are very many, some share an element, and
// then even the squares of totals may be too large.
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
