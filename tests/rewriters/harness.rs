//! Functions of eight reals in WGSL, rewritten and run: their values, their derivatives forward, and back.

use crate::common::{Gpu, Storage, real_bytes, reals_of};
use crate::number::NUM_INPUTS;
use nsq_gpu::program::layout::rng::Sampler;
use nsq_gpu::program::rewrite::{df64, jvp, transpose};
use nsq_gpu::program::wgsl::library::{self, Integers, Real};
use std::fmt::Write;

/// The eight reals that a function takes: `u.x` to `v.w`.
pub type Inputs = [f64; NUM_INPUTS];

/// What a unit of a noted value is worth in the loss.
pub const NOTED: f64 = 3.0;

/// A function of WGSL: `fn NAME(u: vec4<real>, v: vec4<real>, n: u32) -> real`. `n` is the number of the point.
#[derive(Debug, Clone)]
pub struct Function {
    pub name: String,
    pub text: String,
}

/// What a device found: for each function, for each point, the value and the derivatives by the inputs.
pub type Found = Vec<Vec<(f64, Inputs)>>;

/// The rules name these functions (shaders/derivatives/seen.wgsl).
const SEEN: &str = "
fn attached(value: real, carrier: real) -> real { return value; }
fn detached(value: real) -> real { return value; }
fn note(cell: u32, value: real) {}
const INNER: u32 = 0xffffffffu;
";

/// True if a text calls functions of the library.
pub fn needs_library(text: &str) -> bool {
    ["exp_real", "exp_near_zero", "log_real", "sin_real", "cos_real"].iter().any(|name| text.contains(name))
}

/// The texts that functions call, in a tier.
fn library_of(real: Real, texts: &str) -> String {
    if real != Real::F64 || needs_library(texts) {
        library::source(real, Integers::Portable, Sampler::Pcg)
    } else {
        "alias real = f64;\n".to_owned()
    }
}

fn common(real: Real, functions: &[Function]) -> String {
    let texts: String = functions.iter().map(|function| function.text.as_str()).collect();
    library_of(real, &texts)
        + SEEN
        + crate::generated::SHARED
        + &texts
        + "
@group(0) @binding(5) var<storage, read> inputs: array<real>;
fn four(at: u32) -> vec4<real> {
    return vec4<real>(inputs[at], inputs[at + 1u], inputs[at + 2u], inputs[at + 3u]);
}
"
}

/// The text whose entry point evaluates every function in every row: a point of `inputs`, eight times.
pub fn plain_text(real: Real, functions: &[Function], num_rows: usize) -> String {
    let mut text = common(real, functions);
    text += "
@group(0) @binding(6) var<storage, read_write> values: array<real>;
@group(0) @binding(7) var<storage, read_write> tangents: array<real>;
var<private> inner: real;
fn deposit_tangent(cell: u32, tangent: real, number: u32) {
    if cell == INNER {
        inner += real(3.0) * tangent;
    } else {
        tangents[cell] = tangent + inner;
        inner = real(0.0);
    }
}
";
    let _ = writeln!(
        text,
        "@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {{
    let row = id.x;
    if row >= {num_rows}u {{ return; }}
    let u = four(8u * row);
    let v = four(8u * row + 4u);
    let n = row / 8u;"
    );
    for (i, Function { name, .. }) in functions.iter().enumerate() {
        let _ = writeln!(
            text,
            "    let y{i} = {name}(u, v, n);
    values[{first}u + row] = y{i};
    note({first}u + row, y{i});",
            first = i * num_rows
        );
    }
    text + "}\n"
}

/// The text whose entry point walks every function back at every point.
pub fn back_text(real: Real, functions: &[Function], num_points: usize) -> String {
    let mut text = common(real, functions);
    text += "
@group(0) @binding(7) var<storage, read_write> adjoints: array<real>;
var<private> noted: real;
var<private> lost: real;
var<private> cut_loops: real;
var<private> forward_noted: real;
fn adjoint_of(cell: u32) -> real { return real(3.0); }
fn deposit_tangent(cell: u32, tangent: real, number: u32) { forward_noted += real(3.0) * tangent; }
";
    for Function { name, .. } in functions {
        let _ = writeln!(
            text,
            "fn {name}_back(u: vec4<real>, v: vec4<real>, n: u32, adjoint_u: ptr<function, vec4<real>>,
    adjoint_v: ptr<function, vec4<real>>, adjoint: real) {{}}"
        );
    }
    let _ = writeln!(
        text,
        "@compute @workgroup_size(64)
fn {}(@builtin(global_invocation_id) id: vec3<u32>) {{
    let row = id.x;
    if row >= {num_points}u {{ return; }}
    let u = four(8u * row);
    let v = four(8u * row + 4u);
    var au: vec4<real>;
    var av: vec4<real>;",
        transpose::ENTRY_POINT
    );
    for (i, Function { name, .. }) in functions.iter().enumerate() {
        let first = i * num_points * NUM_INPUTS;
        let _ = writeln!(
            text,
            "    au = vec4<real>();
    av = vec4<real>();
    {name}_back(u, v, row, &au, &av, real(1.0));"
        );
        for (at, part) in ["au.x", "au.y", "au.z", "au.w", "av.x", "av.y", "av.z", "av.w"].iter().enumerate()
        {
            let _ = writeln!(text, "    adjoints[{first}u + 8u * row + {at}u] = {part};");
        }
    }
    text + "}\n"
}

pub fn parsed(text: &str) -> naga::Module {
    naga::front::wgsl::parse_str(text)
        .unwrap_or_else(|error| panic!("{}\n{text}", error.emit_to_string(text)))
}

/// A module in the tier's reals, as WGSL.
fn in_tier(real: Real, (module, text): (naga::Module, String)) -> String {
    match real {
        Real::Df64 => df64::rewrite(&module).unwrap().1,
        Real::F32 | Real::F64 => text,
    }
}

pub fn forward(real: Real, functions: &[Function], num_rows: usize) -> (naga::Module, String) {
    let text = plain_text(real, functions, num_rows);
    jvp::rewrite(&parsed(&text), naga::Scalar::F64, 1).unwrap()
}

pub fn back(real: Real, functions: &[Function], num_points: usize) -> (naga::Module, String) {
    transpose::rewrite(&parsed(&back_text(real, functions, num_points)), naga::Scalar::F64).unwrap()
}

fn zero_of(real: Real) -> Option<Storage> {
    (real == Real::Df64).then(|| Storage::read(df64::ZERO, &[0_u32; 4]))
}

fn groups(num_rows: usize) -> [u32; 3] {
    [u32::try_from(num_rows.div_ceil(64)).unwrap(), 1, 1]
}

/// Each point eight times, and with each row the direction in which it moves.
fn rows(points: &[Inputs]) -> (Vec<f64>, Vec<f64>) {
    let repeated = points.iter().flat_map(|point| (0..NUM_INPUTS).flat_map(move |_| *point));
    let direction = |i: usize| (0..NUM_INPUTS).map(move |j| if i == j { 1.0 } else { 0.0 });
    let directions = points.iter().flat_map(|_| (0..NUM_INPUTS).flat_map(direction));
    (repeated.collect(), directions.collect())
}

/// Runs a text that [`forward`] gave.
pub fn run_forward(gpu: &Gpu, real: Real, text: &str, num_functions: usize, points: &[Inputs]) -> Found {
    let (repeated, directions) = rows(points);
    let num_rows = points.len() * NUM_INPUTS;
    let num_bytes = real_bytes(real) * num_rows * num_functions;
    let mut storages = vec![
        Storage::reals(5, real, &repeated),
        Storage::zeros(6, num_bytes),
        Storage::zeros(7, num_bytes),
        Storage::reals(5 + jvp::BINDING_STRIDE, real, &directions),
    ];
    storages.extend(zero_of(real));
    let written = gpu.run_text(text, &storages, groups(num_rows));
    let [values, tangents] = [0, 1].map(|i| reals_of(real, &written[i]));
    let of = |function: usize, point: usize| {
        let first = function * num_rows + point * NUM_INPUTS;
        (values[first], tangents[first..first + NUM_INPUTS].try_into().unwrap())
    };
    (0..num_functions).map(|f| (0..points.len()).map(|p| of(f, p)).collect()).collect()
}

/// Values, and derivatives by tangents.
pub fn by_tangents(gpu: &Gpu, real: Real, functions: &[Function], points: &[Inputs]) -> Found {
    let text = in_tier(real, forward(real, functions, points.len() * NUM_INPUTS));
    run_forward(gpu, real, &text, functions.len(), points)
}

/// Runs a text that [`back`] gave.
pub fn run_back(
    gpu: &Gpu,
    real: Real,
    text: &str,
    num_functions: usize,
    points: &[Inputs],
) -> Vec<Vec<Inputs>> {
    let flat: Vec<f64> = points.iter().flatten().copied().collect();
    let num_bytes = real_bytes(real) * flat.len() * num_functions;
    let mut storages = vec![Storage::reals(5, real, &flat), Storage::zeros(7, num_bytes)];
    storages.extend(zero_of(real));
    let adjoints = reals_of(real, &gpu.run_text(text, &storages, groups(points.len()))[0]);
    let of = |function: usize, point: usize| {
        let first = (function * points.len() + point) * NUM_INPUTS;
        adjoints[first..first + NUM_INPUTS].try_into().unwrap()
    };
    (0..num_functions).map(|f| (0..points.len()).map(|p| of(f, p)).collect()).collect()
}

/// Derivatives by adjoints.
pub fn by_adjoints(gpu: &Gpu, real: Real, functions: &[Function], points: &[Inputs]) -> Vec<Vec<Inputs>> {
    let text = in_tier(real, back(real, functions, points.len()));
    run_back(gpu, real, &text, functions.len(), points)
}
