// The first crossing of a ray with a surface z = sag(x, y), proven to be the first.
//
// Along the ray, F(t) = z(t) - sag(x(t), y(t)). Two bounds hold over the whole aperture: of the sag's slope, and of its
// bend, which is the largest second derivative along any line. So |F'| is at most `speed`, and |F''| at most `bend`. A tip on the
// axis adds to the bend what its slope is over the distance from the axis.
//
// Where a ray is so steep that the sag's slope cannot turn F round, it crosses once at most: `sag_single` finds that by
// Newton's method. So do most rays of a lens. For the others, `sag_next` looks at intervals of the ray, the nearest first,
// each through its middle:
//
// - without a crossing, if |F| in the middle is more than `speed` times half the length: on to the next interval;
// - with at most one, if |F'| in the middle is more than `bend` times half the length. The sign at one end then shows
//   whether there is a crossing, and Newton's method finds it within that half;
// - undecided: the interval is halved. Where halving reaches what rounding hides, the signs at both ends decide.
//
// The ray starts with what lies within the aperture's cylinder and between the sag's lowest and highest place. A ray
// that leaves the surface has F = 0 at its start. The ray's other crossings are the zeros of F(t) / t, whose derivative
// is at most bend / 2.
//
// A caller gives the sag at `place`, step by step: to `sag_single` while `phase` is SAG_SINGLE, then to `sag_next` until
// `phase` is SAG_DONE. `distance` then is the result or MISS.

const SAG_DONE: u32 = 0u;
// Where the sag is wanted. SAG_START: where a ray starts that leaves the surface. SAG_MIDDLE: in the middle of an
// interval. SAG_END: at one of its ends. SAG_FIRST_END, then SAG_LAST_END: at both ends. SAG_NEWTON: at a point that
// Newton's method gives.
const SAG_START: u32 = 1u;
const SAG_MIDDLE: u32 = 2u;
const SAG_END: u32 = 3u;
const SAG_FIRST_END: u32 = 4u;
const SAG_LAST_END: u32 = 5u;
const SAG_NEWTON: u32 = 6u;
const SAG_SINGLE: u32 = 7u;

// Halvings of the first interval, and steps of Newton's method, that no crossing takes in practice.
const SAG_MOST_HALVINGS: u32 = 30u;
const SAG_MOST_STEPS: u32 = 60u;
// A ray that runs along the surface may leave any number of intervals undecided. After so many, the rest of the ray is cut
// into at most 2^SAG_COARSE pieces, and the signs at their ends decide.
const SAG_MOST_LOOKS: u32 = 400u;
const SAG_COARSE: u32 = 10u;

struct SagSearch {
    phase: u32,
    // Where the sag is wanted: the point, and its distance from `base`.
    place: vec3<real>,
    t: real,
    distance: real,
    // The ray: a point of it, the direction, how far the ray's origin lies before the point.
    base: vec3<real>,
    direction: vec3<real>,
    shift: real,
    leaving: bool,
    // F at the start of a ray that leaves.
    start: real,
    clip: real,
    limit: real,
    speed: real,
    // `across`: the part of the direction that lies across the axis. `bend`: the bend. `tip`: what a tip on the axis
    // adds to the bend, times the distance from the axis.
    across: real,
    bend: real,
    tip: real,
    // Half the length of an interval that rounding hides. The second one is for the start of a ray that leaves.
    hidden: real,
    hidden_at_start: real,
    // The interval: its near end, half its length, how often it was halved, and its number among intervals of that
    // length.
    near: real,
    half: real,
    halvings: u32,
    index: u32,
    // F in the middle, or at the near end of the bracket.
    value: real,
    // The bracket of Newton's method, the last two places, and the number of steps.
    low: real,
    high: real,
    last: real,
    steps: u32,
    // Intervals that were looked at.
    looks: u32,
}

fn sag_search(
    o: vec3<real>, d: vec3<real>, clip: real, limit: real, lowest: real, highest: real, slope: real, bend: real, tip: real,
    magnitude: real, leaving: bool,
) -> SagSearch {
    // A little wider than the aperture: rounding may not lose a crossing at the rim.
    let room = limit * 1.000002;
    // A ray may stand on this surface where the aperture has ended, and leave another one there.
    let leaves = leaving & (o.x * o.x + o.y * o.y <= room);
    let shift = select(-dot(o, d), 0.0, leaves);
    let base = o + shift * d;
    let square = d.x * d.x + d.y * d.y;
    let b = base.x * d.x + base.y * d.y;
    let c = base.x * base.x + base.y * base.y - room;
    let discriminant = b * b - square * c;
    let root = sqrt(abs(discriminant));
    let q = -(b + select(root, -root, b < 0.0));
    let is_along = square == 0.0;
    let one = q / select(square, 1.0, is_along);
    let other = select(c / select(q, 1.0, q == 0.0), one, q == 0.0);
    var near = select(min(one, other), -MISS, is_along);
    var far = select(max(one, other), MISS, is_along);
    var is_missed = select((discriminant < 0.0), (c > 0.0), is_along);
    let is_across = d.z == 0.0;
    let to_low = (lowest - base.z) / select(d.z, 1.0, is_across);
    let to_high = (highest - base.z) / select(d.z, 1.0, is_across);
    near = max(near, select(min(to_low, to_high), -MISS, is_across));
    far = min(far, select(max(to_low, to_high), MISS, is_across));
    is_missed = is_missed | (is_across & ((base.z < lowest) | (base.z > highest)));
    near = max(near, -shift);
    is_missed = is_missed | !(near <= far);
    let across = sqrt(square);
    let speed = abs(d.z) + slope * across;
    let largest = abs(base.x) + abs(base.y) + abs(base.z) + max(abs(near), abs(far)) + magnitude;
    let is_single = abs(d.z) > slope * across;
    var s: SagSearch;
    // A ray that leaves the surface and crosses it once has done so.
    let begin = select(select(SAG_MIDDLE, SAG_START, leaves), SAG_SINGLE, is_single);
    s.phase = select(begin, SAG_DONE, is_missed | (leaves & is_single));
    s.distance = MISS;
    s.base = base;
    s.direction = d;
    s.shift = shift;
    s.leaving = leaves;
    s.start = 0.0;
    s.clip = clip;
    s.limit = limit;
    s.speed = speed;
    s.across = across;
    s.bend = bend * square;
    s.tip = tip * square;
    s.hidden = largest * SAG_ROUNDING / speed;
    s.hidden_at_start = s.hidden;
    s.near = near;
    s.half = 0.5 * (far - near);
    s.halvings = 0u;
    s.index = 0u;
    // If the ray crosses once, F has this sign before.
    s.value = -d.z;
    s.low = near;
    s.high = near + 2.0 * s.half;
    s.last = MISS;
    s.steps = 0u;
    s.looks = 0u;
    return sag_at(s, select(near + s.half, 0.0, leaves));
}

// The search with another point where the sag is wanted.
fn sag_at(search: SagSearch, t: real) -> SagSearch {
    var s = search;
    s.t = t;
    s.place = s.base + t * s.direction;
    return s;
}

// The search of a ray that crosses once at most, one step on: a step of Newton's method within what is left.
fn sag_single(search: SagSearch, sag: vec3<real>) -> SagSearch {
    var s = search;
    let f = s.place.z - sag.x;
    let rate = s.direction.z - (sag.y * s.direction.x + sag.z * s.direction.y);
    let is_before = (f < 0.0) == (s.value < 0.0);
    let is_none = select((s.t == s.near), s.t == s.near + 2.0 * s.half, is_before);
    s.low = select(s.low, s.t, is_before);
    s.high = select(s.t, s.high, is_before);
    s.steps += 1u;
    let wanted = s.t - f / select(rate, 1.0, rate == 0.0);
    let is_close = sag_is_close(s, wanted, rate);
    let held = select(min(max(wanted, s.low), s.high), 0.5 * (s.low + s.high), s.steps > 8u);
    let next = select(held, wanted, is_close);
    let is_over = is_close | (next == s.t) | (next == s.last) | (s.steps >= SAG_MOST_STEPS);
    s.last = s.t;
    s = sag_at(s, next);
    if is_none | is_over {
        s.phase = SAG_DONE;
        s.distance = select(MISS, next + s.shift, !is_none & sag_is_met(s));
    }
    return s;
}

// The bound of |F''| within a distance of the place where the sag was wanted.
fn sag_bend(s: SagSearch, distance: real) -> real {
    let r = sqrt(s.place.x * s.place.x + s.place.y * s.place.y) - distance * s.across;
    // Nothing bounds the bend of a tip on its axis.
    let at_tip = select(1e30, s.tip / select(1.0, r, r > 0.0), r > 0.0);
    return s.bend + select(0.0, at_tip, s.tip > 0.0);
}

// What is left of the error after a step of Newton's method is at most bend / (2 |F'|) times its square. True if rounding
// hides that.
fn sag_is_close(s: SagSearch, wanted: real, rate: real) -> bool {
    let step = wanted - s.t;
    return (wanted >= s.low) & (wanted <= s.high) & (sag_bend(s, abs(step)) * step * step <= 0.5 * s.hidden * abs(rate));
}

// True if the search stands within the aperture, ahead of the ray.
fn sag_is_met(s: SagSearch) -> bool {
    return (s.place.x * s.place.x + s.place.y * s.place.y <= s.limit) && (s.t + s.shift > 0.0) && clip_holds(s.place, s.clip);
}

// The search one step on, with the sag and its two derivatives at `place`.
fn sag_next(search: SagSearch, sag: vec3<real>) -> SagSearch {
    var s = search;
    let f = s.place.z - sag.x - s.start;
    let rate = s.direction.z - (sag.y * s.direction.x + sag.z * s.direction.y);
    if s.phase == SAG_NEWTON {
        return sag_newton(s, f, rate);
    }
    if s.phase == SAG_START {
        s.start = f;
        // Nearer than that, rounding hides how F grows, and how it bends unless there is a tip.
        let rounding = s.hidden * s.speed;
        let by_rate = rounding / max(abs(rate), 1e-30);
        s.hidden_at_start = select(min(by_rate, sqrt(2.0 * rounding / max(s.bend, 1e-30))), by_rate, s.tip > 0.0);
        s.phase = SAG_MIDDLE;
        return sag_at(s, s.near + s.half);
    }
    if s.phase == SAG_MIDDLE {
        return sag_middle(s, f, rate);
    }
    // An end of the interval: a crossing lies between it and the middle if F changes its sign there.
    let is_crossed = (f < 0.0) != (s.value < 0.0);
    if is_crossed {
        let middle = s.near + s.half;
        s.low = min(s.t, middle);
        s.high = max(s.t, middle);
        // F at the near end of the bracket.
        s.value = select(s.value, f, s.t < middle);
        s.last = MISS;
        s.steps = 0u;
        s.phase = SAG_NEWTON;
        return sag_at(s, 0.5 * (s.low + s.high));
    }
    if s.phase == SAG_FIRST_END {
        s.phase = SAG_LAST_END;
        return sag_at(s, s.near + 2.0 * s.half);
    }
    return sag_advance(s);
}

fn sag_middle(search: SagSearch, f: real, rate: real) -> SagSearch {
    var s = search;
    s.value = f;
    s.looks += 1u;
    let is_first = s.leaving & (s.index == 0u);
    let most_halvings = select(SAG_MOST_HALVINGS, SAG_COARSE, s.looks > SAG_MOST_LOOKS);
    let is_hidden = (s.half <= select(s.hidden, s.hidden_at_start, is_first)) | (s.halvings >= most_halvings);
    // Of the interval at the start of a ray that leaves, F(t) / t is looked at.
    let rounding = s.speed * s.hidden;
    let bend = sag_bend(s, s.half);
    let deflated = abs(f) > 0.5 * bend * s.half * s.t + rounding;
    if select((abs(f) > s.speed * s.half + rounding), deflated | is_hidden, is_first) {
        return sag_advance(s);
    }
    if !is_first & (abs(rate) > bend * s.half) {
        // One crossing at most: before the middle, if F grows and is positive there, or falls and is negative.
        let is_before = (rate > 0.0) == (f >= 0.0);
        s.phase = SAG_END;
        return sag_at(s, select(s.near + 2.0 * s.half, s.near, is_before));
    }
    if is_hidden {
        s.phase = SAG_FIRST_END;
        return sag_at(s, s.near);
    }
    s.half = 0.5 * s.half;
    s.halvings += 1u;
    s.index = 2u * s.index;
    return sag_at(s, s.near + s.half);
}

// The search in the next interval, as long as the ray allows.
fn sag_advance(search: SagSearch) -> SagSearch {
    var s = search;
    s.near += 2.0 * s.half;
    s.index += 1u;
    while ((s.index & 1u) == 0u) & (s.halvings > 0u) {
        s.index >>= 1u;
        s.halvings -= 1u;
        s.half = 2.0 * s.half;
    }
    s.phase = select(SAG_MIDDLE, SAG_DONE, (s.halvings == 0u) & (s.index >= 1u));
    return sag_at(s, s.near + s.half);
}

// A step of Newton's method within a bracket, or its end where the places repeat themselves.
fn sag_newton(search: SagSearch, f: real, rate: real) -> SagSearch {
    var s = search;
    if (f < 0.0) == (s.value < 0.0) {
        s.low = s.t;
    } else {
        s.high = s.t;
    }
    let wanted = s.t - f / select(rate, 1.0, rate == 0.0);
    let is_within = (rate != 0.0) & (wanted >= s.low) & (wanted <= s.high);
    let next = select(0.5 * (s.low + s.high), wanted, is_within);
    s.steps += 1u;
    let is_close = is_within & sag_is_close(s, wanted, rate);
    if is_close | (next == s.t) | (next == s.last) | (s.steps >= SAG_MOST_STEPS) {
        s = sag_at(s, next);
        if sag_is_met(s) {
            s.distance = s.t + s.shift;
            s.phase = SAG_DONE;
            return s;
        }
        return sag_advance(s);
    }
    s.last = s.t;
    return sag_at(s, next);
}

// The unit normal where the sag has these derivatives.
fn sag_normal(sag: vec3<real>) -> vec3<real> {
    return vec3<real>(-sag.y, -sag.z, 1.0) / sqrt(1.0 + sag.y * sag.y + sag.z * sag.z);
}

// The signed distance of a point from the surface, to first order.
fn sag_height(p: vec3<real>, sag: vec3<real>) -> real {
    return (p.z - sag.x) / sqrt(1.0 + sag.y * sag.y + sag.z * sag.z);
}
