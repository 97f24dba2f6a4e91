//! Functions made by chance: branches, loops, calls, pointers, arrays. Each is written as WGSL, and evaluated here.

use crate::harness::{Function, Inputs, NOTED};
use crate::number::{Dual, Number, Three, cross, dot, each};
use nsq_gpu::program::layout::rng::splitmix64;
use std::fmt::Write;

/// A real.
#[derive(Debug, Clone)]
enum Real {
    Literal(f64),
    Input(usize),
    Variable(usize),
    Element(Index),
    Weight,
    Part(Box<Vector>, usize),
    Of(Unary, Box<Real>),
    Pair(Binary, Box<Real>, Box<Real>),
    Clamp(Box<[Real; 3]>),
    Fused(Box<[Real; 3]>),
    Dot(Box<Vector>, Box<Vector>),
    Choice(Box<Condition>, Box<Real>, Box<Real>),
    Call(usize, Box<Real>, Box<Vector>),
}

#[derive(Debug, Clone, Copy)]
enum Unary {
    Negative,
    Magnitude,
    /// sqrt(x x + 0.5)
    Root,
    Floor,
    Detached,
    Exponential,
    /// log(x x + 0.5)
    Logarithm,
    Sine,
    Cosine,
}

#[derive(Debug, Clone, Copy)]
enum Binary {
    Sum,
    Difference,
    Product,
    /// a / (b b + 1.5)
    Quotient,
    Smaller,
    Larger,
    Attached,
}

#[derive(Debug, Clone)]
enum Vector {
    Input(usize),
    Variable(usize),
    Place,
    Made(Box<[Real; 3]>),
    Same(Box<Real>),
    Pair(Lanes, Box<Vector>, Box<Vector>),
    Scaled(Box<Real>, Box<Vector>),
    Negative(Box<Vector>),
    Swizzle(Box<Vector>, [usize; 3]),
    Choice(Box<Condition>, Box<Vector>, Box<Vector>),
}

#[derive(Debug, Clone, Copy)]
enum Lanes {
    Sum,
    Difference,
    Product,
    Cross,
    Smaller,
}

#[derive(Debug, Clone)]
enum Condition {
    Less(Real, Real),
    /// A bit of the point's number.
    Bit(u32),
    Both(Box<Condition>, Box<Condition>),
}

#[derive(Debug, Clone, Copy)]
enum Index {
    Fixed(usize),
    /// The point's number, modulo 3.
    OfPoint,
}

#[derive(Debug, Clone)]
enum Statement {
    Real(usize, Real),
    Vector(usize, Vector),
    Part(usize, usize, Real),
    Element(Index, Real),
    Pose(Vector, Real),
    Weight(Real),
    /// A call that writes through a pointer.
    Update(usize, Real),
    Note(Real),
    Keep(Vector),
    /// Reads what was kept in a variable of the invocation.
    Recall(usize, Real),
    If(Condition, Vec<Statement>, Vec<Statement>),
    Cases([Vec<Statement>; 3]),
    Return(Condition, Real),
    Loop(u32, Vec<Statement>),
}

/// A body: of the function itself, or of one that it calls.
#[derive(Debug, Clone)]
struct Body {
    statements: Vec<Statement>,
    result: Real,
}

/// A function with the functions that it calls. The second of these has loops.
#[derive(Debug, Clone)]
pub struct Program {
    name: String,
    body: Body,
    called: [Body; 2],
}

const MOST: &str = "fn update_NAME(y: ptr<function, real>, by: real) { *y = *y * 0.5 + by * by - *y * by; }
struct Pose_NAME { place: vec3<real>, kind: u32, weight: real }
var<private> kept_NAME: vec3<real>;
fn keep_NAME(y: vec3<real>) { kept_NAME = y * y.x; }
fn recall_NAME(by: real) -> real { return kept_NAME.y * by + kept_NAME.z; }
";

// --- chance

struct Chance {
    word: u64,
    may: May,
}

/// What a program may contain.
#[derive(Debug, Clone, Copy)]
pub struct May {
    /// Call the shader library.
    pub library: bool,
    /// Use operations that df64 lacks.
    pub fused: bool,
    /// Call functions that say what a derivative sees. Differences do not know these.
    pub seen: bool,
}

/// Where an expression stands.
#[derive(Clone, Copy)]
struct Site {
    inputs: usize,
    vectors: usize,
    calls: bool,
    loops: bool,
}

const ROOT: Site = Site { inputs: 8, vectors: 2, calls: true, loops: false };
const CALLED: Site = Site { inputs: 4, vectors: 1, calls: false, loops: false };
const LOOPING: Site = Site { loops: true, ..CALLED };

impl Chance {
    fn below(&mut self, num: usize) -> usize {
        self.word = splitmix64(self.word);
        (self.word >> 33) as usize % num
    }

    fn real(&mut self, site: Site, depth: usize) -> Real {
        if depth == 0 {
            return match self.below(8) {
                0 => Real::Literal(self.below(17) as f64 / 4.0 - 2.0),
                1 | 2 => Real::Input(self.below(site.inputs)),
                3 => Real::Element(self.index()),
                4 => Real::Weight,
                _ => Real::Variable(self.below(4)),
            };
        }
        let next = |this: &mut Self| Box::new(this.real(site, depth - 1));
        match self.below(16) {
            0 => Real::Part(Box::new(self.vector(site, depth - 1)), self.below(3)),
            1..=3 => Real::Of(self.unary(), next(self)),
            4..=9 => Real::Pair(self.binary(), next(self), next(self)),
            10 => Real::Clamp(Box::new([0; 3].map(|_| self.real(site, depth - 1)))),
            11 if self.may.fused => Real::Fused(Box::new([0; 3].map(|_| self.real(site, depth - 1)))),
            12 => Real::Dot(Box::new(self.vector(site, depth - 1)), Box::new(self.vector(site, depth - 1))),
            13 => Real::Choice(Box::new(self.condition(site, depth - 1)), next(self), next(self)),
            14 if site.calls => Real::Call(self.below(2), next(self), Box::new(self.vector(site, depth - 1))),
            _ => Real::Pair(Binary::Quotient, next(self), next(self)),
        }
    }

    fn unary(&mut self) -> Unary {
        use Unary::{Cosine, Detached, Exponential, Floor, Logarithm, Magnitude, Negative, Root, Sine};
        let all = [Negative, Magnitude, Root, Root, Floor, Detached, Sine, Cosine, Logarithm, Exponential];
        match all[self.below(if self.may.library { all.len() } else { 6 })] {
            Detached if !self.may.seen => Negative,
            unary => unary,
        }
    }

    fn binary(&mut self) -> Binary {
        use Binary::{Attached, Difference, Larger, Product, Quotient, Smaller, Sum};
        let all = [Sum, Sum, Difference, Product, Product, Quotient, Smaller, Larger, Attached];
        all[self.below(if self.may.seen { all.len() } else { all.len() - 1 })]
    }

    fn vector(&mut self, site: Site, depth: usize) -> Vector {
        if depth == 0 {
            return match self.below(4) {
                0 => Vector::Input(self.below(site.vectors)),
                1 => Vector::Place,
                _ => Vector::Variable(self.below(2)),
            };
        }
        let next = |this: &mut Self| Box::new(this.vector(site, depth - 1));
        match self.below(8) {
            0 => Vector::Made(Box::new([0; 3].map(|_| self.real(site, depth - 1)))),
            1 => Vector::Same(Box::new(self.real(site, depth - 1))),
            2 => Vector::Scaled(Box::new(self.real(site, depth - 1)), next(self)),
            3 => Vector::Negative(next(self)),
            4 => Vector::Swizzle(next(self), [0; 3].map(|_| self.below(3))),
            5 => Vector::Choice(Box::new(self.condition(site, depth - 1)), next(self), next(self)),
            _ => {
                use Lanes::{Cross, Difference, Product, Smaller, Sum};
                let lanes = [Sum, Difference, Product, Cross, Smaller][self.below(5)];
                Vector::Pair(lanes, next(self), next(self))
            }
        }
    }

    fn condition(&mut self, site: Site, depth: usize) -> Condition {
        match self.below(4) {
            0 => Condition::Bit(self.below(4) as u32),
            1 if depth > 0 => Condition::Both(
                Box::new(self.condition(site, depth - 1)),
                Box::new(self.condition(site, depth - 1)),
            ),
            _ => Condition::Less(self.real(site, depth.min(1)), self.real(site, depth.min(1))),
        }
    }

    fn index(&mut self) -> Index {
        match self.below(4) {
            3 => Index::OfPoint,
            fixed => Index::Fixed(fixed),
        }
    }

    fn statements(&mut self, site: Site, depth: usize, num: usize) -> Vec<Statement> {
        (0..num).map(|_| self.statement(site, depth)).collect()
    }

    fn statement(&mut self, site: Site, depth: usize) -> Statement {
        let inner = |this: &mut Self| {
            let num = 1 + this.below(3);
            this.statements(site, depth - 1, num)
        };
        match self.below(20) {
            0..=4 => Statement::Real(self.below(4), self.real(site, 2)),
            5 | 6 => Statement::Vector(self.below(2), self.vector(site, 2)),
            7 => Statement::Part(self.below(2), self.below(3), self.real(site, 2)),
            8 | 9 => Statement::Element(self.index(), self.real(site, 2)),
            10 => Statement::Pose(self.vector(site, 1), self.real(site, 1)),
            11 => Statement::Weight(self.real(site, 2)),
            12 => Statement::Note(self.real(site, 1)),
            13 if site.calls => Statement::Update(self.below(4), self.real(site, 1)),
            14 if site.calls => Statement::Keep(self.vector(site, 1)),
            15 if site.calls => Statement::Recall(self.below(4), self.real(site, 1)),
            16 => Statement::Return(self.condition(site, 1), self.real(site, 1)),
            17 if depth > 0 && site.loops => Statement::Loop(1 + self.below(3) as u32, inner(self)),
            18 if depth > 0 => Statement::Cases([0; 3].map(|_| inner(self))),
            19 if depth > 0 => {
                let (accept, reject) = (inner(self), inner(self));
                Statement::If(self.condition(site, 1), accept, reject)
            }
            _ => Statement::Real(self.below(4), self.real(site, 3)),
        }
    }

    fn body(&mut self, site: Site) -> Body {
        let num = 2 + self.below(4);
        let mut statements = self.statements(site, 2, num);
        if site.loops {
            let inner = self.statements(site, 1, 2);
            statements.push(Statement::Loop(2, inner));
        }
        Body { statements, result: self.real(site, 2) }
    }
}

impl Program {
    /// A program by chance.
    pub fn by_chance(seed: u64, may: May) -> Self {
        let mut chance = Chance { word: splitmix64(seed), may };
        let called = [chance.body(CALLED), chance.body(LOOPING)];
        Program { name: format!("made_{seed}"), body: chance.body(ROOT), called }
    }

    pub fn function(&self) -> Function {
        let mut text = MOST.replace("NAME", &self.name);
        for (i, body) in self.called.iter().enumerate() {
            let head = format!("fn called{i}_{}(x: real, y: vec3<real>, n: u32) -> real", self.name);
            self.write(&mut text, &head, body, &Names::of_called());
        }
        let head = format!("fn {}(u: vec4<real>, v: vec4<real>, n: u32) -> real", self.name);
        self.write(&mut text, &head, &self.body, &Names::of_root());
        Function { name: self.name.clone(), text }
    }

    fn write(&self, text: &mut String, head: &str, body: &Body, names: &Names) {
        let [a, b, c, d] = [0, 1, 2, 3].map(|i| names.reals[i]);
        let vector = names.vectors[0];
        let writer = Writer { names, program: &self.name };
        let _ = writeln!(
            text,
            "{head} {{
    var r0 = {a}; var r1 = {b}; var r2 = {c}; var r3 = {d};
    var w0 = {vector}; var w1 = {vector} * {a};
    var e = array<real, 3>({b}, {c}, {d} * {a});
    var s = Pose_{name}({vector} - vec3<real>({b}), n, {c});",
            name = self.name
        );
        if names.is_root {
            let _ = writeln!(text, "    keep_{}({vector});", self.name);
        }
        writer.block(text, &body.statements, 1);
        let _ = writeln!(text, "    return {};\n}}", writer.real(&body.result));
    }

    /// The value, and the slopes of the loss: of what is returned, and of what is noted.
    pub fn value(&self, point: &Inputs, n: u32) -> Dual {
        let inputs = Dual::inputs(point);
        let vectors = vec![[inputs[0], inputs[1], inputs[2]], [inputs[4], inputs[5], inputs[6]]];
        let mut noted = Dual::of(0.0);
        let returned = self.run(&self.body, &inputs, vectors, n, &mut noted, true);
        Dual { slopes: returned.plus(noted.times(Dual::of(NOTED))).slopes, ..returned }
    }

    /// The loss alone, in plain numbers.
    pub fn loss(&self, point: &Inputs, n: u32) -> f64 {
        let vectors = vec![[point[0], point[1], point[2]], [point[4], point[5], point[6]]];
        let mut noted = 0.0;
        self.run(&self.body, point, vectors, n, &mut noted, true) + NOTED * noted
    }

    fn run<N: Number>(
        &self,
        body: &Body,
        inputs: &[N],
        vectors: Vec<Three<N>>,
        n: u32,
        noted: &mut N,
        is_root: bool,
    ) -> N {
        let v = vectors[0];
        let mut state = State {
            program: self,
            inputs: inputs.to_vec(),
            n,
            r: [inputs[0], inputs[1], inputs[2], inputs[3]],
            w: [v, v.map(|part| part.times(inputs[0]))],
            e: [inputs[1], inputs[2], inputs[3].times(inputs[0])],
            s: (v.map(|part| part.minus(inputs[1])), inputs[2]),
            kept: v.map(|part| part.times(v[0])),
            vectors,
            noted,
            is_root,
        };
        match state.block(&body.statements) {
            Some(returned) => returned,
            None => state.real(&body.result),
        }
    }
}

// --- values

struct State<'p, N> {
    program: &'p Program,
    inputs: Vec<N>,
    vectors: Vec<Three<N>>,
    n: u32,
    r: [N; 4],
    w: [Three<N>; 2],
    e: [N; 3],
    s: (Three<N>, N),
    kept: Three<N>,
    noted: &'p mut N,
    is_root: bool,
}

impl<N: Number> State<'_, N> {
    fn index(&self, index: Index) -> usize {
        match index {
            Index::Fixed(index) => index,
            Index::OfPoint => self.n as usize % 3,
        }
    }

    fn condition(&mut self, condition: &Condition) -> bool {
        match condition {
            Condition::Less(a, b) => self.real(a).value() < self.real(b).value(),
            Condition::Bit(bit) => self.n >> bit & 1 != 0,
            // Both are evaluated, as calls in them note.
            Condition::Both(a, b) => self.condition(a) & self.condition(b),
        }
    }

    fn real(&mut self, real: &Real) -> N {
        match real {
            Real::Literal(value) => N::of(*value),
            Real::Input(i) => self.inputs[*i],
            Real::Variable(i) => self.r[*i],
            Real::Element(index) => self.e[self.index(*index)],
            Real::Weight => self.s.1,
            Real::Part(vector, i) => self.vector(vector)[*i],
            Real::Of(unary, x) => {
                let x = self.real(x);
                let above = |x: N| x.times(x).plus(N::of(0.5));
                match unary {
                    Unary::Negative => x.negative(),
                    Unary::Magnitude => x.magnitude(),
                    Unary::Root => above(x).root(),
                    Unary::Floor => N::of(x.value().floor()),
                    Unary::Detached => x.constant(),
                    Unary::Exponential => x.sine().exponential(),
                    Unary::Logarithm => above(x).logarithm(),
                    Unary::Sine => x.sine(),
                    Unary::Cosine => x.cosine(),
                }
            }
            Real::Pair(binary, a, b) => {
                let (a, b) = (self.real(a), self.real(b));
                match binary {
                    Binary::Sum => a.plus(b),
                    Binary::Difference => a.minus(b),
                    Binary::Product => a.times(b),
                    Binary::Quotient => a.over(b.times(b).plus(N::of(1.5))),
                    Binary::Smaller => a.smaller(b),
                    Binary::Larger => a.larger(b),
                    Binary::Attached => a.constant().plus(b.minus(b.constant())),
                }
            }
            Real::Clamp(parts) => {
                let [x, low, width] = [0, 1, 2].map(|i| self.real(&parts[i]));
                let high = low.plus(width.magnitude()).plus(N::of(0.25));
                match x.value() {
                    value if value > high.value() => high,
                    value if value < low.value() => low,
                    _ => x,
                }
            }
            Real::Fused(parts) => {
                let [a, b, c] = [0, 1, 2].map(|i| self.real(&parts[i]));
                a.times(b).plus(c)
            }
            Real::Dot(a, b) => dot(self.vector(a), self.vector(b)),
            Real::Choice(condition, a, b) => {
                // As `select`, which evaluates both.
                let (a, b) = (self.real(a), self.real(b));
                if self.condition(condition) { a } else { b }
            }
            Real::Call(called, x, y) => {
                let (x, y) = (self.real(x), self.vector(y));
                let body = &self.program.called[*called];
                self.program.run(body, &[x, y[0], y[1], y[2]], vec![y], self.n, self.noted, false)
            }
        }
    }

    fn vector(&mut self, vector: &Vector) -> Three<N> {
        match vector {
            Vector::Input(i) => self.vectors[*i],
            Vector::Variable(i) => self.w[*i],
            Vector::Place => self.s.0,
            Vector::Made(parts) => [0, 1, 2].map(|i| self.real(&parts[i])),
            Vector::Same(x) => [self.real(x); 3],
            Vector::Pair(lanes, a, b) => {
                let (a, b) = (self.vector(a), self.vector(b));
                match lanes {
                    Lanes::Sum => each(a, b, N::plus),
                    Lanes::Difference => each(a, b, N::minus),
                    Lanes::Product => each(a, b, N::times),
                    Lanes::Cross => cross(a, b),
                    Lanes::Smaller => each(a, b, N::smaller),
                }
            }
            Vector::Scaled(by, a) => {
                let by = self.real(by);
                self.vector(a).map(|part| by.times(part))
            }
            Vector::Negative(a) => self.vector(a).map(N::negative),
            Vector::Swizzle(a, parts) => {
                let a = self.vector(a);
                parts.map(|part| a[part])
            }
            Vector::Choice(condition, a, b) => {
                let (a, b) = (self.vector(a), self.vector(b));
                if self.condition(condition) { a } else { b }
            }
        }
    }

    /// What is returned, if a statement returns.
    fn block(&mut self, statements: &[Statement]) -> Option<N> {
        statements.iter().find_map(|statement| self.statement(statement))
    }

    fn statement(&mut self, statement: &Statement) -> Option<N> {
        match statement {
            Statement::Real(i, x) => self.r[*i] = self.real(x),
            Statement::Vector(i, x) => self.w[*i] = self.vector(x),
            Statement::Part(i, part, x) => self.w[*i][*part] = self.real(x),
            Statement::Element(index, x) => {
                let x = self.real(x);
                self.e[self.index(*index)] = x;
            }
            Statement::Pose(place, weight) => self.s = (self.vector(place), self.real(weight)),
            Statement::Weight(x) => self.s.1 = self.real(x),
            Statement::Update(i, x) => {
                let (y, by) = (self.r[*i], self.real(x));
                self.r[*i] = y.times(N::of(0.5)).plus(by.times(by)).minus(y.times(by));
            }
            Statement::Note(x) => {
                let x = self.real(x);
                *self.noted = self.noted.plus(x);
            }
            Statement::Keep(x) => {
                let x = self.vector(x);
                self.kept = x.map(|part| part.times(x[0]));
            }
            Statement::Recall(i, x) => {
                let by = self.real(x);
                self.r[*i] = self.kept[1].times(by).plus(self.kept[2]);
            }
            Statement::If(condition, accept, reject) => {
                let taken = if self.condition(condition) { accept } else { reject };
                return self.block(taken);
            }
            Statement::Cases(cases) => return self.block(&cases[self.n as usize % 3]),
            Statement::Return(condition, x) => {
                if self.condition(condition) {
                    return Some(self.real(x));
                }
            }
            Statement::Loop(num, body) => return (0..*num).find_map(|_| self.block(body)),
        }
        debug_assert!(self.is_root || !matches!(statement, Statement::Keep(_) | Statement::Update(..)));
        None
    }
}

// --- text

struct Names {
    reals: Vec<&'static str>,
    vectors: Vec<&'static str>,
    is_root: bool,
}

impl Names {
    fn of_root() -> Self {
        let reals = vec!["u.x", "u.y", "u.z", "u.w", "v.x", "v.y", "v.z", "v.w"];
        Names { reals, vectors: vec!["u.xyz", "v.xyz"], is_root: true }
    }

    fn of_called() -> Self {
        Names { reals: vec!["x", "y.x", "y.y", "y.z"], vectors: vec!["y"], is_root: false }
    }
}

struct Writer<'p> {
    names: &'p Names,
    program: &'p str,
}

impl Writer<'_> {
    fn index(index: Index) -> String {
        match index {
            Index::Fixed(index) => index.to_string(),
            Index::OfPoint => "n % 3u".to_owned(),
        }
    }

    fn condition(&self, condition: &Condition) -> String {
        match condition {
            Condition::Less(a, b) => format!("({} < {})", self.real(a), self.real(b)),
            Condition::Bit(bit) => format!("((n >> {bit}u & 1u) != 0u)"),
            Condition::Both(a, b) => format!("({} & {})", self.condition(a), self.condition(b)),
        }
    }

    fn real(&self, real: &Real) -> String {
        match real {
            // Behind a call, because naga evaluates few functions of literals.
            Real::Literal(value) => format!("constant(real({value:?}))"),
            Real::Input(i) => self.names.reals[*i].to_owned(),
            Real::Variable(i) => format!("r{i}"),
            Real::Element(index) => format!("e[{}]", Self::index(*index)),
            Real::Weight => "s.weight".to_owned(),
            Real::Part(vector, i) => format!("{}.{}", self.vector(vector), ["x", "y", "z"][*i]),
            Real::Of(unary, x) => {
                let x = self.real(x);
                match unary {
                    Unary::Negative => format!("(-{x})"),
                    Unary::Magnitude => format!("abs({x})"),
                    Unary::Root => format!("sqrt(pow2({x}))"),
                    Unary::Floor => format!("floor({x})"),
                    Unary::Detached => format!("detached({x})"),
                    Unary::Exponential => format!("exp_real(sin_real({x}))"),
                    Unary::Logarithm => format!("log_real(pow2({x}))"),
                    Unary::Sine => format!("sin_real({x})"),
                    Unary::Cosine => format!("cos_real({x})"),
                }
            }
            Real::Pair(binary, a, b) => {
                let (a, b) = match (binary, &**a, &**b) {
                    (Binary::Sum | Binary::Difference | Binary::Product, Real::Literal(a), b) => {
                        (format!("real({a:?})"), self.real(b))
                    }
                    (Binary::Sum | Binary::Difference | Binary::Product, a, Real::Literal(b)) => {
                        (self.real(a), format!("real({b:?})"))
                    }
                    (_, a, b) => (self.real(a), self.real(b)),
                };
                match binary {
                    Binary::Sum => format!("({a} + {b})"),
                    Binary::Difference => format!("({a} - {b})"),
                    Binary::Product => format!("({a} * {b})"),
                    Binary::Quotient => format!("over({a}, {b})"),
                    Binary::Smaller => format!("min({a}, {b})"),
                    Binary::Larger => format!("max({a}, {b})"),
                    Binary::Attached => format!("attached({a}, {b})"),
                }
            }
            Real::Clamp(parts) => {
                let [x, low, width] = [0, 1, 2].map(|i| self.real(&parts[i]));
                format!("bounded({x}, {low}, {width})")
            }
            Real::Fused(parts) => {
                let [a, b, c] = [0, 1, 2].map(|i| self.real(&parts[i]));
                format!("fma({a}, {b}, {c})")
            }
            Real::Dot(a, b) => format!("dot({}, {})", self.vector(a), self.vector(b)),
            Real::Choice(condition, a, b) => {
                format!("select({}, {}, {})", self.real(b), self.real(a), self.condition(condition))
            }
            Real::Call(called, x, y) => {
                format!("called{called}_{}({}, {}, n)", self.program, self.real(x), self.vector(y))
            }
        }
    }

    fn vector(&self, vector: &Vector) -> String {
        match vector {
            Vector::Input(i) => self.names.vectors[*i].to_owned(),
            Vector::Variable(i) => format!("w{i}"),
            Vector::Place => "s.place".to_owned(),
            Vector::Made(parts) => {
                let [x, y, z] = [0, 1, 2].map(|i| self.real(&parts[i]));
                format!("vec3<real>({x}, {y}, {z})")
            }
            Vector::Same(x) => format!("vec3<real>({})", self.real(x)),
            Vector::Pair(lanes, a, b) => {
                let (a, b) = (self.vector(a), self.vector(b));
                match lanes {
                    Lanes::Sum => format!("({a} + {b})"),
                    Lanes::Difference => format!("({a} - {b})"),
                    Lanes::Product => format!("({a} * {b})"),
                    Lanes::Cross => format!("cross({a}, {b})"),
                    Lanes::Smaller => format!("min({a}, {b})"),
                }
            }
            Vector::Scaled(by, a) => format!("({} * {})", self.real(by), self.vector(a)),
            Vector::Negative(a) => format!("(-{})", self.vector(a)),
            Vector::Swizzle(a, parts) => {
                let parts: String = parts.iter().map(|part| ["x", "y", "z"][*part]).collect();
                format!("({}).{parts}", self.vector(a))
            }
            Vector::Choice(condition, a, b) => {
                format!("select({}, {}, {})", self.vector(b), self.vector(a), self.condition(condition))
            }
        }
    }

    fn block(&self, text: &mut String, statements: &[Statement], depth: usize) {
        for statement in statements {
            self.statement(text, statement, depth);
        }
    }

    fn statement(&self, text: &mut String, statement: &Statement, depth: usize) {
        let name = self.program;
        let indent = "    ".repeat(depth);
        let _ = write!(text, "{indent}");
        let _ = match statement {
            Statement::Real(i, x) => writeln!(text, "r{i} = {};", self.real(x)),
            Statement::Vector(i, x) => writeln!(text, "w{i} = {};", self.vector(x)),
            Statement::Part(i, part, x) => {
                writeln!(text, "w{i}.{} = {};", ["x", "y", "z"][*part], self.real(x))
            }
            Statement::Element(index, x) => {
                writeln!(text, "e[{}] = {};", Self::index(*index), self.real(x))
            }
            Statement::Pose(place, weight) => {
                writeln!(text, "s = Pose_{name}({}, n, {});", self.vector(place), self.real(weight))
            }
            Statement::Weight(x) => writeln!(text, "s.weight = {};", self.real(x)),
            Statement::Update(i, x) => writeln!(text, "update_{name}(&r{i}, {});", self.real(x)),
            Statement::Note(x) => writeln!(text, "note(INNER, {});", self.real(x)),
            Statement::Keep(x) => writeln!(text, "keep_{name}({});", self.vector(x)),
            Statement::Recall(i, x) => writeln!(text, "r{i} = recall_{name}({});", self.real(x)),
            Statement::If(condition, accept, reject) => {
                let _ = writeln!(text, "if {} {{", self.condition(condition));
                self.block(text, accept, depth + 1);
                let _ = writeln!(text, "{indent}}} else {{");
                self.block(text, reject, depth + 1);
                writeln!(text, "{indent}}}")
            }
            Statement::Cases(cases) => {
                let _ = writeln!(text, "switch n % 3u {{");
                for (label, case) in ["case 0u", "case 1u", "default"].iter().zip(cases) {
                    let _ = writeln!(text, "{indent}{label}: {{");
                    self.block(text, case, depth + 1);
                    let _ = writeln!(text, "{indent}}}");
                }
                writeln!(text, "{indent}}}")
            }
            Statement::Return(condition, x) => {
                writeln!(text, "if {} {{ return {}; }}", self.condition(condition), self.real(x))
            }
            Statement::Loop(num, body) => {
                let _ = writeln!(text, "for (var i{depth} = 0u; i{depth} < {num}u; i{depth} += 1u) {{");
                self.block(text, body, depth + 1);
                writeln!(text, "{indent}}}")
            }
        };
    }
}

/// What texts of programs call.
pub const SHARED: &str = "
fn constant(x: real) -> real { return x; }
fn pow2(x: real) -> real { return x * x + real(0.5); }
fn over(a: real, b: real) -> real { return a / (b * b + real(1.5)); }
fn bounded(x: real, low: real, width: real) -> real { return clamp(x, low, low + abs(width) + real(0.25)); }
";
