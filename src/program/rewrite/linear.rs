//! The rules of derivatives, each once: how an operation's result changes when its operands change a little.
//!
//! For example, the product of `a` and `b` changes by `da * b + a * db`. Such a change is a [`Linear`] function of the
//! operands' changes. Forward mode evaluates the function ([`crate::program::rewrite::jvp`]). Reverse mode transposes it
//! ([`crate::program::rewrite::transpose`]). So both modes have the same derivatives.
//!
//! Source: Radul, Paszke, Frostig, Johnson and Maclaurin, You Only Linearize Once: Tangents Transpose to Gradients (2023).

use crate::error::{Error, Result};
use crate::program::rewrite::function_builder::{FunctionBuilder, real_literal};
use crate::program::rewrite::rules::Rule;
use naga::{
    BinaryOperator, Block, Expression, Function, Handle, MathFunction, Scalar, ScalarKind, Type, TypeInner,
    UnaryOperator,
};

/// A value. Operands are values of the old function, coefficients are values of the new one.
type Value = Handle<Expression>;

/// A linear function of the changes of operands.
#[derive(Debug)]
pub(super) enum Linear {
    /// The change of an operand.
    Of(Value),
    Negative(Box<Linear>),
    /// The negative of a change where a condition holds, else the change.
    NegativeWhere(Value, Box<Linear>),
    Sum(Box<Linear>, Box<Linear>),
    /// A change times a coefficient.
    Product(Product, Side, Box<Linear>, Value),
    /// A change over a coefficient. If there are a condition and a zero: the zero where the condition does not hold.
    Quotient(Box<Linear>, Value, Option<(Value, Value)>),
    /// One change where a condition holds, else the other one. `None` is no change of a value of that type.
    Choice(Value, [Option<Box<Linear>>; 2], Handle<Type>),
    /// Parts of changes in another order, as an operation of the old function takes parts of its operands.
    Rearranged(Expression),
}

/// Where a change stands in a product.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Side {
    Left,
    Right,
}

/// What is linear in both operands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Product {
    /// Real by real, lane by lane, or a vector that changes by a real.
    Lanes,
    /// A real that changes by a vector.
    Widening,
    /// With a matrix on either side.
    Matrix,
    Dot,
    Cross,
}

impl Product {
    /// The product of two values.
    pub(super) fn expression(self, left: Value, right: Value) -> Expression {
        let of_vectors = |fun| Expression::Math { fun, arg: left, arg1: Some(right), arg2: None, arg3: None };
        match self {
            Product::Lanes | Product::Widening | Product::Matrix => {
                Expression::Binary { op: BinaryOperator::Multiply, left, right }
            }
            Product::Dot => of_vectors(MathFunction::Dot),
            Product::Cross => of_vectors(MathFunction::Cross),
        }
    }
}

/// The error of an operation for which there is no rule.
pub(super) fn unknown(what: impl std::fmt::Debug) -> Error {
    Error::Internal(format!("no rule for the derivative of {what:?}"))
}

/// All values that an expression reads.
pub(super) fn read_by(expression: &Expression) -> Vec<Value> {
    match *expression {
        Expression::Compose { ref components, .. } => components.clone(),
        Expression::Splat { value: of, .. }
        | Expression::Swizzle { vector: of, .. }
        | Expression::AccessIndex { base: of, .. }
        | Expression::Load { pointer: of }
        | Expression::Unary { expr: of, .. }
        | Expression::As { expr: of, .. }
        | Expression::Relational { argument: of, .. }
        | Expression::ArrayLength(of) => vec![of],
        Expression::Access { base, index } => vec![base, index],
        Expression::Binary { left, right, .. } => vec![left, right],
        Expression::Select { condition, accept, reject } => vec![condition, accept, reject],
        Expression::Math { arg, arg1, arg2, arg3, .. } => {
            [Some(arg), arg1, arg2, arg3].into_iter().flatten().collect()
        }
        _ => Vec::new(),
    }
}

/// The values that an expression reads whose changes change the result.
pub(super) fn operands(expression: &Expression) -> Vec<Value> {
    use MathFunction::{Ceil, Floor, Round, Trunc};
    match *expression {
        Expression::Access { base, .. } => vec![base],
        Expression::Select { accept, reject, .. } => vec![accept, reject],
        // Steps, and what is no real.
        Expression::Math { fun: Floor | Ceil | Trunc | Round, .. }
        | Expression::Relational { .. }
        | Expression::ArrayLength(_) => Vec::new(),
        Expression::As { kind, .. } if kind != ScalarKind::Float => Vec::new(),
        ref other => read_by(other),
    }
}

/// A function that is written with the changes of an old one, forward or back.
pub(super) trait Linearise: FunctionBuilder {
    /// True if an old value can change.
    fn changes(&mut self, old: Value) -> bool;

    /// The new value of an old one.
    fn coefficient(&mut self, old: Value) -> Result<Value>;

    /// The type of an old value, in the new module.
    fn type_of(&mut self, old: Value) -> Handle<Type>;

    fn inner_of(&self, old: Value) -> &TypeInner;

    /// What a real is.
    fn real(&self) -> Scalar;

    /// The function of this name, as it was.
    fn plain(&self, name: &str) -> Result<Handle<Function>>;

    /// The change of an old value. `None` if the value does not change.
    fn change(&mut self, old: Value) -> Option<Linear> {
        self.changes(old).then_some(Linear::Of(old))
    }

    /// What [`Linear::Quotient`] gives of a change: forward and back alike.
    fn quotient(
        &mut self,
        of: Value,
        by: Value,
        only_where: Option<(Value, Value)>,
        out: &mut Block,
    ) -> Value {
        let quotient = self.binary(BinaryOperator::Divide, of, by, out);
        match only_where {
            Some((condition, zero)) => self.select(condition, quotient, zero, out),
            None => quotient,
        }
    }

    /// What [`Linear::NegativeWhere`] gives of a change: forward and back alike.
    fn negative_where(&mut self, condition: Value, of: Value, out: &mut Block) -> Value {
        let negated = self.negated(of, out);
        self.select(condition, negated, of, out)
    }

    /// The change of an expression, other than one that reads memory. `None` if the expression does not change.
    fn linearised(&mut self, old: Value, expression: &Expression, out: &mut Block) -> Result<Option<Linear>> {
        if !operands(expression).into_iter().any(|operand| self.changes(operand)) {
            return Ok(None);
        }
        Ok(match *expression {
            Expression::Compose { .. }
            | Expression::Splat { .. }
            | Expression::Swizzle { .. }
            | Expression::Access { .. }
            | Expression::AccessIndex { .. } => Some(Linear::Rearranged(expression.clone())),
            Expression::Unary { op: UnaryOperator::Negate, expr } => negative(self.change(expr)),
            Expression::Binary { op, left, right } => self.arithmetic(op, left, right, old)?,
            Expression::Select { condition, accept, reject } => {
                let condition = self.coefficient(condition)?;
                let (accept, reject) = (self.change(accept), self.change(reject));
                choice(condition, accept, reject, self.type_of(old))
            }
            Expression::Math { fun, arg, arg1, arg2, .. } => {
                let arguments: Vec<Value> = [Some(arg), arg1, arg2].into_iter().flatten().collect();
                self.mathematics(fun, &arguments, old, out)?
            }
            Expression::As { expr, kind: ScalarKind::Float, .. } => self.change(expr),
            ref other => return Err(unknown(other)),
        })
    }

    fn arithmetic(
        &mut self,
        op: BinaryOperator,
        left: Value,
        right: Value,
        result: Value,
    ) -> Result<Option<Linear>> {
        Ok(match op {
            BinaryOperator::Add => sum(self.change(left), self.change(right)),
            BinaryOperator::Subtract => sum(self.change(left), negative(self.change(right))),
            BinaryOperator::Multiply => self.product_rule(Product::Lanes, left, right)?,
            BinaryOperator::Divide => {
                // (a / b)' = (a' - (a / b) b') / b.
                let of_divisor = match self.change(right) {
                    Some(change) => {
                        Some(product(Product::Lanes, Side::Right, change, self.coefficient(result)?))
                    }
                    None => None,
                };
                let above = sum(self.change(left), negative(of_divisor));
                let by = self.coefficient(right)?;
                above.map(|of| Linear::Quotient(Box::new(of), by, None))
            }
            other => return Err(unknown(other)),
        })
    }

    /// (a b)' = a' b + a b', for each product.
    fn product_rule(&mut self, kind: Product, left: Value, right: Value) -> Result<Option<Linear>> {
        let term = |this: &mut Self, of: Value, by: Value, side: Side| -> Result<Option<Linear>> {
            let Some(change) = this.change(of) else { return Ok(None) };
            let is_vector = |value: Value| matches!(this.inner_of(value), TypeInner::Vector { .. });
            let is_matrix = |value: Value| matches!(this.inner_of(value), TypeInner::Matrix { .. });
            let kind = match kind {
                Product::Lanes if is_matrix(of) || is_matrix(by) => Product::Matrix,
                Product::Lanes if is_vector(by) && !is_vector(of) => Product::Widening,
                kind => kind,
            };
            Ok(Some(product(kind, side, change, this.coefficient(by)?)))
        };
        Ok(sum(term(self, left, right, Side::Left)?, term(self, right, left, Side::Right)?))
    }

    fn mathematics(
        &mut self,
        fun: MathFunction,
        old: &[Value],
        result: Value,
        out: &mut Block,
    ) -> Result<Option<Linear>> {
        use BinaryOperator::{Add, Greater, Less};
        let ty = self.type_of(result);
        Ok(match fun {
            MathFunction::Abs => {
                let value = self.coefficient(old[0])?;
                let zero = self.append(Expression::ZeroValue(ty));
                let is_below = self.binary(Less, value, zero, out);
                self.change(old[0]).map(|of| Linear::NegativeWhere(is_below, Box::new(of)))
            }
            MathFunction::Min | MathFunction::Max => {
                let op = if fun == MathFunction::Min { Less } else { Greater };
                let [first, second] = [self.coefficient(old[0])?, self.coefficient(old[1])?];
                let is_second = self.binary(op, second, first, out);
                choice(is_second, self.change(old[1]), self.change(old[0]), ty)
            }
            MathFunction::Clamp => {
                let [x, low, high] =
                    [self.coefficient(old[0])?, self.coefficient(old[1])?, self.coefficient(old[2])?];
                let is_low = self.binary(Less, x, low, out);
                let is_high = self.binary(Greater, x, high, out);
                let raised = choice(is_low, self.change(old[1]), self.change(old[0]), ty);
                choice(is_high, self.change(old[2]), raised, ty)
            }
            MathFunction::Sqrt => {
                // Where the root is 0 its slope is infinite. By convention the slope is 0: on an axis, and where a ray grazes.
                let root = self.coefficient(result)?;
                let zero = self.append(Expression::ZeroValue(ty));
                let is_positive = self.binary(Greater, root, zero, out);
                let by = self.binary(Add, root, root, out);
                self.change(old[0]).map(|of| Linear::Quotient(Box::new(of), by, Some((is_positive, zero))))
            }
            MathFunction::Fma => sum(self.product_rule(Product::Lanes, old[0], old[1])?, self.change(old[2])),
            MathFunction::Dot => self.product_rule(Product::Dot, old[0], old[1])?,
            MathFunction::Cross => self.product_rule(Product::Cross, old[0], old[1])?,
            other => return Err(unknown(other)),
        })
    }

    /// The change of a call's result, by the rule of its function. `None` if the result does not change.
    fn linearised_call(
        &mut self,
        rule: Rule,
        arguments: &[Value],
        result: Value,
        out: &mut Block,
    ) -> Result<Option<Linear>> {
        let Some(argument) = rule.differentiated(arguments) else { return Ok(None) };
        let Some(change) = self.change(argument) else { return Ok(None) };
        Ok(Some(match rule {
            Rule::Constant | Rule::Note | Rule::Recalled(_) | Rule::Attached => change,
            Rule::Exponential => product(Product::Lanes, Side::Right, change, self.coefficient(result)?),
            Rule::Logarithm => Linear::Quotient(Box::new(change), self.coefficient(argument)?, None),
            Rule::Turned(name, sign) => {
                let function = self.plain(name)?;
                let argument = self.coefficient(argument)?;
                let turned = self.call_for_result(function, vec![argument], out);
                let sign = real_literal(self.real(), sign);
                let sign = self.append(sign);
                let slope = self.binary(BinaryOperator::Multiply, turned, sign, out);
                product(Product::Lanes, Side::Right, change, slope)
            }
        }))
    }
}

fn product(product: Product, side: Side, of: Linear, by: Value) -> Linear {
    Linear::Product(product, side, Box::new(of), by)
}

fn negative(of: Option<Linear>) -> Option<Linear> {
    of.map(|of| Linear::Negative(Box::new(of)))
}

fn sum(left: Option<Linear>, right: Option<Linear>) -> Option<Linear> {
    match (left, right) {
        (Some(left), Some(right)) => Some(Linear::Sum(Box::new(left), Box::new(right))),
        (one, other) => one.or(other),
    }
}

fn choice(
    condition: Value,
    accept: Option<Linear>,
    reject: Option<Linear>,
    ty: Handle<Type>,
) -> Option<Linear> {
    if accept.is_none() && reject.is_none() {
        return None;
    }
    Some(Linear::Choice(condition, [accept, reject].map(|change| change.map(Box::new)), ty))
}
