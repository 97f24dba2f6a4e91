// Where rays end, written down for the host to add up (gpu::end_log). On a processor every lane of an atomic is a locked
// instruction of its own, and a store costs a tenth of it. Twin of ends_booked.wgsl: the sums are the same bits.

// An entry: the cell in the low bits, then what it is; with it go the weight and the fractions of its taps (`write_entry`
// in lib/log_*.wgsl).

// The pixels of the taps beside the first are the same column, or the next; the same row, or the next.
const END_NEXT_COLUMN: u32 = 0x00400000u;
const END_NEXT_ROW: u32 = 0x00800000u;
// Which of the taps is the pixel that was hit.
const END_HIT_TAP_SHIFT: u32 = 24u;
const END_IN_CELL: u32 = 0x04000000u;
const END_IN_TAPS: u32 = 0x08000000u;
const END_WITHOUT_PLACE: u32 = 0x10000000u;
const END_STRAYED: u32 = 0x40000000u;

// 0: the ray goes on, or what it ended on adds it up itself.
var<private> end: u32 = 0u;
var<private> end_weight: real = 0.0;
var<private> end_fractions: vec2<real> = vec2<real>(0.0, 0.0);

fn end_in(cell: u32, weight: real) {
    end |= END_IN_CELL | cell;
    end_weight = weight;
}

fn end_in_taps(taps: FourTaps, weight: real) {
    let columns = select(0u, END_NEXT_COLUMN, taps.cells.y != taps.cells.x);
    let rows = select(0u, END_NEXT_ROW, taps.cells.z != taps.cells.x);
    let right = select(0u, 1u, taps.hit == taps.cells.y || taps.hit == taps.cells.w);
    let below = select(0u, 2u, taps.hit == taps.cells.z || taps.hit == taps.cells.w);
    end |= END_IN_TAPS | taps.cells.x | columns | rows | ((right | below) << END_HIT_TAP_SHIFT);
    end_weight = weight;
    end_fractions = taps.fractions;
}

fn end_without_place() {
    end = END_WITHOUT_PLACE;
}

fn end_strayed() {
    end = END_STRAYED;
}

fn log_end(index: u32) {
    write_entry(entry_number(index), end, end_weight, end_fractions);
    end = 0u;
}
