//! How an expression hands its adjoint on to what it is made of: the transposition of its change.

use crate::error::Result;
use crate::program::rewrite::function_builder::FunctionBuilder;
use crate::program::rewrite::linear::{Linear, Linearise, Product, Side};
use crate::program::rewrite::transpose::adjoint::Adjoint;
use crate::program::rewrite::transpose::back::Back;
use crate::program::rewrite::transpose::names::no_way_back;
use naga::{BinaryOperator, Block, Expression, Function, Handle, Scalar, Type, TypeInner};

type Value = Handle<Expression>;

impl Linearise for Back<'_, '_> {
    fn changes(&mut self, old: Value) -> bool {
        self.varies(old)
    }

    fn coefficient(&mut self, old: Value) -> Result<Value> {
        Ok(self.value(old))
    }

    fn type_of(&mut self, old: Value) -> Handle<Type> {
        self.shared.type_of(self.function, old)
    }

    fn inner_of(&self, old: Value) -> &TypeInner {
        self.shared.inner(self.function, old)
    }

    fn real(&self) -> Scalar {
        self.shared.rewriting.real
    }

    fn plain(&self, name: &str) -> Result<Handle<Function>> {
        self.shared.rewriting.plain(name)
    }
}

impl Back<'_, '_> {
    /// Hands the adjoint of an expression on to what it is made of.
    pub(super) fn expression(&mut self, old: Value, out: &mut Block) -> Result<()> {
        let ty = self.type_of(old);
        let adjoint = self.take(old, ty, out);
        if adjoint.is_zero() {
            return Ok(());
        }
        let expression = &self.old.expressions[old];
        if let Expression::Load { pointer } = *expression {
            if let Some(pointer) = self.adjoint_pointer(pointer, out) {
                self.add_to_memory(pointer, ty, adjoint, out);
            }
            return Ok(());
        }
        let change = self.linearised(old, expression, out);
        match change.map_err(|_| no_way_back(self.shared.name(self.function)))? {
            Some(change) => self.transposed_change(&change, adjoint, ty, out),
            None => Ok(()),
        }
    }

    /// Hands an adjoint, whose value is of type `ty`, back through a linear function to the operands of that function.
    pub(super) fn transposed_change(
        &mut self,
        change: &Linear,
        adjoint: Adjoint,
        ty: Handle<Type>,
        out: &mut Block,
    ) -> Result<()> {
        // Parts stay parts here, so that no zeros of a struct are added.
        match *change {
            Linear::Of(old) => {
                self.contribute(old, adjoint, out);
                return Ok(());
            }
            Linear::Rearranged(Expression::AccessIndex { base, index }) => {
                self.contribute(base, Adjoint::part(index, adjoint), out);
                return Ok(());
            }
            Linear::Rearranged(Expression::Compose { ref components, .. }) if self.is_composite(ty) => {
                let mut adjoints = self.parts(adjoint, ty, out).parts;
                for (index, part) in (0..).zip(components) {
                    self.contribute(*part, adjoints.remove(&index).unwrap_or_default(), out);
                }
                return Ok(());
            }
            _ => {}
        }
        match self.materialised(&adjoint, ty, out) {
            Some(whole) => self.transposed_whole(change, whole, out),
            None => Ok(()),
        }
    }

    /// As `transposed_change`, of a whole adjoint.
    fn transposed_whole(&mut self, change: &Linear, whole: Value, out: &mut Block) -> Result<()> {
        match *change {
            Linear::Of(old) => self.contribute_whole(old, whole, out),
            Linear::Negative(ref of) => {
                let negated = self.negated(whole, out);
                self.transposed_whole(of, negated, out)?;
            }
            Linear::NegativeWhere(condition, ref of) => {
                let part = self.negative_where(condition, whole, out);
                self.transposed_whole(of, part, out)?;
            }
            Linear::Sum(ref left, ref right) => {
                self.transposed_whole(left, whole, out)?;
                self.transposed_whole(right, whole, out)?;
            }
            Linear::Product(product, side, ref of, by) => {
                let part = match product {
                    Product::Lanes | Product::Dot => self.binary(BinaryOperator::Multiply, whole, by, out),
                    Product::Widening => self.emit(Product::Dot.expression(whole, by), out),
                    // y . (a' x b) = a' . (b x y), and y . (b x a') = a' . (y x b).
                    Product::Cross if side == Side::Left => self.emit(product.expression(by, whole), out),
                    Product::Cross => self.emit(product.expression(whole, by), out),
                    Product::Matrix => return Err(no_way_back(self.shared.name(self.function))),
                };
                self.transposed_whole(of, part, out)?;
            }
            Linear::Quotient(ref of, by, only_where) => {
                let part = self.quotient(whole, by, only_where, out);
                self.transposed_whole(of, part, out)?;
            }
            Linear::Choice(condition, [ref accept, ref reject], ty) => {
                let zero = self.append(Expression::ZeroValue(ty));
                if let Some(of) = accept {
                    let part = self.select(condition, whole, zero, out);
                    self.transposed_whole(of, part, out)?;
                }
                if let Some(of) = reject {
                    let part = self.select(condition, zero, whole, out);
                    self.transposed_whole(of, part, out)?;
                }
            }
            Linear::Rearranged(ref expression) => self.transposed_parts(expression, whole, out)?,
        }
        Ok(())
    }

    /// Hands a whole adjoint on to the operands whose parts an expression rearranges.
    fn transposed_parts(&mut self, expression: &Expression, whole: Value, out: &mut Block) -> Result<()> {
        match *expression {
            // Of reals, and of shorter vectors.
            Expression::Compose { ref components, .. } => {
                let mut first = 0;
                for old in components {
                    let part = if let TypeInner::Vector { size, .. } = *self.inner_of(*old) {
                        let lanes = first..first + size as u32;
                        let components = lanes.map(|lane| self.part(whole, lane, out)).collect();
                        first += size as u32;
                        let ty = self.type_of(*old);
                        self.emit(Expression::Compose { ty, components }, out)
                    } else {
                        first += 1;
                        self.part(whole, first - 1, out)
                    };
                    self.contribute_whole(*old, part, out);
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
            _ => return Err(no_way_back(self.shared.name(self.function))),
        }
        Ok(())
    }
}
