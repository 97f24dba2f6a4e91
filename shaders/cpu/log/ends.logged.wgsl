// A ray logs where it ends, and the host adds up the log (src/cpu/log). On a processor each lane of an atomic is a
// locked instruction of its own, and a store costs a tenth of that. Twin of sums/ends.deposited.wgsl, with the same
// bits in the sums.

// An entry holds the cell in its low bits, and above them what kind of end it is. With it go the weight and the
// fractions of the taps (`write_entry` in entries.*.wgsl).
//
// Where one detector alone has taps, an entry is instead the position on that detector, and the host finds the taps. An
// entry that is no position then has a position that no detector has (OFF_DETECTORS).

// The other taps lie in the next column, or in the same column at the edge of the map. The same goes for rows.
const END_NEXT_COLUMN: u32 = 0x00400000u;
const END_NEXT_ROW: u32 = 0x00800000u;
// Which of the taps is the pixel that was hit, in two bits from here on.
const END_HIT_TAP_SHIFT: u32 = 24u;
const END_IN_CELL: u32 = 0x04000000u;
const END_IN_TAPS: u32 = 0x08000000u;
const END_WITHOUT_POSITION: u32 = 0x10000000u;
const END_GUARD_FAILED: u32 = 0x40000000u;

// The entry so far. 0: the ray goes on, or ends on something that adds up the end itself.
var<private> end: u32 = 0u;
var<private> end_weight: real = 0.0;
// The fractions of the taps, or the position in pixels.
var<private> end_position: vec2<real> = vec2<real>(0.0, 0.0);

// The column of a position off every detector; its row is the entry. A true position so far beyond the map differs,
// because it is multiplied by HIT_NEXT. Its taps are one pixel, and its fraction is above one half.
const OFF_DETECTORS: real = -1.25;
// A position is multiplied by this factor, which is exact, if the pixel that was hit is not the one before it but the
// next.
const HIT_NEXT: real = 79228162514264337593543950336.0;

fn end_in(cell: u32, weight: real) {
    end |= END_IN_CELL | cell;
    end_weight = weight;
}

fn hits_right(taps: FourTaps) -> bool {
    return taps.hit == taps.cells.y || taps.hit == taps.cells.w;
}

fn hits_below(taps: FourTaps) -> bool {
    return taps.hit == taps.cells.z || taps.hit == taps.cells.w;
}

// The position in pixels, marked with the pixel that was hit.
fn marked_position(position: vec2<real>, hits_right: bool, hits_below: bool) -> vec2<real> {
    return position * vec2<real>(choose(1.0, HIT_NEXT, hits_right), choose(1.0, HIT_NEXT, hits_below));
}

fn end_in_taps(taps: FourTaps, weight: real) {
    end_weight = weight;
    if LOGS_POSITIONS {
        end |= END_IN_TAPS;
        end_position = marked_position(taps.position, hits_right(taps), hits_below(taps));
    } else {
        let columns = select(0u, END_NEXT_COLUMN, taps.cells.y != taps.cells.x);
        let rows = select(0u, END_NEXT_ROW, taps.cells.z != taps.cells.x);
        let hit = select(0u, 1u, hits_right(taps)) | select(0u, 2u, hits_below(taps));
        end |= END_IN_TAPS | taps.cells.x | columns | rows | (hit << END_HIT_TAP_SHIFT);
        end_position = taps.fractions;
    }
}

fn end_without_position() {
    end = END_WITHOUT_POSITION;
}

// Ends a ray that failed a guard of the hot path at this event of the path.
fn end_failed(event: u32) {
    end = END_GUARD_FAILED | event;
}

fn log_end(index: u32) {
    write_entry(entry_number(index), end, end_weight, end_position);
    end = 0u;
}
