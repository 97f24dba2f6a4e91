// A ray writes down where it ends, and the host adds it up (src/software/log). Twin of sums/ends.deposited.wgsl: the sums
// are the same bits. On a processor each lane of an atomic is a locked instruction of its own; a store costs a tenth of
// one.

// An entry: the cell in the low bits, then what it is; with it go the weight and the fractions of its taps (`write_entry`
// in entries.*.wgsl). Or, where one detector alone has taps, the position on it, from which the host finds them: an entry
// that is no position says so by one that no detector has.

// The pixels of the taps beside the first are the same column, or the next; the same row, or the next.
const END_NEXT_COLUMN: u32 = 0x00400000u;
const END_NEXT_ROW: u32 = 0x00800000u;
// Which of the taps is the pixel that was hit.
const END_HIT_TAP_SHIFT: u32 = 24u;
const END_IN_CELL: u32 = 0x04000000u;
const END_IN_TAPS: u32 = 0x08000000u;
const END_WITHOUT_PLACE: u32 = 0x10000000u;
const END_REJECTED: u32 = 0x40000000u;

// 0: the ray goes on, or what it ended on adds it up itself.
var<private> end: u32 = 0u;
var<private> end_weight: real = 0.0;
// The fractions of its taps, or the position in pixels.
var<private> end_place: vec2<real> = vec2<real>(0.0, 0.0);

// The column of a position off every detector, whose row is the entry. A position so far beyond the map is marked, by its
// taps, which are one pixel, or by its fraction.
const OFF_DETECTORS: real = -1.25;
// A position times so much, which is exact, tells that the pixel that was hit is not the one before but the next.
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

// The position in pixels, with the pixel that was hit.
fn marked_position(position: vec2<real>, hits_right: bool, hits_below: bool) -> vec2<real> {
    return position * vec2<real>(choose(1.0, HIT_NEXT, hits_right), choose(1.0, HIT_NEXT, hits_below));
}

fn end_in_taps(taps: FourTaps, weight: real) {
    end_weight = weight;
    if LOGS_POSITIONS {
        end |= END_IN_TAPS;
        end_place = marked_position(taps.position, hits_right(taps), hits_below(taps));
    } else {
        let columns = select(0u, END_NEXT_COLUMN, taps.cells.y != taps.cells.x);
        let rows = select(0u, END_NEXT_ROW, taps.cells.z != taps.cells.x);
        let hit = select(0u, 1u, hits_right(taps)) | select(0u, 2u, hits_below(taps));
        end |= END_IN_TAPS | taps.cells.x | columns | rows | (hit << END_HIT_TAP_SHIFT);
        end_place = taps.fractions;
    }
}

fn end_without_place() {
    end = END_WITHOUT_PLACE;
}

// `event`: of the main path, the one at which the ray was rejected.
fn end_rejected(event: u32) {
    end = END_REJECTED | event;
}

fn log_end(index: u32) {
    write_entry(entry_number(index), end, end_weight, end_place);
    end = 0u;
}
