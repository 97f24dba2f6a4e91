//! Rewrites one function, with tangents beside its reals.

use crate::error::Result;
use crate::program::rewrite::function_builder::{FunctionBuilder, Rewrite, inner_blocks_mut, real_literal};
use crate::program::rewrite::jvp::rewriting::{Rewriting, unknown};
use crate::program::rewrite::jvp::rules::{DEPOSIT, Rule, rule};
use naga::valid::FunctionInfo;
use naga::{
    BinaryOperator, Block, Expression, Function, FunctionArgument, Handle, Literal, LocalVariable,
    MathFunction, ScalarKind, Span, Statement, Type, TypeInner, UnaryOperator,
};
use std::collections::HashMap;

type Value = Handle<Expression>;

/// A value's tangents, one for each parameter. `None` where all are zero.
type Tangents = Option<Vec<Value>>;

/// The function as it was, with the new handles of what it calls.
pub(in crate::program) fn called_as_before(shared: &Rewriting, old: &Function) -> Function {
    let mut new = old.clone();
    for (_, expression) in new.expressions.iter_mut() {
        if let Expression::CallResult(function) = expression {
            *function = shared.functions[function].plain;
        }
    }
    rename_calls(shared, &mut new.body);
    new
}

fn rename_calls(shared: &Rewriting, block: &mut Block) {
    for (statement, _) in block.span_iter_mut() {
        match statement {
            Statement::Call { function, .. } => *function = shared.functions[function].plain,
            other => inner_blocks_mut(other).for_each(|inner| rename_calls(shared, inner)),
        }
    }
}

/// The function with tangents: each argument that holds reals is followed by its tangents, and so is the result.
pub(in crate::program) fn rewrite_function(
    shared: &mut Rewriting,
    old: &Function,
    info: &FunctionInfo,
) -> Result<Function> {
    let mut new = Function { name: old.name.clone(), ..Default::default() };
    let mut arguments = Vec::new();
    for argument in &old.arguments {
        arguments.push(new.arguments.len() as u32);
        new.arguments.push(argument.clone());
        if shared.has_reals(argument.ty) {
            for number in 1..=shared.num {
                let name = argument.name.as_ref().map(|name| format!("{name}_tangent_{number}"));
                new.arguments.push(FunctionArgument { name, ty: argument.ty, binding: None });
            }
        }
    }
    let mut has_dual = false;
    if let Some(result) = &old.result {
        has_dual = shared.has_reals(result.ty);
        let ty = if has_dual { shared.dual(result.ty)? } else { result.ty };
        new.result = Some(naga::FunctionResult { ty, ..result.clone() });
    }
    let mut rewriter = Rewriter {
        shared,
        old,
        info,
        new,
        arguments,
        has_dual,
        known: HashMap::new(),
        tangents: HashMap::new(),
        locals: HashMap::new(),
    };
    rewriter.local_variables()?;
    rewriter.new.body = rewriter.block(&old.body)?;
    for (value, name) in &old.named_expressions {
        if let Some(value) = rewriter.known.get(value) {
            rewriter.new.named_expressions.insert(*value, name.clone());
        }
    }
    Ok(rewriter.new)
}

/// A variable, and its twins.
struct Local {
    plain: Handle<LocalVariable>,
    twins: Vec<Handle<LocalVariable>>,
}

struct Rewriter<'r, 'm> {
    shared: &'r mut Rewriting<'m>,
    old: &'r Function,
    info: &'r FunctionInfo,
    new: Function,
    /// The new numbers of arguments.
    arguments: Vec<u32>,
    has_dual: bool,
    known: HashMap<Value, Value>,
    tangents: HashMap<Value, Tangents>,
    locals: HashMap<Handle<LocalVariable>, Local>,
}

impl FunctionBuilder for Rewriter<'_, '_> {
    fn new_function(&mut self) -> &mut Function {
        &mut self.new
    }
}

impl Rewrite for Rewriter<'_, '_> {
    fn value(&mut self, old: Value) -> Result<Value> {
        if let Some(new) = self.known.get(&old) {
            return Ok(*new);
        }
        let new = match &self.old.expressions[old] {
            expression @ (Expression::Literal(_)
            | Expression::Constant(_)
            | Expression::ZeroValue(_)
            | Expression::GlobalVariable(_)) => expression.clone(),
            Expression::FunctionArgument(index) => {
                Expression::FunctionArgument(self.arguments[*index as usize])
            }
            Expression::LocalVariable(variable) => Expression::LocalVariable(self.locals[variable].plain),
            other => return Err(unknown(other)),
        };
        let new = self.append(new);
        self.known.insert(old, new);
        Ok(new)
    }

    fn statement(&mut self, statement: &Statement, out: &mut Block) -> Result<()> {
        let new = match statement {
            Statement::Emit(range) => {
                for old in range.clone() {
                    let new = self.emitted(old, out)?;
                    self.known.insert(old, new);
                    let tangents = if self.has_reals(old) { self.tangents_of(old, new, out)? } else { None };
                    self.tangents.insert(old, tangents);
                }
                return Ok(());
            }
            Statement::Return { value } => {
                let value = match value {
                    Some(value) if self.has_dual => Some(self.dual(*value, out)?),
                    value => self.optional(*value)?,
                };
                Statement::Return { value }
            }
            Statement::Store { pointer, value } => {
                let (to, what) = (self.value(*pointer)?, self.value(*value)?);
                out.push(Statement::Store { pointer: to, value: what }, Span::UNDEFINED);
                if let Some(pointers) = self.tangents(*pointer) {
                    let tangents = self.tangents_or_zeros(*value);
                    for (pointer, value) in pointers.into_iter().zip(tangents) {
                        out.push(Statement::Store { pointer, value }, Span::UNDEFINED);
                    }
                }
                return Ok(());
            }
            Statement::Atomic { pointer, fun, value, result } => {
                let fun = self.atomic_function(fun)?;
                let (pointer, value) = (self.value(*pointer)?, self.value(*value)?);
                let result = result.map(|old| {
                    let new = self.append(self.old.expressions[old].clone());
                    self.known.insert(old, new);
                    new
                });
                Statement::Atomic { pointer, fun, value, result }
            }
            Statement::Call { function, arguments, result } => {
                return self.call(*function, arguments, *result, out);
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
            let init = variable.init.map(|init| self.initial(init)).transpose()?;
            let plain = LocalVariable { init, ..variable.clone() };
            let plain = self.new.local_variables.append(plain, Span::UNDEFINED);
            let num = if self.shared.has_reals(variable.ty) { self.shared.num } else { 0 };
            let twins = (1..=num).map(|number| {
                let name = variable.name.as_ref().map(|name| format!("{name}_tangent_{number}"));
                let twin = LocalVariable { name, ty: variable.ty, init: None };
                self.new.local_variables.append(twin, Span::UNDEFINED)
            });
            let twins = twins.collect();
            self.locals.insert(handle, Local { plain, twins });
        }
        Ok(())
    }

    /// The initial value of a variable: a constant, which is not evaluated anywhere.
    fn initial(&mut self, old: Value) -> Result<Value> {
        match &self.old.expressions[old] {
            Expression::Compose { ty, components } => {
                let components = components.iter().map(|c| self.initial(*c)).collect::<Result<_>>()?;
                Ok(self.append(Expression::Compose { ty: *ty, components }))
            }
            Expression::Splat { size, value } => {
                let value = self.initial(*value)?;
                Ok(self.append(Expression::Splat { size: *size, value }))
            }
            _ => self.value(old),
        }
    }

    fn literal(&mut self, value: f64) -> Value {
        self.append(real_literal(self.shared.real, value))
    }

    /// The tangents of an old value; of a pointer, pointers to the twins of its variable.
    fn tangents(&mut self, old: Value) -> Tangents {
        if let Some(known) = self.tangents.get(&old) {
            return known.clone();
        }
        let num = self.shared.num;
        let twins: Vec<Expression> = match &self.old.expressions[old] {
            Expression::FunctionArgument(index) if self.has_reals(old) => {
                let first = self.arguments[*index as usize] + 1;
                (0..num as u32).map(|number| Expression::FunctionArgument(first + number)).collect()
            }
            Expression::LocalVariable(variable) => {
                self.locals[variable].twins.iter().map(|twin| Expression::LocalVariable(*twin)).collect()
            }
            Expression::GlobalVariable(variable) => {
                let twins = self.shared.globals.get(variable).into_iter().flatten();
                twins.map(|twin| Expression::GlobalVariable(*twin)).collect()
            }
            _ => Vec::new(),
        };
        let found: Vec<Value> = twins.into_iter().map(|twin| self.append(twin)).collect();
        let found = (!found.is_empty()).then_some(found);
        self.tangents.insert(old, found.clone());
        found
    }

    fn has_reals(&self, old: Value) -> bool {
        self.shared.inner_has_reals(self.info[old].ty.inner_with(&self.shared.old.types))
    }

    fn is_real_itself(&self, old: Value) -> bool {
        match self.info[old].ty.inner_with(&self.shared.old.types) {
            TypeInner::Scalar(scalar) | TypeInner::Vector { scalar, .. } => *scalar == self.shared.real,
            _ => false,
        }
    }

    /// The type of an old value, with a handle.
    fn type_of(&mut self, old: Value) -> Handle<Type> {
        match &self.info[old].ty {
            naga::proc::TypeResolution::Handle(handle) => *handle,
            naga::proc::TypeResolution::Value(inner) => {
                self.shared.new.types.insert(Type { name: None, inner: inner.clone() }, Span::UNDEFINED)
            }
        }
    }

    /// The tangents of a value, with zeros where there are none.
    fn tangents_or_zeros(&mut self, old: Value) -> Vec<Value> {
        if let Some(tangents) = self.tangents(old) {
            return tangents;
        }
        let ty = self.type_of(old);
        (0..self.shared.num).map(|_| self.append(Expression::ZeroValue(ty))).collect()
    }

    /// Applies `each` to the tangents of a value, if it has any.
    fn each(
        &mut self,
        old: Value,
        out: &mut Block,
        mut each: impl FnMut(&mut Self, Value, &mut Block) -> Value,
    ) -> Tangents {
        let tangents = self.tangents(old)?;
        Some(tangents.into_iter().map(|tangent| each(self, tangent, out)).collect())
    }

    /// The sums of two lists of terms.
    fn sum(&mut self, left: Tangents, right: Tangents, out: &mut Block) -> Tangents {
        match (left, right) {
            (Some(left), Some(right)) => {
                let sums = left.into_iter().zip(right);
                Some(sums.map(|(a, b)| self.binary(BinaryOperator::Add, a, b, out)).collect())
            }
            (one, None) | (None, one) => one,
        }
    }

    /// A result with its tangents.
    fn dual(&mut self, old: Value, out: &mut Block) -> Result<Value> {
        let value = self.value(old)?;
        let tangents = self.tangents_or_zeros(old);
        let result = self.old.result.as_ref().map(|result| result.ty);
        let ty = self.shared.dual(result.ok_or_else(|| unknown("a result without a type"))?)?;
        let components = std::iter::once(value).chain(tangents).collect();
        Ok(self.emit(Expression::Compose { ty, components }, out))
    }

    fn call(
        &mut self,
        function: Handle<Function>,
        arguments: &[Value],
        result: Option<Value>,
        out: &mut Block,
    ) -> Result<()> {
        let name = self.shared.old.functions[function].name.clone().unwrap_or_default();
        let new = self.shared.functions[&function];
        let values = self.values(arguments)?;
        let rule = rule(&name);
        if rule == Some(Rule::Note) {
            return self.note(arguments, out);
        }
        let Some(with_tangents) = new.with_tangents.filter(|_| rule.is_none()) else {
            let has_result = result.is_some();
            if !has_result {
                let call = Statement::Call { function: new.plain, arguments: values, result: None };
                out.push(call, Span::UNDEFINED);
                return Ok(());
            }
            let value = self.call_plain(new.plain, values.clone(), out);
            let tangents = self.by_rule(rule, arguments, &values, value, out)?;
            result.into_iter().for_each(|old| {
                self.known.insert(old, value);
                self.tangents.insert(old, tangents.clone());
            });
            return Ok(());
        };
        let mut all = Vec::new();
        for (old, value) in arguments.iter().zip(values) {
            all.push(value);
            if self.has_reals(*old) {
                let tangents = match self.info[*old].ty.inner_with(&self.shared.old.types) {
                    TypeInner::Pointer { .. } | TypeInner::ValuePointer { .. } => self
                        .tangents(*old)
                        .ok_or_else(|| unknown(format_args!("a pointer given to {name}")))?,
                    _ => self.tangents_or_zeros(*old),
                };
                all.extend(tangents);
            }
        }
        let Some(old) = result else {
            let call = Statement::Call { function: with_tangents, arguments: all, result: None };
            out.push(call, Span::UNDEFINED);
            return Ok(());
        };
        let found = self.call_plain(with_tangents, all, out);
        if !self.has_reals(old) {
            self.known.insert(old, found);
            self.tangents.insert(old, None);
            return Ok(());
        }
        let value = self.emit(Expression::AccessIndex { base: found, index: 0 }, out);
        let tangents = (1..=self.shared.num as u32)
            .map(|index| self.emit(Expression::AccessIndex { base: found, index }, out))
            .collect();
        self.known.insert(old, value);
        self.tangents.insert(old, Some(tangents));
        Ok(())
    }

    /// Sends the tangents of the second argument to the sums of the first.
    fn note(&mut self, arguments: &[Value], out: &mut Block) -> Result<()> {
        let cell = self.value(arguments[0])?;
        let deposit = self.shared.plain(DEPOSIT)?;
        for (number, tangent) in (0..).zip(self.tangents(arguments[1]).unwrap_or_default()) {
            let number = self.append(Expression::Literal(Literal::U32(number)));
            let arguments = vec![cell, tangent, number];
            out.push(Statement::Call { function: deposit, arguments, result: None }, Span::UNDEFINED);
        }
        Ok(())
    }

    /// The tangents of a result by the rule of its function.
    fn by_rule(
        &mut self,
        rule: Option<Rule>,
        old: &[Value],
        values: &[Value],
        result: Value,
        out: &mut Block,
    ) -> Result<Tangents> {
        use BinaryOperator::{Divide, Multiply};
        Ok(match rule {
            None | Some(Rule::Constant | Rule::Note | Rule::Recalled(_)) => None,
            Some(Rule::Attached) => self.tangents(old[1]),
            Some(Rule::Exponential) => {
                self.each(old[0], out, |this, tangent, out| this.binary(Multiply, result, tangent, out))
            }
            Some(Rule::Logarithm) => {
                let argument = values[0];
                self.each(old[0], out, |this, tangent, out| this.binary(Divide, tangent, argument, out))
            }
            Some(Rule::Turned(name, sign)) => {
                if self.tangents(old[0]).is_none() {
                    return Ok(None);
                }
                let function = self.shared.plain(name)?;
                let turned = self.call_plain(function, vec![values[0]], out);
                let sign = self.literal(sign);
                let slope = self.binary(Multiply, turned, sign, out);
                self.each(old[0], out, |this, tangent, out| this.binary(Multiply, slope, tangent, out))
            }
        })
    }

    /// An expression where it is evaluated, as it was.
    fn emitted(&mut self, old: Value, out: &mut Block) -> Result<Value> {
        match self.with_new_operands(&self.old.expressions[old])? {
            Some(new) => Ok(self.emit(new, out)),
            None => self.value(old),
        }
    }

    /// The tangents of an expression that was just evaluated to `new`.
    fn tangents_of(&mut self, old: Value, new: Value, out: &mut Block) -> Result<Tangents> {
        let expression = self.old.expressions[old].clone();
        Ok(match expression {
            Expression::Compose { ty, components } => {
                if components.iter().all(|component| self.tangents(*component).is_none()) {
                    return Ok(None);
                }
                let parts: Vec<Vec<Value>> = components.iter().map(|c| self.tangents_or_zeros(*c)).collect();
                let of_each = (0..self.shared.num).map(|number| {
                    let components = parts.iter().map(|part| part[number]).collect();
                    self.emit(Expression::Compose { ty, components }, out)
                });
                Some(of_each.collect())
            }
            Expression::Splat { size, value } => {
                self.each(value, out, |this, value, out| this.emit(Expression::Splat { size, value }, out))
            }
            Expression::Swizzle { size, vector, pattern } => self.each(vector, out, |this, vector, out| {
                this.emit(Expression::Swizzle { size, vector, pattern }, out)
            }),
            Expression::Access { base, index } => {
                let index = self.value(index)?;
                self.each(base, out, |this, base, out| this.emit(Expression::Access { base, index }, out))
            }
            Expression::AccessIndex { base, index } => self
                .each(base, out, |this, base, out| this.emit(Expression::AccessIndex { base, index }, out)),
            Expression::Load { pointer } => {
                self.each(pointer, out, |this, pointer, out| this.emit(Expression::Load { pointer }, out))
            }
            Expression::Unary { op: op @ UnaryOperator::Negate, expr } => {
                self.each(expr, out, |this, expr, out| this.emit(Expression::Unary { op, expr }, out))
            }
            Expression::Binary { op, left, right } => self.arithmetic(op, left, right, new, out)?,
            Expression::Select { condition, accept, reject } => {
                if self.tangents(accept).is_none() && self.tangents(reject).is_none() {
                    return Ok(None);
                }
                let condition = self.value(condition)?;
                let (accepted, rejected) = (self.tangents_or_zeros(accept), self.tangents_or_zeros(reject));
                let both = accepted.into_iter().zip(rejected);
                Some(both.map(|(accept, reject)| self.select(condition, accept, reject, out)).collect())
            }
            Expression::Math { fun, arg, arg1, arg2, .. } => {
                let arguments: Vec<Value> = [Some(arg), arg1, arg2].into_iter().flatten().collect();
                self.math(fun, &arguments, new, out)?
            }
            Expression::As { expr, kind: ScalarKind::Float, .. } if self.is_real_itself(expr) => {
                self.tangents(expr)
            }
            Expression::As { .. } => None,
            Expression::Literal(_) | Expression::Constant(_) | Expression::ZeroValue(_) => None,
            other => return Err(unknown(other)),
        })
    }

    fn select(&mut self, condition: Value, accept: Value, reject: Value, out: &mut Block) -> Value {
        self.emit(Expression::Select { condition, accept, reject }, out)
    }

    fn arithmetic(
        &mut self,
        op: BinaryOperator,
        left: Value,
        right: Value,
        result: Value,
        out: &mut Block,
    ) -> Result<Tangents> {
        use BinaryOperator::{Add, Divide, Multiply, Subtract};
        let (a, b) = (self.value(left)?, self.value(right)?);
        Ok(match op {
            Add => {
                let (left, right) = (self.tangents(left), self.tangents(right));
                self.sum(left, right, out)
            }
            Subtract => {
                let right = self.each(right, out, |this, expr, out| {
                    this.emit(Expression::Unary { op: UnaryOperator::Negate, expr }, out)
                });
                let left = self.tangents(left);
                self.sum(left, right, out)
            }
            Multiply => {
                let left = self.each(left, out, |this, tangent, out| this.binary(Multiply, tangent, b, out));
                let right =
                    self.each(right, out, |this, tangent, out| this.binary(Multiply, a, tangent, out));
                self.sum(left, right, out)
            }
            Divide => {
                // (a / b)' = (a' - (a / b) b') / b.
                let right = self.each(right, out, |this, tangent, out| {
                    let product = this.binary(Multiply, result, tangent, out);
                    this.emit(Expression::Unary { op: UnaryOperator::Negate, expr: product }, out)
                });
                let left = self.tangents(left);
                let above = self.sum(left, right, out);
                above.map(|above| above.into_iter().map(|t| self.binary(Divide, t, b, out)).collect())
            }
            other => return Err(unknown(other)),
        })
    }

    fn math(&mut self, fun: MathFunction, old: &[Value], result: Value, out: &mut Block) -> Result<Tangents> {
        use BinaryOperator::{Divide, Greater, Less, Multiply};
        if old.iter().all(|argument| self.tangents(*argument).is_none()) {
            return Ok(None);
        }
        let values = self.values(old)?;
        let ty = self.type_of(old[0]);
        Ok(match fun {
            MathFunction::Abs => {
                let zero = self.append(Expression::ZeroValue(ty));
                let is_below = self.binary(Less, values[0], zero, out);
                self.each(old[0], out, |this, tangent, out| {
                    let expr = Expression::Unary { op: UnaryOperator::Negate, expr: tangent };
                    let negated = this.emit(expr, out);
                    this.select(is_below, negated, tangent, out)
                })
            }
            MathFunction::Min | MathFunction::Max => {
                let op = if fun == MathFunction::Min { Less } else { Greater };
                let is_second = self.binary(op, values[1], values[0], out);
                let (first, second) = (self.tangents_or_zeros(old[0]), self.tangents_or_zeros(old[1]));
                let both = first.into_iter().zip(second);
                Some(both.map(|(first, second)| self.select(is_second, second, first, out)).collect())
            }
            MathFunction::Clamp => {
                let is_low = self.binary(Less, values[0], values[1], out);
                let is_high = self.binary(Greater, values[0], values[2], out);
                let [x, low, high] = [0, 1, 2].map(|i| self.tangents_or_zeros(old[i]));
                let of_each = (0..self.shared.num).map(|number| {
                    let raised = self.select(is_low, low[number], x[number], out);
                    self.select(is_high, high[number], raised, out)
                });
                Some(of_each.collect())
            }
            MathFunction::Sqrt => {
                // Where the root is 0 its slope is infinite: there the ray grazes, and what it does has no derivative.
                let zero = self.append(Expression::ZeroValue(ty));
                let is_positive = self.binary(Greater, result, zero, out);
                let doubled = self.binary(BinaryOperator::Add, result, result, out);
                self.each(old[0], out, |this, tangent, out| {
                    let slope = this.binary(Divide, tangent, doubled, out);
                    this.select(is_positive, slope, zero, out)
                })
            }
            MathFunction::Fma => {
                let left = self
                    .each(old[0], out, |this, tangent, out| this.binary(Multiply, tangent, values[1], out));
                let right = self
                    .each(old[1], out, |this, tangent, out| this.binary(Multiply, values[0], tangent, out));
                let product = self.sum(left, right, out);
                let third = self.tangents(old[2]);
                self.sum(product, third, out)
            }
            MathFunction::Dot | MathFunction::Cross => {
                let product = |this: &mut Self, arg: Value, arg1: Value, out: &mut Block| {
                    this.emit(Expression::Math { fun, arg, arg1: Some(arg1), arg2: None, arg3: None }, out)
                };
                let left =
                    self.each(old[0], out, |this, tangent, out| product(this, tangent, values[1], out));
                let right =
                    self.each(old[1], out, |this, tangent, out| product(this, values[0], tangent, out));
                self.sum(left, right, out)
            }
            MathFunction::Floor | MathFunction::Ceil | MathFunction::Trunc | MathFunction::Round => None,
            other => return Err(unknown(other)),
        })
    }
}
