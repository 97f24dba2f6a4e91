//! One function for each rule, with its value by the textbook.

use crate::harness::{Function, Inputs, NOTED};
use crate::number::{Dual, Number, cross, dot, each};

/// A function of one rule.
pub struct Rule {
    pub name: &'static str,
    /// The body, from `u`, `v` and `n`; or functions with `fn NAME(`.
    text: &'static str,
    pub value: fn([Dual; 8], u32) -> Dual,
    /// False if df64 has no such operation.
    pub df64: bool,
    /// Points beside the random ones.
    pub edges: &'static [Inputs],
}

impl Rule {
    pub fn function(&self) -> Function {
        let (name, body) = (self.name, self.text);
        let head = format!("fn {name}(u: vec4<real>, v: vec4<real>, n: u32) -> real");
        let text = match body.split_once("=====") {
            Some((before, body)) => format!("{before}\n{head} {{ {body} }}\n"),
            None => format!("{head} {{ {body} }}\n"),
        };
        Function { name: name.to_owned(), text }
    }
}

const fn rule(name: &'static str, text: &'static str, value: fn([Dual; 8], u32) -> Dual) -> Rule {
    Rule { name, text, value, df64: true, edges: &[] }
}

const fn beyond_df64(rule: Rule) -> Rule {
    Rule { df64: false, ..rule }
}

const fn with_edges(rule: Rule, edges: &'static [Inputs]) -> Rule {
    Rule { edges, ..rule }
}

fn xyz(x: [Dual; 8], first: usize) -> [Dual; 3] {
    [x[first], x[first + 1], x[first + 2]]
}

fn number(value: f64) -> Dual {
    Dual::of(value)
}

const ALIKE: Inputs = [0.5, -1.0, 2.0, 0.25, 0.5, -1.0, 2.0, 0.25];
const SIGNS: Inputs = [-0.5, 1.5, -0.0, 1.0, -1.5, 2.5, -2.0, -1.0];
/// Within, below and beyond the limits of `clamp`, and on them.
const LIMITS: [Inputs; 5] = [
    [0.5, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    [-1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    [2.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    [1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
];

pub const RULES: &[Rule] = &[
    // Arithmetic.
    rule("a_sum", "return u.x + u.y;", |x, _| x[0].plus(x[1])),
    rule("a_difference", "return u.x - u.y;", |x, _| x[0].minus(x[1])),
    rule("a_product", "return u.x * u.y;", |x, _| x[0].times(x[1])),
    rule("a_square", "return u.x * u.x;", |x, _| x[0].times(x[0])),
    rule("a_quotient", "return u.x / (3.0 + u.y);", |x, _| x[0].over(x[1].plus(number(3.0)))),
    rule("of_a_constant", "return 2.0 / (3.0 + u.y) - 5.0 * u.x + (1.0 - u.z);", |x, _| {
        let quotient = number(2.0).over(x[1].plus(number(3.0)));
        quotient.minus(number(5.0).times(x[0])).plus(number(1.0).minus(x[2]))
    }),
    rule("a_negative", "return -u.x;", |x, _| x[0].negative()),
    rule("powers_of_two", "return u.x * 0.5 + 4.0 * u.y - u.z / 8.0;", |x, _| {
        x[0].times(number(0.5)).plus(x[1].times(number(4.0))).minus(x[2].times(number(0.125)))
    }),
    // Mathematics.
    with_edges(rule("a_magnitude", "return abs(u.x) * u.y;", |x, _| x[0].magnitude().times(x[1])), &[
        [0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        SIGNS,
    ]),
    with_edges(
        rule("the_smaller", "return min(u.x, v.x) * u.y;", |x, _| x[0].smaller(x[4]).times(x[1])),
        &[ALIKE, SIGNS],
    ),
    with_edges(
        rule("the_larger", "return max(u.x, v.x) * u.y;", |x, _| x[0].larger(x[4]).times(x[1])),
        &[ALIKE, SIGNS],
    ),
    with_edges(
        rule("within_limits", "return clamp(u.x, u.y, u.z + 4.5);", |x, _| {
            let high = x[2].plus(number(4.5));
            match x[0].value {
                value if value > high.value => high,
                value if value < x[1].value => x[1],
                _ => x[0],
            }
        }),
        &LIMITS,
    ),
    with_edges(
        rule("within_constants", "return clamp(u.x, real(0.0), real(1.0)) * u.y;", |x, _| {
            let bounded = match x[0].value {
                value if value > 1.0 => number(1.0),
                value if value < 0.0 => number(0.0),
                _ => x[0],
            };
            bounded.times(x[1])
        }),
        &LIMITS,
    ),
    with_edges(rule("a_root", "return sqrt(abs(u.x)) * u.y;", |x, _| x[0].magnitude().root().times(x[1])), &[
        [0.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [1e-12, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    ]),
    beyond_df64(rule("fused", "return fma(u.x, u.y, u.z);", |x, _| x[0].times(x[1]).plus(x[2]))),
    beyond_df64(rule(
        "fused_with_constants",
        "return fma(u.x, real(2.0), u.z) * fma(real(3.0), u.y, real(1.0));",
        |x, _| {
            let left = x[0].times(number(2.0)).plus(x[2]);
            left.times(number(3.0).times(x[1]).plus(number(1.0)))
        },
    )),
    rule("steps", "return u.x * floor(3.0 * u.y) + u.z * ceil(u.w);", |x, _| {
        let steps = x[0].times(number((3.0 * x[1].value).floor()));
        steps.plus(x[2].times(number(x[3].value.ceil())))
    }),
    beyond_df64(rule("whole_parts", "return u.x * trunc(3.0 * u.y) + u.z * round(u.w);", |x, _| {
        let steps = x[0].times(number((3.0 * x[1].value).trunc()));
        steps.plus(x[2].times(number(x[3].value.round_ties_even())))
    })),
    // Vectors.
    rule("a_dot_product", "return dot(u.xyz, v.xyz);", |x, _| dot(xyz(x, 0), xyz(x, 4))),
    rule("a_dot_square", "return dot(u.xyz, u.xyz);", |x, _| dot(xyz(x, 0), xyz(x, 0))),
    rule("dot_products_of_two_and_four", "return dot(u.xy, v.zw) * dot(u, v);", |x, _| {
        let two = x[0].times(x[6]).plus(x[1].times(x[7]));
        two.times(dot(xyz(x, 0), xyz(x, 4)).plus(x[3].times(x[7])))
    }),
    rule("a_cross_product", "return dot(cross(u.xyz, v.xyz), vec3<real>(1.0, u.w, v.w));", |x, _| {
        dot(cross(xyz(x, 0), xyz(x, 4)), [number(1.0), x[3], x[7]])
    }),
    rule("a_vector_times_a_number", "let s = u.w * v.xyz - v.xyz * u.x; return dot(s, u.xyz);", |x, _| {
        let v = xyz(x, 4);
        dot(v.map(|v| x[3].times(v).minus(v.times(x[0]))), xyz(x, 0))
    }),
    rule("a_vector_over_a_number", "return dot(u.xyz / vec3<real>(u.w + 3.0), v.xyz);", |x, _| {
        dot(xyz(x, 0).map(|u| u.over(x[3].plus(number(3.0)))), xyz(x, 4))
    }),
    rule("products_of_lanes", "let s = u.xyz * v.xyz / (v.xyz * v.xyz + vec3<real>(1.0)); return s.x - s.y * s.z;", |x, _| {
        let quotient = |a: Dual, b: Dual| a.times(b).over(b.times(b).plus(number(1.0)));
        let s = each(xyz(x, 0), xyz(x, 4), quotient);
        s[0].minus(s[1].times(s[2]))
    }),
    with_edges(
        rule("lanes_by_size", "let s = min(u.xyz, v.xyz) - abs(max(u.xyz, v.xyz)); return dot(s, -u.xyz);", |x, _| {
            let (u, v) = (xyz(x, 0), xyz(x, 4));
            let s = each(each(u, v, Dual::smaller), each(u, v, Dual::larger), |a, b| a.minus(b.magnitude()));
            dot(s, u.map(Dual::negative))
        }),
        &[ALIKE, SIGNS],
    ),
    rule("roots_of_lanes", "let s = sqrt(u.xyz * u.xyz + vec3<real>(1.0)); return dot(s, v.xyz);", |x, _| {
        dot(xyz(x, 0).map(|u| u.times(u).plus(number(1.0)).root()), xyz(x, 4))
    }),
    rule("lanes_within_limits", "return dot(clamp(u.xyz, vec3<real>(-1.0), v.xyz + vec3<real>(2.0)), v.xyz);", |x, _| {
        let v = xyz(x, 4);
        let bounded = each(xyz(x, 0), v, |u, v| {
            let high = v.plus(number(2.0));
            match u.value {
                value if value > high.value => high,
                value if value < -1.0 => number(-1.0),
                _ => u,
            }
        });
        dot(bounded, v)
    }),
    rule("composed", "let s = vec4<real>(u.xy * v.x, vec2<real>(u.z, v.y)); return s.x * s.w + s.y - s.z;", |x, _| {
        x[0].times(x[4]).times(x[5]).plus(x[1].times(x[4])).minus(x[2])
    }),
    rule("the_same_in_all_lanes", "return dot(vec3<real>(u.w), v.xyz);", |x, _| dot([x[3]; 3], xyz(x, 4))),
    rule("lanes_in_another_order", "return dot(u.zxx, v.yyw);", |x, _| {
        dot([x[2], x[0], x[0]], [x[5], x[5], x[7]])
    }),
    // Choices.
    rule("chosen", "return select(u.x * u.y, u.z / (3.0 + u.x), u.w < v.w);", |x, _| {
        if x[3].value < x[7].value { x[2].over(x[0].plus(number(3.0))) } else { x[0].times(x[1]) }
    }),
    rule("chosen_or_constant", "return select(u.x * u.y, 1.0, u.w < v.w) + select(real(2.0), u.z, u.x > 0.0);", |x, _| {
        let left = if x[3].value < x[7].value { number(1.0) } else { x[0].times(x[1]) };
        left.plus(if x[0].value > 0.0 { x[2] } else { number(2.0) })
    }),
    rule("chosen_vectors", "return dot(select(u.xyz, v.xyz, u.w >= 0.0), v.xyz);", |x, _| {
        let v = xyz(x, 4);
        dot(if x[3].value >= 0.0 { v } else { xyz(x, 0) }, v)
    }),
    rule("branches", "
        var y = u.x;
        if u.y > 0.0 { y = y * u.z; if v.y <= u.x { y += v.x; } } else { y = v.z - y * y; }
        return y * u.w;", |x, _| {
        let mut y = x[0];
        if x[1].value > 0.0 {
            y = y.times(x[2]);
            if x[5].value <= x[0].value {
                y = y.plus(x[4]);
            }
        } else {
            y = x[6].minus(y.times(y));
        }
        y.times(x[3])
    }),
    rule("cases", "
        var y = u.x;
        switch n % 4u {
            case 0u: { y = y * u.y; }
            case 1u, 2u: { y = u.z; }
            default: { y -= v.x * v.y; }
        }
        return y * y;", |x, n| {
        let y = match n % 4 {
            0 => x[0].times(x[1]),
            1 | 2 => x[2],
            _ => x[0].minus(x[4].times(x[5])),
        };
        y.times(y)
    }),
    rule("early_ends", "
        if u.x > 0.5 { return u.y * v.x; }
        let y = u.z * u.w;
        if v.y > 0.0 { if u.w > 0.0 { return y; } }
        return y * v.z - u.x;", |x, _| {
        let y = x[2].times(x[3]);
        if x[0].value > 0.5 {
            x[1].times(x[4])
        } else if x[5].value > 0.0 && x[3].value > 0.0 {
            y
        } else {
            y.times(x[6]).minus(x[0])
        }
    }),
    rule("ends_in_cases", "
        switch n % 3u {
            case 0u: { return u.x * u.y; }
            case 1u: { if u.z > 0.0 { return v.x; } }
            default: {}
        }
        return u.w * v.w;", |x, n| match n % 3 {
        0 => x[0].times(x[1]),
        1 if x[2].value > 0.0 => x[4],
        _ => x[3].times(x[7]),
    }),
    // Memory.
    rule("a_variable", "var y = u.x; y *= u.y; let before = y; y = y + before * v.x; return y * before;", |x, _| {
        let before = x[0].times(x[1]);
        before.plus(before.times(x[4])).times(before)
    }),
    rule("parts_of_a_variable", "var y = u.xyz; y.x = y.y * v.x; y.z += y.x; return dot(y, v.xyz);", |x, _| {
        let first = x[1].times(x[4]);
        dot([first, x[1], x[2].plus(first)], xyz(x, 4))
    }),
    rule("an_array", "
        var y = array<real, 3>(u.x, u.y, u.z);
        y[n % 3u] = y[(n + 1u) % 3u] * v.x;
        y[0] += y[1];
        return y[0] * y[2] + y[1];", |x, n| {
        let mut y = xyz(x, 0);
        y[n as usize % 3] = y[(n as usize + 1) % 3].times(x[4]);
        y[0] = y[0].plus(y[1]);
        y[0].times(y[2]).plus(y[1])
    }),
    rule("a_struct", "
        struct Pose { place: vec3<real>, kind: u32, weight: real }
        fn moved(pose: Pose, by: real) -> Pose { return Pose(pose.place + by * pose.place.zxy, pose.kind, pose.weight * by); }
        =====
        var pose = Pose(u.xyz, n, u.w);
        pose = moved(pose, v.x);
        pose.place.x = pose.weight;
        let last = moved(pose, v.y);
        return dot(last.place, v.xyz) * last.weight;", |x, _| {
        let moved = |(place, weight): ([Dual; 3], Dual), by: Dual| {
            let [a, b, c] = place;
            (each(place, [c, a, b], |place, other| place.plus(by.times(other))), weight.times(by))
        };
        let (mut place, weight) = moved((xyz(x, 0), x[3]), x[4]);
        place[0] = weight;
        let (place, weight) = moved((place, weight), x[5]);
        dot(place, xyz(x, 4)).times(weight)
    }),
    rule("behind_a_pointer", "
        fn scaled_by(y: ptr<function, vec3<real>>, by: real) -> real { let before = (*y).x; *y = *y * by; return before + by; }
        =====
        var y = u.xyz;
        let z = scaled_by(&y, v.x);
        return dot(y, v.xyz) * z + scaled_by(&y, u.w) * y.z;", |x, _| {
        let once = xyz(x, 0).map(|y| y.times(x[4]));
        let z = x[0].plus(x[4]);
        let twice = once.map(|y| y.times(x[3]));
        dot(once, xyz(x, 4)).times(z).plus(once[0].plus(x[3]).times(twice[2]))
    }),
    rule("of_the_invocation", "
        var<private> kept: vec3<real>;
        fn keep(y: vec3<real>) { kept = y * y.x; }
        fn kept_part(by: real) -> real { return kept.y * by + kept.z; }
        =====
        keep(u.xyz);
        let y = kept_part(v.x);
        kept.z = y * u.w;
        return kept_part(v.y);", |x, _| {
        let kept = xyz(x, 0).map(|y| y.times(x[0]));
        let y = kept[1].times(x[4]).plus(kept[2]);
        kept[1].times(x[5]).plus(y.times(x[3]))
    }),
    // Functions with rules of their own.
    rule("an_exponential", "return exp_real(u.x) * u.y + exp_near_zero(0.1 * u.z);", |x, _| {
        x[0].exponential().times(x[1]).plus(x[2].times(number(0.1)).exponential())
    }),
    rule("a_logarithm", "return log_real(u.x * u.x + 0.5) * u.y;", |x, _| {
        x[0].times(x[0]).plus(number(0.5)).logarithm().times(x[1])
    }),
    rule("sines", "return sin_real(u.x * u.y) - cos_real(u.z) * u.w;", |x, _| {
        x[0].times(x[1]).sine().minus(x[2].cosine().times(x[3]))
    }),
    rule("said_to_vary_otherwise", "return attached(u.x * u.y, u.z * u.w) * v.x;", |x, _| {
        let (value, carrier) = (x[0].times(x[1]), x[2].times(x[3]));
        Dual { value: value.value, slopes: carrier.slopes }.times(x[4])
    }),
    rule("said_to_be_constant", "return detached(u.x * u.y) * u.z;", |x, _| {
        x[0].times(x[1]).constant().times(x[2])
    }),
    rule("a_note", "note(INNER, u.x * u.y); if u.z > 0.0 { note(INNER, v.x); } return u.w * v.x;", |x, _| {
        let noted = x[0].times(x[1]).plus(if x[2].value > 0.0 { x[4] } else { number(0.0) });
        let returned = x[3].times(x[4]);
        let slopes = noted.times(number(NOTED)).plus(returned).slopes;
        Dual { slopes, ..returned }
    }),
    rule("converted", "return real(n) * u.x + real(u.y) * f64(f32(3)) + real(i32(n) - 2);", |x, n| {
        let slopes = number(f64::from(n)).times(x[0]).plus(x[1].times(number(3.0)));
        slopes.plus(number(f64::from(n) - 2.0))
    }),
    // Loops: adjoints come from tangents.
    rule("a_loop", "
        fn polynomial(x: real, a: vec3<real>) -> real {
            var y = real(0.0);
            for (var i = 0u; i < 3u; i += 1u) { y = y * x + a.x + a[1] * real(i); }
            return y * a.z;
        }
        =====
        return polynomial(u.x, v.xyz) * u.y;", |x, _| {
        let mut y = number(0.0);
        for i in 0..3 {
            y = y.times(x[0]).plus(x[4]).plus(x[5].times(number(f64::from(i))));
        }
        y.times(x[6]).times(x[1])
    }),
    rule("a_loop_left_early", "
        fn root_of(x: real) -> real {
            var y = real(1.0);
            for (var i = 0u; i < 60u; i += 1u) {
                let step = (y * y - x) / (2.0 * y);
                y -= step;
                if abs(step) < 1e-14 { break; }
            }
            return y;
        }
        =====
        return root_of(u.x * u.x + 0.5) * u.y;", |x, _| {
        x[0].times(x[0]).plus(number(0.5)).root().times(x[1])
    }),
    rule("a_loop_that_counts", "
        var k = 0u;
        for (var i = 0u; i < n; i += 1u) { k += i; }
        return u.x * real(k % 5u);", |x, n| {
        x[0].times(number(f64::from((0..n).sum::<u32>() % 5)))
    }),
    rule("a_loop_that_notes", "
        fn noting(x: real) -> real { for (var i = 1u; i < 3u; i += 1u) { note(INNER, x * x * real(i)); } return x; }
        =====
        return noting(u.x) * u.y;", |x, _| {
        let returned = x[0].times(x[1]);
        let slopes = x[0].times(x[0]).times(number(3.0 * NOTED)).plus(returned).slopes;
        Dual { slopes, ..returned }
    }),
    rule(
        "a_loop_that_notes_an_argument",
        "
        fn noting_it(x: real, y: real) -> real {
            for (var i = 0u; i < 2u; i += 1u) { note(INNER, x); }
            return attached(2.0, y);
        }
        =====
        return noting_it(u.x, u.z) * u.y;",
        |x, _| {
            let returned = Dual { slopes: x[2].slopes, ..number(2.0) }.times(x[1]);
            let slopes = x[0].times(number(2.0 * NOTED)).plus(returned).slopes;
            Dual { slopes, ..returned }
        },
    ),
];
