// Second moments, from which standard errors follow: per cell, the sum over primary rays of the square of what a ray
// adds. Twin of moments.none.wgsl.
//
// A ray that adds v to a cell to which it added u before changes its square by v (v + 2 u). Where a ray can meet a
// detector twice, sums/visits.on.wgsl knows u. A cell of squares lies SQUARES_OFFSET after its cell of sums. Both hold
// units of 2^-52.

// Squares of this size and more are also summed in CELL_LARGE_SQUARES, in units 2^31 times larger. While that sum is
// below one unit of its top word, no cell of squares can have overflowed.
const LARGE_SQUARE: real = 4096.0;
const LARGE_SQUARE_SCALE: real = 4.656612873077393e-10;

// Deposits a square, rounded up: an estimated error that is too small is worse than one that is too large.
fn deposit_square(cell: u32, square: real) {
    if square >= LARGE_SQUARE {
        if !is_depositable(square) {
            deposit(CELL_LARGE_SQUARES, vec3<u32>(0u, 0u, 1u));
            return;
        }
        deposit(CELL_LARGE_SQUARES, quantize(square * LARGE_SQUARE_SCALE));
    }
    deposit(cell, quantize(ceil(square * 4503599627370496.0) * 2.220446049250313e-16));
}

// Adds to the sum and the square of the detector's total, by source. Sources have fixed numbers of rays, so differences
// between sources are no noise.
fn add_total_moments(weight: real, detector: Detector, index: u32) {
    meet(index);
    if HAS_TOTALS {
        let cell = CELL_TOTALS + 2u * (index * NUM_SOURCES + range.source);
        deposit(cell, quantize(weight));
        deposit_square(cell + 1u, weight * (weight + 2.0 * taken_by_detector()));
    }
}

fn add_cell_moment(weight: real, detector: Detector, cell: u32) {
    deposit_square(cell + SQUARES_OFFSET, weight * (weight + 2.0 * taken_by_cell(cell)));
    remember(cell, 0u, vec2<real>(0.0, 0.0), weight);
}

fn add_pixel_moments(weight: real, detector: Detector, p: vec3<real>, pixel: u32, base: u32, stride: u32) {
    if HAS_HARD && detector.splat == SPLAT_HARD {
        add_cell_moment(weight, detector, base + pixel * stride);
        return;
    }
    let position = pixel_position(p, detector);
    let x = taps_of(position.x, detector);
    let y = taps_of(position.y, detector);
    let last_column = i32(detector.num_x) - 1;
    let last_row = i32(detector.num_y) - 1;
    let end_row = clamp(y.last, 0, last_row);
    let end_column = clamp(x.last, 0, last_column);
    var row = clamp(y.first, 0, last_row);
    loop {
        let row_weight = weight * pixel_share(y, row, last_row, detector);
        var column = clamp(x.first, 0, last_column);
        loop {
            if always_true() & (row <= end_row) & (column <= end_column) {
                let taken = row_weight * pixel_share(x, column, last_column, detector);
                let before = taken_by_pixel(detector, base, column, row);
                let cell = base + (u32(row) * detector.num_x + u32(column)) * stride;
                deposit_square(cell + SQUARES_OFFSET, taken * (taken + 2.0 * before));
            }
            if column >= end_column {
                break;
            }
            column += 1;
        }
        if row >= end_row {
            break;
        }
        row += 1;
    }
    remember(NONE, base, position, weight);
}

// The taps of a splat along one axis.
struct Taps {
    // The position, in pixels from the centre of pixel 0.
    position: real,
    first: i32,
    last: i32,
    // The sum of a Gaussian's shares, by which they are renormalised; else 1.
    sum: real,
}

fn taps_of(position: real, detector: Detector) -> Taps {
    let corner = i32(floor(position));
    if HAS_GAUSSIAN && detector.splat == SPLAT_GAUSSIAN {
        let radius = i32(detector.splat_radius);
        var sum: real = 0.0;
        for (var i = corner - radius; i <= corner + radius; i++) {
            sum += gaussian_share(i, position, detector);
        }
        return Taps(position, corner - radius, corner + radius, sum);
    }
    return Taps(position, corner, corner + 1, 1.0);
}

fn tap_share(taps: Taps, i: i32, detector: Detector) -> real {
    if HAS_GAUSSIAN && detector.splat == SPLAT_GAUSSIAN {
        return gaussian_share(i, taps.position, detector) / taps.sum;
    }
    return 1.0 - abs(taps.position - real(i));
}

// The share of a pixel along one axis. The edge pixels also take the taps beyond the map.
fn pixel_share(taps: Taps, pixel: i32, last_pixel: i32, detector: Detector) -> real {
    let first = select(max(taps.first, pixel), taps.first, pixel == 0);
    let last = select(min(taps.last, pixel), taps.last, pixel == last_pixel);
    var share: real = 0.0;
    var i = first;
    loop {
        if always_true() & (i <= last) {
            share += tap_share(taps, i, detector);
        }
        if i >= last {
            break;
        }
        i += 1;
    }
    return share;
}
