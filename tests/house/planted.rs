//! What the eraser lets pass, and what it notices.

use crate::eraser::Erased;

const MODULE: &str = "
alias real = f32;
struct Ray { direction: vec3<real>, weight: real }
const SCALE: real = 0.75;
const TABLE = array<real, 3>(1.0, 2.0, 4.0);
@group(0) @binding(3) var<storage, read_write> sums: array<real>;
@group(0) @binding(4) var<storage, read> rays: array<Ray>;
var<private> reached: u32 = 0u;
var<private> missed: u32 = 0u;
fn raise(x: real, y: real) -> real { return x + y * SCALE; }
fn lower(x: real, y: real) -> real { return x - TABLE[u32(y)]; }
fn count(hit: bool) {
    if hit { reached = reached + 1u; } else { missed = missed + 2u; }
}
fn total() -> u32 { return 4u * reached + missed; }
@compute @workgroup_size(64) fn trace(@builtin(global_invocation_id) id: vec3<u32>) {
    let ray = rays[id.x];
    var sum = raise(ray.weight, ray.direction.x);
    for (var i = 0u; i < 4u; i++) { sum += lower(sum, ray.direction.y); }
    count(sum > 0.5);
    sums[id.x] = sum * real(total());
}
";

fn erased(text: &str) -> Erased {
    Erased::of(
        &naga::front::wgsl::parse_str(text).unwrap_or_else(|error| panic!("{}", error.emit_to_string(text))),
    )
}

fn is_same(text: &str) -> bool {
    let (one, other) = (erased(MODULE), erased(text));
    assert_eq!(one.first_difference(&other).is_none(), one.hash() == other.hash());
    one.hash() == other.hash()
}

fn replaced(from: &str, to: &str) -> String {
    assert!(MODULE.contains(from), "{from:?} is no longer in the module");
    MODULE.replace(from, to)
}

#[test]
fn other_names_are_the_same_module() {
    let names = [
        "Ray",
        "direction",
        "SCALE",
        "TABLE",
        "sums",
        "rays",
        "reached",
        "missed",
        "raise",
        "lower",
        "count",
    ];
    for name in names {
        assert!(is_same(&replaced(name, &format!("other_{name}"))), "{name}");
    }
    assert!(is_same(&replaced("alias real = f32;", "").replace("real", "f32")), "an alias");
}

#[test]
fn another_order_is_the_same_module() {
    let mut lines: Vec<&str> = MODULE.lines().collect();
    lines.rotate_left(9);
    assert_ne!(lines.join("\n"), MODULE);
    assert!(is_same(&lines.join("\n")));
}

#[test]
fn what_is_unused_and_what_only_hands_on_are_the_same_module() {
    let unused = format!(
        "{MODULE}const MORE: u32 = 3u; var<private> more: u32; fn unused() -> u32 {{ return more + MORE; }}"
    );
    assert!(is_same(&unused));
    let forwarder = "fn higher(x: real, y: real) -> real { return highest(x, y); }
        fn highest(a: real, b: real) -> real { return raise(a, b); }
        fn note(hit: bool) { count(hit); }";
    assert!(is_same(&(replaced("= raise(", "= higher(").replace("    count(", "    note(") + forwarder)));
}

#[test]
fn any_other_change_is_another_module() {
    let planted = [
        ("x + y", "x - y"),
        ("x + y", "y + x"),
        ("0.75", "0.7500001"),
        ("(1.0, 2.0, 4.0)", "(1.0, 2.0, 5.0)"),
        ("binding(3)", "binding(5)"),
        ("workgroup_size(64)", "workgroup_size(32)"),
        ("direction: vec3<real>, weight: real", "weight: real, direction: vec3<real>"),
        ("reached: u32 = 0u", "reached: u32 = 1u"),
        // Of two variables or functions of one type, the other one is taken.
        ("4u * reached + missed", "4u * missed + reached"),
        ("= raise(", "= lower("),
        ("if hit", "if !hit"),
        ("sum > 0.5", "sum >= 0.5"),
        ("i < 4u", "i < 5u"),
        ("    count(sum > 0.5);\n", ""),
        ("fn trace", "fn trace_new"),
        ("sums[id.x]", "sums[id.y]"),
        ("ray.direction.x", "ray.direction.z"),
    ];
    for (from, to) in planted {
        assert!(!is_same(&replaced(from, to)), "{from} -> {to}");
    }
}

/// A forwarder that swaps, drops or computes is none.
#[test]
fn what_does_more_than_hand_on_is_another_module() {
    for body in [
        "return raise(b, a);",
        "return raise(a, a);",
        "return raise(a, b) + 0.0;",
        "missed = 1u; return raise(a, b);",
    ] {
        let text =
            replaced("= raise(", "= higher(") + &format!("fn higher(a: real, b: real) -> real {{ {body} }}");
        assert!(!is_same(&text), "{body}");
    }
}

#[test]
fn the_first_difference_names_where_it_stands() {
    let difference = erased(MODULE).first_difference(&erased(&replaced("x + y", "x - y"))).unwrap();
    assert!(
        difference.contains("fn raise") && difference.contains("- ") && difference.contains("Subtract"),
        "{difference}"
    );
}
