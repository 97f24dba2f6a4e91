//! How an expression hands its adjoint on to what it is made of.

use crate::error::Result;
use crate::program::rewrite::function_builder::FunctionBuilder;
use crate::program::rewrite::transpose::adjoint::Adjoint;
use crate::program::rewrite::transpose::back::Back;
use crate::program::rewrite::transpose::names::no_way_back;
use naga::{BinaryOperator, Block, Expression, Handle, MathFunction, ScalarKind, TypeInner, UnaryOperator};

type Value = Handle<Expression>;

impl Back<'_, '_> {
    pub(super) fn select(
        &mut self,
        condition: Value,
        accept: Value,
        reject: Value,
        out: &mut Block,
    ) -> Value {
        self.emit(Expression::Select { condition, accept, reject }, out)
    }

    pub(super) fn negated(&mut self, expr: Value, out: &mut Block) -> Value {
        self.emit(Expression::Unary { op: UnaryOperator::Negate, expr }, out)
    }

    pub(super) fn is_vector(&self, old: Value) -> bool {
        matches!(self.shared.inner(self.function, old), TypeInner::Vector { .. })
    }

    /// Hands the adjoint of an expression on to what it is made of.
    pub(super) fn expression(&mut self, old: Value, out: &mut Block) -> Result<()> {
        let ty = self.type_of(old);
        let adjoint = self.take(old, ty, out);
        if adjoint.is_zero() {
            return Ok(());
        }
        let expression = self.old.expressions[old].clone();
        match expression {
            Expression::Load { pointer } => {
                if let Some(pointer) = self.adjoint_pointer(pointer, out) {
                    self.add_to_memory(pointer, ty, adjoint, out);
                }
                return Ok(());
            }
            Expression::AccessIndex { base, index } => {
                self.contribute(base, Adjoint::part(index, adjoint), out);
                return Ok(());
            }
            _ => {}
        }
        let is_composed = matches!(expression, Expression::Compose { .. });
        if is_composed && self.is_composite(ty) {
            let Expression::Compose { components, .. } = expression else { return Ok(()) };
            let mut parts = self.parts(adjoint, ty, out).parts;
            for (index, component) in (0..).zip(components) {
                self.contribute(component, parts.remove(&index).unwrap_or_default(), out);
            }
            return Ok(());
        }
        let Some(whole) = self.materialised(&adjoint, ty, out) else { return Ok(()) };
        match expression {
            Expression::Compose { components, .. } => {
                let mut first = 0;
                for component in components {
                    let inner = self.shared.inner(self.function, component).clone();
                    if let TypeInner::Vector { size, .. } = inner {
                        let parts = (first..first + size as u32).map(|i| self.part(whole, i, out)).collect();
                        let ty = self.type_of(component);
                        let part = self.emit(Expression::Compose { ty, components: parts }, out);
                        self.contribute_whole(component, part, out);
                        first += size as u32;
                    } else {
                        let part = self.part(whole, first, out);
                        self.contribute_whole(component, part, out);
                        first += 1;
                    }
                }
            }
            Expression::Splat { size, value } => {
                let mut sum = self.part(whole, 0, out);
                for index in 1..size as u32 {
                    let part = self.part(whole, index, out);
                    sum = self.binary(BinaryOperator::Add, sum, part, out);
                }
                self.contribute_whole(value, sum, out);
            }
            Expression::Swizzle { size, vector, pattern } => {
                for (index, component) in (0..size as u32).zip(pattern) {
                    let part = Adjoint::whole(self.part(whole, index, out));
                    self.contribute(vector, Adjoint::part(component as u32, part), out);
                }
            }
            Expression::Unary { op: UnaryOperator::Negate, expr } => {
                let negated = self.negated(whole, out);
                self.contribute_whole(expr, negated, out);
            }
            Expression::Binary { op, left, right } => self.arithmetic(op, [left, right], old, whole, out)?,
            Expression::Select { condition, accept, reject } => {
                let condition = self.value(condition);
                let zero = self.append(Expression::ZeroValue(ty));
                if self.varies(accept) {
                    let part = self.select(condition, whole, zero, out);
                    self.contribute_whole(accept, part, out);
                }
                if self.varies(reject) {
                    let part = self.select(condition, zero, whole, out);
                    self.contribute_whole(reject, part, out);
                }
            }
            Expression::Math { fun, arg, arg1, arg2, .. } => {
                let arguments: Vec<Value> = [Some(arg), arg1, arg2].into_iter().flatten().collect();
                self.math(fun, &arguments, old, whole, out)?;
            }
            Expression::As { expr, kind: ScalarKind::Float, .. } => self.contribute_whole(expr, whole, out),
            _ => return Err(no_way_back(self.shared.name(self.function))),
        }
        Ok(())
    }

    pub(super) fn arithmetic(
        &mut self,
        op: BinaryOperator,
        [left, right]: [Value; 2],
        old: Value,
        whole: Value,
        out: &mut Block,
    ) -> Result<()> {
        use BinaryOperator::{Add, Divide, Multiply, Subtract};
        match op {
            Add => {
                self.contribute_whole(left, whole, out);
                self.contribute_whole(right, whole, out);
            }
            Subtract => {
                self.contribute_whole(left, whole, out);
                if self.varies(right) {
                    let negated = self.negated(whole, out);
                    self.contribute_whole(right, negated, out);
                }
            }
            Multiply => {
                let is_matrix = |this: &Self, old: Value| {
                    matches!(this.shared.inner(this.function, old), TypeInner::Matrix { .. })
                };
                if is_matrix(self, left) || is_matrix(self, right) {
                    return Err(no_way_back(self.shared.name(self.function)));
                }
                for (one, other) in [(left, right), (right, left)] {
                    if self.varies(one) {
                        let other_value = self.value(other);
                        // A scalar times a vector.
                        let part = match !self.is_vector(one) && self.is_vector(other) {
                            true => self.dot(whole, other_value, out),
                            false => self.binary(Multiply, whole, other_value, out),
                        };
                        self.contribute_whole(one, part, out);
                    }
                }
            }
            Divide => {
                // (a / b)' = (a' - (a / b) b') / b.
                let divisor = self.value(right);
                let over = self.binary(Divide, whole, divisor, out);
                self.contribute_whole(left, over, out);
                if self.varies(right) {
                    let quotient = self.value(old);
                    let product = self.binary(Multiply, over, quotient, out);
                    let negated = self.negated(product, out);
                    self.contribute_whole(right, negated, out);
                }
            }
            _ => return Err(no_way_back(self.shared.name(self.function))),
        }
        Ok(())
    }

    pub(super) fn dot(&mut self, arg: Value, arg1: Value, out: &mut Block) -> Value {
        let fun = MathFunction::Dot;
        self.emit(Expression::Math { fun, arg, arg1: Some(arg1), arg2: None, arg3: None }, out)
    }

    pub(super) fn math(
        &mut self,
        fun: MathFunction,
        old: &[Value],
        result: Value,
        whole: Value,
        out: &mut Block,
    ) -> Result<()> {
        use BinaryOperator::{Divide, Greater, Less, Multiply};
        let ty = self.type_of(old[0]);
        let zero = self.append(Expression::ZeroValue(ty));
        match fun {
            MathFunction::Abs => {
                let value = self.value(old[0]);
                let is_below = self.binary(Less, value, zero, out);
                let negated = self.negated(whole, out);
                let part = self.select(is_below, negated, whole, out);
                self.contribute_whole(old[0], part, out);
            }
            MathFunction::Min | MathFunction::Max => {
                let op = if fun == MathFunction::Min { Less } else { Greater };
                let [first, second] = [self.value(old[0]), self.value(old[1])];
                let is_second = self.binary(op, second, first, out);
                let part = self.select(is_second, zero, whole, out);
                self.contribute_whole(old[0], part, out);
                let part = self.select(is_second, whole, zero, out);
                self.contribute_whole(old[1], part, out);
            }
            MathFunction::Clamp => {
                let [x, low, high] = [0, 1, 2].map(|i| self.value(old[i]));
                let is_low = self.binary(Less, x, low, out);
                let is_high = self.binary(Greater, x, high, out);
                let within = self.select(is_low, zero, whole, out);
                let within = self.select(is_high, zero, within, out);
                self.contribute_whole(old[0], within, out);
                let below = self.select(is_low, whole, zero, out);
                let below = self.select(is_high, zero, below, out);
                self.contribute_whole(old[1], below, out);
                let above = self.select(is_high, whole, zero, out);
                self.contribute_whole(old[2], above, out);
            }
            MathFunction::Sqrt => {
                // As on the way forward, a root of 0 has no slope.
                let root = self.value(result);
                let is_positive = self.binary(Greater, root, zero, out);
                let doubled = self.binary(BinaryOperator::Add, root, root, out);
                let slope = self.binary(Divide, whole, doubled, out);
                let part = self.select(is_positive, slope, zero, out);
                self.contribute_whole(old[0], part, out);
            }
            MathFunction::Fma | MathFunction::Dot => {
                for (one, other) in [(old[0], old[1]), (old[1], old[0])] {
                    if self.varies(one) {
                        let other = self.value(other);
                        let part = self.binary(Multiply, whole, other, out);
                        self.contribute_whole(one, part, out);
                    }
                }
                if let Some(added) = old.get(2) {
                    self.contribute_whole(*added, whole, out);
                }
            }
            MathFunction::Cross => {
                // y' = a' x b + a x b', so that y . (a' x b) = a' . (b x y).
                let cross = |this: &mut Self, arg: Value, arg1: Value, out: &mut Block| {
                    this.emit(Expression::Math { fun, arg, arg1: Some(arg1), arg2: None, arg3: None }, out)
                };
                let [a, b] = [self.value(old[0]), self.value(old[1])];
                let part = cross(self, b, whole, out);
                self.contribute_whole(old[0], part, out);
                let part = cross(self, whole, a, out);
                self.contribute_whole(old[1], part, out);
            }
            MathFunction::Floor | MathFunction::Ceil | MathFunction::Trunc | MathFunction::Round => {}
            _ => return Err(no_way_back(self.shared.name(self.function))),
        }
        Ok(())
    }
}
