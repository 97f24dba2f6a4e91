//! Rewrites one function, with tangents beside its reals.

use crate::error::Result;
use crate::program::rewrite::function_builder::{FunctionBuilder, Rewrite, inner_blocks_mut};
use crate::program::rewrite::jvp::rewriting::Rewriting;
use crate::program::rewrite::linear::{Linear, Linearise, Side, operands, unknown};
use crate::program::rewrite::rules::{DEPOSIT, Rule, rule};
use naga::valid::FunctionInfo;
use naga::{
    BinaryOperator, Block, Expression, Function, FunctionArgument, Handle, Literal, LocalVariable, Scalar,
    Span, Statement, Type, TypeInner,
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
                    let tangents = if self.has_reals(old) { self.tangents_of(old, out)? } else { None };
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

impl Linearise for Rewriter<'_, '_> {
    fn changes(&mut self, old: Value) -> bool {
        self.tangents(old).is_some()
    }

    fn coefficient(&mut self, old: Value) -> Result<Value> {
        self.value(old)
    }

    fn type_of(&mut self, old: Value) -> Handle<Type> {
        match &self.info[old].ty {
            naga::proc::TypeResolution::Handle(handle) => *handle,
            naga::proc::TypeResolution::Value(inner) => {
                self.shared.new.types.insert(Type { name: None, inner: inner.clone() }, Span::UNDEFINED)
            }
        }
    }

    fn inner_of(&self, old: Value) -> &TypeInner {
        self.info[old].ty.inner_with(&self.shared.old.types)
    }

    fn real(&self) -> Scalar {
        self.shared.real
    }

    fn plain(&self, name: &str) -> Result<Handle<Function>> {
        self.shared.plain(name)
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

    /// The tangents of a value, with zeros where there are none.
    fn tangents_or_zeros(&mut self, old: Value) -> Vec<Value> {
        if let Some(tangents) = self.tangents(old) {
            return tangents;
        }
        let ty = self.type_of(old);
        self.zeros(ty)
    }

    fn zeros(&mut self, ty: Handle<Type>) -> Vec<Value> {
        (0..self.shared.num).map(|_| self.append(Expression::ZeroValue(ty))).collect()
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
            let value = self.call_for_result(new.plain, values, out);
            if let Some(old) = result {
                self.known.insert(old, value);
                let change = match rule {
                    Some(rule) => self.linearised_call(rule, arguments, old, out)?,
                    None => None,
                };
                let tangents = change.map(|change| self.evaluated(&change, out)).transpose()?;
                self.tangents.insert(old, tangents);
            }
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
        let found = self.call_for_result(with_tangents, all, out);
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

    /// An expression where it is evaluated, as it was.
    fn emitted(&mut self, old: Value, out: &mut Block) -> Result<Value> {
        match self.with_new_operands(&self.old.expressions[old])? {
            Some(new) => Ok(self.emit(new, out)),
            None => self.value(old),
        }
    }

    /// The tangents of an expression that was just evaluated.
    fn tangents_of(&mut self, old: Value, out: &mut Block) -> Result<Tangents> {
        let expression = &self.old.expressions[old];
        if let Expression::Load { pointer } = *expression {
            let pointers = self.tangents(pointer);
            return Ok(pointers.map(|all| {
                self.each(all, out, |this, pointer, out| this.emit(Expression::Load { pointer }, out))
            }));
        }
        let change = self.linearised(old, expression, out)?;
        change.map(|change| self.evaluated(&change, out)).transpose()
    }

    /// The values of a linear function, one for each parameter.
    fn evaluated(&mut self, change: &Linear, out: &mut Block) -> Result<Vec<Value>> {
        Ok(match *change {
            Linear::Of(old) => self.tangents_or_zeros(old),
            Linear::Negative(ref of) => {
                let of = self.evaluated(of, out)?;
                self.each(of, out, |this, of, out| this.negated(of, out))
            }
            Linear::NegativeWhere(condition, ref of) => {
                let of = self.evaluated(of, out)?;
                self.each(of, out, |this, of, out| this.negative_where(condition, of, out))
            }
            Linear::Sum(ref left, ref right) => {
                let (left, right) = (self.evaluated(left, out)?, self.evaluated(right, out)?);
                let both = left.into_iter().zip(right);
                both.map(|(a, b)| self.binary(BinaryOperator::Add, a, b, out)).collect()
            }
            Linear::Product(product, side, ref of, by) => {
                let of = self.evaluated(of, out)?;
                self.each(of, out, |this, of, out| {
                    let (left, right) = if side == Side::Left { (of, by) } else { (by, of) };
                    this.emit(product.expression(left, right), out)
                })
            }
            Linear::Quotient(ref of, by, only_where) => {
                let of = self.evaluated(of, out)?;
                self.each(of, out, |this, of, out| this.quotient(of, by, only_where, out))
            }
            Linear::Choice(condition, ref changes, ty) => {
                let mut of = |change: &Option<Box<Linear>>| match change {
                    Some(change) => self.evaluated(change, out),
                    None => Ok(self.zeros(ty)),
                };
                let (accepted, rejected) = (of(&changes[0])?, of(&changes[1])?);
                let both = accepted.into_iter().zip(rejected);
                both.map(|(accept, reject)| self.select(condition, accept, reject, out)).collect()
            }
            Linear::Rearranged(ref expression) => {
                let parts = operands(expression);
                let parts: Vec<Vec<Value>> = parts.into_iter().map(|of| self.tangents_or_zeros(of)).collect();
                let of_each = (0..self.shared.num).map(|number| {
                    let part = |i: usize| parts[i][number];
                    let rearranged = match *expression {
                        Expression::Compose { ty, .. } => {
                            Expression::Compose { ty, components: (0..parts.len()).map(part).collect() }
                        }
                        Expression::Splat { size, .. } => Expression::Splat { size, value: part(0) },
                        Expression::Swizzle { size, pattern, .. } => {
                            Expression::Swizzle { size, vector: part(0), pattern }
                        }
                        Expression::AccessIndex { index, .. } => {
                            Expression::AccessIndex { base: part(0), index }
                        }
                        Expression::Access { index, .. } => {
                            Expression::Access { base: part(0), index: self.value(index)? }
                        }
                        ref other => return Err(unknown(other)),
                    };
                    Ok(self.emit(rearranged, out))
                });
                of_each.collect::<Result<_>>()?
            }
        })
    }

    fn each(
        &mut self,
        tangents: Vec<Value>,
        out: &mut Block,
        mut each: impl FnMut(&mut Self, Value, &mut Block) -> Value,
    ) -> Vec<Value> {
        tangents.into_iter().map(|tangent| each(self, tangent, out)).collect()
    }
}
