//! Rewrites one function, with pairs of f32 in place of f64.

use crate::error::Result;
use crate::program::rewrite::df64::rewriting::{Rewriting, literal_f32, unknown};
use crate::program::rewrite::function_builder::{FunctionBuilder, Rewrite};
use naga::valid::FunctionInfo;
use naga::{
    BinaryOperator, Block, Expression, Function, Handle, Literal, MathFunction, RelationalFunction, Scalar,
    ScalarKind, Span, Statement, TypeInner, UnaryOperator, VectorSize,
};
use std::collections::HashMap;

type Value = Handle<Expression>;

/// How many reals a value holds directly.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Reals {
    /// None, or reals inside a struct or behind a pointer.
    None,
    One,
    Vector(VectorSize),
}

/// Rewrites a function for the module that grows in `shared`.
pub fn rewrite_function(shared: &mut Rewriting, old: &Function, info: &FunctionInfo) -> Result<Function> {
    let mut new = Function { name: old.name.clone(), ..Default::default() };
    for argument in &old.arguments {
        let ty = shared.map_type(argument.ty)?;
        new.arguments.push(naga::FunctionArgument { ty, ..argument.clone() });
    }
    if let Some(result) = &old.result {
        let ty = shared.map_type(result.ty)?;
        new.result = Some(naga::FunctionResult { ty, ..result.clone() });
    }
    let mut rewriter = Rewriter { shared, old, info, new, known: HashMap::new(), locals: HashMap::new() };
    rewriter.local_variables()?;
    rewriter.new.body = rewriter.block(&old.body)?;
    for (value, name) in &old.named_expressions {
        if let Some(value) = rewriter.known.get(value) {
            rewriter.new.named_expressions.insert(*value, name.clone());
        }
    }
    Ok(rewriter.new)
}

struct Rewriter<'r, 'm> {
    shared: &'r mut Rewriting<'m>,
    old: &'r Function,
    info: &'r FunctionInfo,
    new: Function,
    known: HashMap<Value, Value>,
    locals: HashMap<Handle<naga::LocalVariable>, Handle<naga::LocalVariable>>,
}

impl FunctionBuilder for Rewriter<'_, '_> {
    fn new_function(&mut self) -> &mut Function {
        &mut self.new
    }
}

impl Rewrite for Rewriter<'_, '_> {
    fn new_type(&mut self, old: Handle<naga::Type>) -> Result<Handle<naga::Type>> {
        self.shared.map_type(old)
    }

    fn value(&mut self, old: Value) -> Result<Value> {
        if let Some(new) = self.known.get(&old) {
            return Ok(*new);
        }
        let new = match &self.old.expressions[old] {
            Expression::Literal(Literal::F64(value)) => Expression::Constant(self.shared.literal(*value)?),
            Expression::Literal(literal) => Expression::Literal(*literal),
            Expression::Constant(constant) => Expression::Constant(self.shared.constants[constant]),
            Expression::ZeroValue(ty) => Expression::ZeroValue(self.shared.map_type(*ty)?),
            Expression::FunctionArgument(index) => Expression::FunctionArgument(*index),
            Expression::GlobalVariable(variable) => Expression::GlobalVariable(self.shared.globals[variable]),
            Expression::LocalVariable(variable) => Expression::LocalVariable(self.locals[variable]),
            other => return Err(unknown(other)),
        };
        let new = self.append(new);
        self.known.insert(old, new);
        Ok(new)
    }

    fn statement(&mut self, statement: &Statement, out: &mut Block) -> Result<()> {
        let new = match statement {
            Statement::Emit(range) => {
                for value in range.clone() {
                    let new = self.emitted(value, out)?;
                    self.known.insert(value, new);
                }
                return Ok(());
            }
            Statement::Return { value } => Statement::Return { value: self.optional(*value)? },
            Statement::Store { pointer, value } => {
                Statement::Store { pointer: self.value(*pointer)?, value: self.value(*value)? }
            }
            Statement::Atomic { pointer, fun, value, result } => {
                let fun = self.atomic_function(fun)?;
                Statement::Atomic {
                    pointer: self.value(*pointer)?,
                    fun,
                    value: self.value(*value)?,
                    result: result.map(|result| self.atomic_result(result)).transpose()?,
                }
            }
            Statement::Call { function, arguments, result } => {
                let function = self.shared.functions[function];
                let arguments = self.values(arguments)?;
                let result = result.map(|old| {
                    let new = self.append(Expression::CallResult(function));
                    self.known.insert(old, new);
                    new
                });
                Statement::Call { function, arguments, result }
            }
            other => self.control(other)?.ok_or_else(|| unknown(other))?,
        };
        out.push(new, Span::UNDEFINED);
        Ok(())
    }
}

impl Rewriter<'_, '_> {
    fn local_variables(&mut self) -> Result<()> {
        for (handle, variable) in self.old.local_variables.iter() {
            let ty = self.shared.map_type(variable.ty)?;
            let init = variable.init.map(|init| self.initial(init)).transpose()?;
            let new = naga::LocalVariable { name: variable.name.clone(), ty, init };
            let new = self.new.local_variables.append(new, Span::UNDEFINED);
            self.locals.insert(handle, new);
        }
        Ok(())
    }

    /// The initial value of a variable: a constant, which is not evaluated anywhere.
    fn initial(&mut self, old: Value) -> Result<Value> {
        let Expression::Compose { ty, components } = &self.old.expressions[old] else {
            return self.value(old);
        };
        let components = components.iter().map(|c| self.initial(*c)).collect::<Result<_>>()?;
        let ty = self.shared.map_type(*ty)?;
        Ok(self.append(Expression::Compose { ty, components }))
    }

    fn atomic_result(&mut self, old: Value) -> Result<Value> {
        let Expression::AtomicResult { ty, comparison } = self.old.expressions[old] else {
            return Err(unknown("the result of an atomic"));
        };
        let ty = self.shared.map_type(ty)?;
        let new = self.append(Expression::AtomicResult { ty, comparison });
        self.known.insert(old, new);
        Ok(new)
    }

    /// Calls a function of the library.
    fn call(&mut self, name: &str, arguments: &[Value], out: &mut Block) -> Result<Value> {
        let function = self.shared.library_function(name)?;
        let result = self.append(Expression::CallResult(function));
        let call = Statement::Call { function, arguments: arguments.to_vec(), result: Some(result) };
        out.push(call, Span::UNDEFINED);
        Ok(result)
    }

    fn f32(&mut self, value: f32) -> Value {
        self.append(literal_f32(value))
    }

    fn reals(&self, old: Value) -> Reals {
        match self.info[old].ty.inner_with(&self.shared.old.types) {
            TypeInner::Scalar(Scalar::F64) => Reals::One,
            TypeInner::Vector { size, scalar: Scalar::F64 } => Reals::Vector(*size),
            _ => Reals::None,
        }
    }

    fn has_reals(&self, old: Value) -> bool {
        self.reals(old) != Reals::None
    }

    /// The scalars of a new value that stands for a vector, or as many copies of a scalar.
    fn lanes(&mut self, old: Value, size: VectorSize, out: &mut Block) -> Result<Vec<Value>> {
        let value = self.value(old)?;
        let is_vector =
            matches!(self.info[old].ty.inner_with(&self.shared.old.types), TypeInner::Vector { .. });
        Ok((0..size as u32).map(|lane| if is_vector { self.lane(value, lane, out) } else { value }).collect())
    }

    fn lane(&mut self, value: Value, index: u32, out: &mut Block) -> Value {
        if let Expression::Compose { components, .. } = &self.new.expressions[value] {
            return components[index as usize];
        }
        self.emit(Expression::AccessIndex { base: value, index }, out)
    }

    fn vector(&mut self, components: Vec<Value>, out: &mut Block) -> Value {
        let ty = self.shared.columns(size_of(&components));
        self.emit(Expression::Compose { ty, components }, out)
    }

    fn pair(&mut self, high: Value, out: &mut Block) -> Value {
        let low = self.f32(0.0);
        let ty = self.shared.pair();
        self.emit(Expression::Compose { ty, components: vec![high, low] }, out)
    }

    /// Rewrites an expression where it is evaluated.
    fn emitted(&mut self, old: Value, out: &mut Block) -> Result<Value> {
        let expression = &self.old.expressions[old];
        match expression {
            Expression::Compose { components, .. } if matches!(self.reals(old), Reals::Vector(_)) => {
                self.compose(components, out)
            }
            Expression::Splat { size, value } if self.has_reals(*value) => {
                let value = self.value(*value)?;
                Ok(self.vector(vec![value; *size as usize], out))
            }
            Expression::Swizzle { size, vector, pattern } if self.has_reals(*vector) => {
                let value = self.value(*vector)?;
                let lanes = pattern[..*size as usize].iter();
                let lanes = lanes.map(|lane| self.lane(value, *lane as u32, out)).collect();
                Ok(self.vector(lanes, out))
            }
            Expression::Access { base, .. } if self.has_reals(*base) => Err(unknown(expression)),
            Expression::Unary { op, expr } if self.has_reals(*expr) => self.unary(*op, *expr, out),
            Expression::Binary { op, left, right } if self.has_reals(*left) => {
                self.binary(*op, *left, *right, out)
            }
            Expression::Select { condition, accept, reject } => {
                self.select(*condition, *accept, *reject, out)
            }
            Expression::Math { fun, arg, arg1, arg2, .. } if self.has_reals(*arg) => {
                let arguments: Vec<Value> = [Some(*arg), *arg1, *arg2].into_iter().flatten().collect();
                self.math(*fun, &arguments, out)
            }
            Expression::As { expr, kind, convert } => self.conversion(*expr, *kind, *convert, out),
            other => match self.with_new_operands(other)? {
                Some(new) => Ok(self.emit(new, out)),
                None => self.value(old),
            },
        }
    }

    /// A vector of scalars and shorter vectors.
    fn compose(&mut self, components: &[Value], out: &mut Block) -> Result<Value> {
        let mut lanes = Vec::new();
        for component in components {
            match self.reals(*component) {
                Reals::Vector(size) => lanes.extend(self.lanes(*component, size, out)?),
                _ => lanes.push(self.value(*component)?),
            }
        }
        Ok(self.vector(lanes, out))
    }

    /// Applies `each` to every lane of vectors, or once to reals themselves.
    fn lanewise(
        &mut self,
        arguments: &[Value],
        out: &mut Block,
        mut each: impl FnMut(&mut Self, &[Value], &mut Block) -> Result<Value>,
    ) -> Result<Vec<Value>> {
        let size = arguments.iter().find_map(|argument| match self.reals(*argument) {
            Reals::Vector(size) => Some(size),
            _ => None,
        });
        let Some(size) = size else {
            let arguments = self.values(arguments)?;
            return Ok(vec![each(self, &arguments, out)?]);
        };
        let lanes = arguments.iter().map(|a| self.lanes(*a, size, out)).collect::<Result<Vec<_>>>()?;
        (0..size as usize)
            .map(|lane| {
                let arguments: Vec<Value> = lanes.iter().map(|lanes| lanes[lane]).collect();
                each(self, &arguments, out)
            })
            .collect()
    }

    /// As `lanewise`, for results that are reals.
    fn lanewise_reals(
        &mut self,
        arguments: &[Value],
        out: &mut Block,
        each: impl FnMut(&mut Self, &[Value], &mut Block) -> Result<Value>,
    ) -> Result<Value> {
        let lanes = self.lanewise(arguments, out, each)?;
        Ok(if lanes.len() == 1 { lanes[0] } else { self.vector(lanes, out) })
    }

    fn unary(&mut self, op: UnaryOperator, old: Value, out: &mut Block) -> Result<Value> {
        self.lanewise_reals(&[old], out, |this, arguments, out| {
            Ok(this.emit(Expression::Unary { op, expr: arguments[0] }, out))
        })
    }

    fn select(&mut self, condition: Value, accept: Value, reject: Value, out: &mut Block) -> Result<Value> {
        if let Reals::Vector(size) = self.reals(accept) {
            let conditions = self.lanes(condition, size, out)?;
            let accepted = self.lanes(accept, size, out)?;
            let rejected = self.lanes(reject, size, out)?;
            let lanes = (0..size as usize).map(|lane| {
                let (condition, accept, reject) = (conditions[lane], accepted[lane], rejected[lane]);
                self.emit(Expression::Select { condition, accept, reject }, out)
            });
            let lanes = lanes.collect();
            return Ok(self.vector(lanes, out));
        }
        let (condition, accept, reject) = (self.value(condition)?, self.value(accept)?, self.value(reject)?);
        Ok(self.emit(Expression::Select { condition, accept, reject }, out))
    }

    fn binary(&mut self, op: BinaryOperator, left: Value, right: Value, out: &mut Block) -> Result<Value> {
        let known = Known { left: self.narrow(left), right: self.narrow(right), same: left == right };
        if is_comparison(op) {
            let lanes =
                self.lanewise(&[left, right], out, |this, a, out| this.compare(op, a[0], a[1], &known, out))?;
            return Ok(if lanes.len() == 1 { lanes[0] } else { self.bools(lanes, out) });
        }
        self.lanewise_reals(&[left, right], out, |this, a, out| this.arithmetic(op, a[0], a[1], &known, out))
    }

    fn bools(&mut self, components: Vec<Value>, out: &mut Block) -> Value {
        let size = size_of(&components);
        let ty = self.shared.insert_type(None, TypeInner::Vector { size, scalar: Scalar::BOOL });
        self.emit(Expression::Compose { ty, components }, out)
    }

    /// What is known about an operand, where that saves work.
    fn narrow(&mut self, old: Value) -> Narrow {
        let literal = match &self.old.expressions[old] {
            Expression::Literal(Literal::F64(value)) => Some(*value),
            Expression::Constant(constant) => self.shared.constant_value(*constant),
            Expression::Splat { value, .. } => return self.narrow(*value),
            Expression::As { expr, kind: ScalarKind::Float, convert: Some(8) } => {
                let is_f32 =
                    self.info[*expr].ty.inner_with(&self.shared.old.types) == &TypeInner::Scalar(Scalar::F32);
                return match self.known.get(expr).filter(|_| is_f32) {
                    Some(value) => Narrow::Single(*value),
                    None => Narrow::Pair,
                };
            }
            _ => None,
        };
        match literal {
            Some(value) if f64::from(value as f32) == value => Narrow::Literal(value as f32),
            _ => Narrow::Pair,
        }
    }

    fn arithmetic(
        &mut self,
        op: BinaryOperator,
        left: Value,
        right: Value,
        known: &Known,
        out: &mut Block,
    ) -> Result<Value> {
        use BinaryOperator::{Add, Divide, Multiply, Subtract};
        use Narrow::{Literal, Single};
        match (op, known.left, known.right) {
            (Multiply, _, Literal(factor)) if is_power_of_two(factor) => Ok(self.scale(left, factor, out)),
            (Multiply, Literal(factor), _) if is_power_of_two(factor) => Ok(self.scale(right, factor, out)),
            (Divide, _, Literal(divisor)) if is_power_of_two(divisor) => {
                Ok(self.scale(left, divisor.recip(), out))
            }
            (Multiply, _, Literal(_) | Single(_)) => {
                let factor = self.single(known.right);
                self.call("mul_f", &[left, factor], out)
            }
            (Multiply, Literal(_) | Single(_), _) => {
                let factor = self.single(known.left);
                self.call("mul_f", &[right, factor], out)
            }
            (Add, _, Literal(_) | Single(_)) => {
                let term = self.single(known.right);
                self.call("add_f", &[left, term], out)
            }
            (Add, Literal(_) | Single(_), _) => {
                let term = self.single(known.left);
                self.call("add_f", &[right, term], out)
            }
            (Subtract, _, Literal(term)) => {
                let term = self.f32(-term);
                self.call("add_f", &[left, term], out)
            }
            (Subtract, Literal(_) | Single(_), _) => {
                let term = self.single(known.left);
                let negated = self.emit(Expression::Unary { op: UnaryOperator::Negate, expr: right }, out);
                self.call("add_f", &[negated, term], out)
            }
            (Multiply, ..) if known.same => self.call("square", &[left], out),
            (Add, ..) => self.call("add", &[left, right], out),
            (Subtract, ..) => self.call("sub", &[left, right], out),
            (Multiply, ..) => self.call("mul", &[left, right], out),
            (Divide, ..) => self.call("div", &[left, right], out),
            _ => Err(unknown(op)),
        }
    }

    /// The f32 of an operand.
    fn single(&mut self, narrow: Narrow) -> Value {
        match narrow {
            Narrow::Literal(value) => self.f32(value),
            Narrow::Single(value) => value,
            Narrow::Pair => self.f32(f32::NAN),
        }
    }

    /// Multiplies by a power of two: exact, part by part.
    fn scale(&mut self, value: Value, factor: f32, out: &mut Block) -> Value {
        let right = self.f32(factor);
        self.emit(Expression::Binary { op: BinaryOperator::Multiply, left: value, right }, out)
    }

    fn compare(
        &mut self,
        op: BinaryOperator,
        left: Value,
        right: Value,
        known: &Known,
        out: &mut Block,
    ) -> Result<Value> {
        use BinaryOperator as B;
        // A number is 0 only if its high part is 0.
        if known.right == Narrow::Literal(0.0) {
            let left = self.emit(Expression::AccessIndex { base: left, index: 0 }, out);
            let right = self.f32(0.0);
            return Ok(self.emit(Expression::Binary { op, left, right }, out));
        }
        match op {
            B::Less => self.call("less", &[left, right], out),
            B::Greater => self.call("less", &[right, left], out),
            B::LessEqual => self.call("less_equal", &[left, right], out),
            B::GreaterEqual => self.call("less_equal", &[right, left], out),
            B::Equal | B::NotEqual => {
                let argument = self.emit(Expression::Binary { op, left, right }, out);
                let fun = if op == B::Equal { RelationalFunction::All } else { RelationalFunction::Any };
                Ok(self.emit(Expression::Relational { fun, argument }, out))
            }
            _ => Err(unknown(op)),
        }
    }

    fn math(&mut self, fun: MathFunction, arguments: &[Value], out: &mut Block) -> Result<Value> {
        let name = match fun {
            MathFunction::Abs => "abs",
            MathFunction::Min => "min",
            MathFunction::Max => "max",
            MathFunction::Clamp => "clamp",
            MathFunction::Floor => "floor",
            MathFunction::Ceil => "ceil",
            MathFunction::Sqrt => "sqrt",
            MathFunction::Dot | MathFunction::Cross => return self.product(fun, arguments, out),
            other => return Err(unknown(other)),
        };
        self.lanewise_reals(arguments, out, |this, arguments, out| this.call(name, arguments, out))
    }

    /// A product of whole vectors.
    fn product(&mut self, fun: MathFunction, arguments: &[Value], out: &mut Block) -> Result<Value> {
        let name = match (fun, self.reals(arguments[0])) {
            (MathFunction::Dot, Reals::Vector(VectorSize::Tri)) => "dot",
            (MathFunction::Dot, Reals::Vector(size)) => return self.dot_of(size, arguments, out),
            (MathFunction::Cross, _) => "cross",
            other => return Err(unknown(other)),
        };
        let arguments = self.values(arguments)?;
        self.call(name, &arguments, out)
    }

    /// A dot product of vectors of two or four reals, term by term.
    fn dot_of(&mut self, size: VectorSize, arguments: &[Value], out: &mut Block) -> Result<Value> {
        let [left, right] = [self.lanes(arguments[0], size, out)?, self.lanes(arguments[1], size, out)?];
        let mut sum = self.call("mul", &[left[0], right[0]], out)?;
        for (left, right) in left.into_iter().zip(right).skip(1) {
            sum = self.call("add_product", &[sum, left, right], out)?;
        }
        Ok(sum)
    }

    fn conversion(
        &mut self,
        old: Value,
        kind: ScalarKind,
        convert: Option<naga::Bytes>,
        out: &mut Block,
    ) -> Result<Value> {
        let from_real = self.has_reals(old);
        let to_real = kind == ScalarKind::Float && convert == Some(8);
        let value = self.value(old)?;
        let scalar = match self.info[old].ty.inner_with(&self.shared.old.types) {
            TypeInner::Scalar(scalar) | TypeInner::Vector { scalar, .. } => *scalar,
            other => return Err(unknown(other)),
        };
        if from_real && to_real {
            return Ok(value);
        }
        if !from_real && !to_real {
            return Ok(self.emit(Expression::As { expr: value, kind, convert }, out));
        }
        let size = match self.info[old].ty.inner_with(&self.shared.old.types) {
            TypeInner::Vector { size, .. } => Some(*size),
            _ => None,
        };
        let to = Scalar { kind, width: convert.unwrap_or(scalar.width) };
        let Some(size) = size else {
            return self.scalar_conversion(value, scalar, to, out);
        };
        let lanes = self.lanes(old, size, out)?;
        let lanes = lanes
            .into_iter()
            .map(|lane| self.scalar_conversion(lane, scalar, to, out))
            .collect::<Result<Vec<_>>>()?;
        if to_real {
            return Ok(self.vector(lanes, out));
        }
        let ty = self.shared.insert_type(None, TypeInner::Vector { size, scalar: to });
        Ok(self.emit(Expression::Compose { ty, components: lanes }, out))
    }

    fn scalar_conversion(
        &mut self,
        value: Value,
        from: Scalar,
        to: Scalar,
        out: &mut Block,
    ) -> Result<Value> {
        match (from, to) {
            (Scalar::F32, Scalar::F64) => Ok(self.pair(value, out)),
            (Scalar::U32, Scalar::F64) => self.call("from_u32", &[value], out),
            (Scalar::I32, Scalar::F64) => self.call("from_i32", &[value], out),
            (Scalar::F64, Scalar::F32) => {
                Ok(self.emit(Expression::AccessIndex { base: value, index: 0 }, out))
            }
            (Scalar::F64, Scalar::U32) => self.call("to_u32", &[value], out),
            (Scalar::F64, Scalar::I32) => self.call("to_i32", &[value], out),
            other => Err(unknown(other)),
        }
    }
}

/// What is known about an operand.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Narrow {
    Pair,
    /// A literal that an f32 holds.
    Literal(f32),
    /// The value of an f32.
    Single(Value),
}

struct Known {
    left: Narrow,
    right: Narrow,
    same: bool,
}

fn size_of(components: &[Value]) -> VectorSize {
    match components.len() {
        2 => VectorSize::Bi,
        3 => VectorSize::Tri,
        _ => VectorSize::Quad,
    }
}

fn is_comparison(op: BinaryOperator) -> bool {
    use BinaryOperator as B;
    matches!(op, B::Equal | B::NotEqual | B::Less | B::LessEqual | B::Greater | B::GreaterEqual)
}

/// True for a power of two, of either sign, whose inverse is a normal number too.
fn is_power_of_two(value: f32) -> bool {
    value.is_normal() && value.to_bits() << 9 == 0 && value.recip().is_normal()
}
