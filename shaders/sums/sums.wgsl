// Exact sums, which depend neither on the order of the deposits nor on their batches. A weight is a whole number of
// quanta; one unit of weight is 2^52 quanta. A cell is a 96-bit integer, and cannot overflow below 2^44 units.

// Quanta as words (lo, hi, top). One unit of top is 2^64 quanta, which is 4096 units of weight.
alias Quanta = vec3<u32>;

const NO_QUANTA: vec3<u32> = vec3<u32>(0u, 0u, 0u);

// Counts deposits that no sum can hold: NaN, infinite, negative, or 2^43 and more. Rays that ended without a position
// are counted here, too.
const INVALID_DEPOSITS: u32 = 0u;

// Numbers of events.
@group(GROUP_SCENE) @binding(BINDING_COUNTERS) var<storage, read_write> counters: array<atomic<u32>>;

fn count(counter: u32) {
    atomicAdd(&counters[counter], 1u);
}

// floor(w * 2^52), by the same rule in every precision: monotonic, and exact for an f32 of 2^-29 and more. A weight
// that no sum can hold gives none, and is not counted (see quantize_counted).
fn quantize(w: real) -> Quanta {
    return select(NO_QUANTA, quanta_words(w), is_depositable(w));
}

// quantize, which also counts a weight that no sum can hold.
fn quantize_counted(w: real) -> Quanta {
    if !is_depositable(w) {
        count(INVALID_DEPOSITS);
    }
    return quantize(w);
}

fn q_is_zero(a: Quanta) -> bool {
    return (a.x | a.y | a.z) == 0u;
}

fn q_less(a: Quanta, b: Quanta) -> bool {
    let low = (a.y < b.y) | ((a.y == b.y) & (a.x < b.x));
    return (a.z < b.z) | ((a.z == b.z) & low);
}

// a - b, for b <= a.
fn q_sub(a: Quanta, b: Quanta) -> Quanta {
    let hi = a.y - b.y;
    let borrow = select(0u, 1u, a.x < b.x);
    let borrow_top = select(0u, 1u, a.y < b.y) + select(0u, 1u, hi < borrow);
    return vec3<u32>(a.x - b.x, hi - borrow, a.z - b.z - borrow_top);
}

fn q_add(a: Quanta, b: Quanta) -> Quanta {
    let lo = a.x + b.x;
    let carry = select(0u, 1u, lo < a.x);
    let hi = a.y + b.y;
    let carried = hi + carry;
    let carry_top = select(0u, 1u, hi < a.y) + select(0u, 1u, carried < carry);
    return vec3<u32>(lo, carried, a.z + b.z + carry_top);
}

fn q_min(a: Quanta, b: Quanta) -> Quanta {
    return select(a, b, q_less(b, a));
}

fn plain_deposit_weight(cell: u32, w: real) {
    deposit(cell, quantize_counted(w));
}

// Deposits one tap's share of what is left of a splat. A splat starts from rest = quantize_counted(weight). Each tap
// but the last calls deposit_tap(cell, weight * tap, &rest), and the last calls deposit(cell, rest). So the taps add up
// to the weight to the last bit.
fn plain_deposit_tap(cell: u32, share: real, rest: ptr<function, Quanta>) {
    let taken = q_min(quantize(share), *rest);
    *rest = q_sub(*rest, taken);
    deposit(cell, taken);
}
