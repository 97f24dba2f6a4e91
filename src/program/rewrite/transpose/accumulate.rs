//! Adjoints of values, as the way back gathers them: sums of what each use of a value hands on.

use crate::program::rewrite::function_builder::FunctionBuilder;
use crate::program::rewrite::linear::Linearise;
use crate::program::rewrite::transpose::adjoint::Adjoint;
use crate::program::rewrite::transpose::back::{Back, ROOT};
use naga::{BinaryOperator, Block, Expression, Handle, LocalVariable, Span, Statement, Type, TypeInner};

type Value = Handle<Expression>;

impl Back<'_, '_> {
    /// The type of a part.
    pub(super) fn part_type(&mut self, ty: Handle<Type>, index: u32) -> Handle<Type> {
        match self.inner(ty).clone() {
            TypeInner::Struct { members, .. } => members[index as usize].ty,
            TypeInner::Array { base, .. } => base,
            _ => self.real_type(),
        }
    }

    pub(super) fn part(&mut self, base: Value, index: u32, out: &mut Block) -> Value {
        self.emit(Expression::AccessIndex { base, index }, out)
    }

    /// The parts of an adjoint of a struct or an array. If the adjoint was known as a whole, all parts that hold reals
    /// are there.
    pub(super) fn parts(&mut self, adjoint: Adjoint, ty: Handle<Type>, out: &mut Block) -> Adjoint {
        let Some(whole) = adjoint.whole else { return adjoint };
        let parts: Vec<(u32, Handle<Type>)> = match self.inner(ty).clone() {
            TypeInner::Struct { members, .. } => {
                (0..).zip(members).map(|(i, member)| (i, member.ty)).collect()
            }
            TypeInner::Array { base, size: naga::ArraySize::Constant(num), .. } => {
                (0..num.get()).map(|i| (i, base)).collect()
            }
            _ => return adjoint,
        };
        let mut all = Adjoint { whole: None, parts: adjoint.parts };
        for (index, ty) in parts {
            if self.shared.rewriting.has_reals(ty) {
                let part = Adjoint::whole(self.part(whole, index, out));
                let known = all.parts.remove(&index).unwrap_or_default();
                let sum = self.sum(known, part, ty, out);
                all.parts.insert(index, sum);
            }
        }
        all
    }

    pub(super) fn is_composite(&self, ty: Handle<Type>) -> bool {
        matches!(self.inner(ty), TypeInner::Struct { .. } | TypeInner::Array { .. })
    }

    pub(super) fn sum(
        &mut self,
        left: Adjoint,
        right: Adjoint,
        ty: Handle<Type>,
        out: &mut Block,
    ) -> Adjoint {
        if left.is_zero() {
            return right;
        }
        if right.is_zero() {
            return left;
        }
        let (mut left, mut right) = (left, right);
        if self.is_composite(ty) {
            left = self.parts(left, ty, out);
            right = self.parts(right, ty, out);
        }
        left.whole = match (left.whole, right.whole) {
            (Some(a), Some(b)) => Some(self.binary(BinaryOperator::Add, a, b, out)),
            (one, other) => one.or(other),
        };
        for (index, part) in right.parts {
            let known = left.parts.remove(&index).unwrap_or_default();
            let ty = self.part_type(ty, index);
            let sum = self.sum(known, part, ty, out);
            left.parts.insert(index, sum);
        }
        left
    }

    /// An adjoint as one value; none if it is zero.
    pub(super) fn materialised(
        &mut self,
        adjoint: &Adjoint,
        ty: Handle<Type>,
        out: &mut Block,
    ) -> Option<Value> {
        if adjoint.is_zero() {
            return None;
        }
        if adjoint.parts.is_empty() {
            return adjoint.whole;
        }
        let adjoint = match self.is_composite(ty) {
            true => self.parts(adjoint.clone(), ty, out),
            false => adjoint.clone(),
        };
        let num = match self.inner(ty) {
            TypeInner::Struct { members, .. } => members.len() as u32,
            TypeInner::Vector { size, .. } => *size as u32,
            TypeInner::Array { size: naga::ArraySize::Constant(num), .. } => num.get(),
            _ => 0,
        };
        let mut components = Vec::new();
        for index in 0..num {
            let part_ty = self.part_type(ty, index);
            let mut part = adjoint.parts.get(&index).cloned().unwrap_or_default();
            if let Some(whole) = adjoint.whole {
                let of_whole = Adjoint::whole(self.part(whole, index, out));
                part = self.sum(part, of_whole, part_ty, out);
            }
            let value = self.materialised(&part, part_ty, out);
            components.push(value.unwrap_or_else(|| self.append(Expression::ZeroValue(part_ty))));
        }
        Some(self.emit(Expression::Compose { ty, components }, out))
    }

    /// Adds to the adjoint of an old value.
    pub(super) fn contribute(&mut self, old: Value, adjoint: Adjoint, out: &mut Block) {
        if adjoint.is_zero() || !self.varies(old) {
            return;
        }
        let ty = self.type_of(old);
        let home = match &self.old.expressions[old] {
            Expression::FunctionArgument(_) => ROOT,
            _ => self.homes.get(&old).copied().unwrap_or_default(),
        };
        if home == self.block {
            let known = self.adjoints.remove(&old).unwrap_or_default();
            let sum = self.sum(known, adjoint, ty, out);
            self.adjoints.insert(old, sum);
            return;
        }
        let variable = match self.variables.get(&old) {
            Some(variable) => *variable,
            None => {
                let variable = LocalVariable { name: Some("adjoint".into()), ty, init: None };
                let variable = self.new.local_variables.append(variable, Span::UNDEFINED);
                self.variables.insert(old, variable);
                variable
            }
        };
        let pointer = self.append(Expression::LocalVariable(variable));
        self.add_to_memory(pointer, ty, adjoint, out);
    }

    pub(super) fn contribute_whole(&mut self, old: Value, value: Value, out: &mut Block) {
        self.contribute(old, Adjoint::whole(value), out);
    }

    /// The adjoint of an old value where the value is computed.
    pub(super) fn take(&mut self, old: Value, ty: Handle<Type>, out: &mut Block) -> Adjoint {
        let known = self.adjoints.remove(&old).unwrap_or_default();
        let Some(variable) = self.variables.get(&old) else { return known };
        let pointer = self.append(Expression::LocalVariable(*variable));
        let loaded = self.emit(Expression::Load { pointer }, out);
        self.sum(known, Adjoint::whole(loaded), ty, out)
    }

    pub(super) fn add_to_memory(
        &mut self,
        pointer: Value,
        ty: Handle<Type>,
        adjoint: Adjoint,
        out: &mut Block,
    ) {
        let adjoint = if self.is_composite(ty) { self.parts(adjoint, ty, out) } else { adjoint };
        if let Some(whole) = adjoint.whole {
            let before = self.emit(Expression::Load { pointer }, out);
            let value = self.binary(BinaryOperator::Add, before, whole, out);
            out.push(Statement::Store { pointer, value }, Span::UNDEFINED);
        }
        for (index, part) in adjoint.parts {
            if !part.is_zero() {
                let ty = self.part_type(ty, index);
                let pointer = self.part(pointer, index, out);
                self.add_to_memory(pointer, ty, part, out);
            }
        }
    }

    /// A pointer to the adjoints of what an old pointer points to. `None` for what has no adjoints.
    pub(super) fn adjoint_pointer(&mut self, pointer: Value, out: &mut Block) -> Option<Value> {
        Some(match self.old.expressions[pointer].clone() {
            Expression::LocalVariable(variable) => {
                let twin = match self.locals.get(&variable) {
                    Some(twin) => *twin,
                    None => {
                        let old = &self.old.local_variables[variable];
                        let name = old.name.as_ref().map(|name| format!("{name}_adjoint"));
                        let twin = LocalVariable { name, ty: old.ty, init: None };
                        let twin = self.new.local_variables.append(twin, Span::UNDEFINED);
                        self.locals.insert(variable, twin);
                        twin
                    }
                };
                self.append(Expression::LocalVariable(twin))
            }
            Expression::GlobalVariable(variable) => {
                let twin = *self.shared.twins.get(&variable)?;
                self.append(Expression::GlobalVariable(twin))
            }
            Expression::FunctionArgument(index) => *self.pointers.get(&index)?,
            Expression::AccessIndex { base, index } => {
                let base = self.adjoint_pointer(base, out)?;
                self.part(base, index, out)
            }
            Expression::Access { base, index } => {
                let base = self.adjoint_pointer(base, out)?;
                let index = self.value(index);
                self.emit(Expression::Access { base, index }, out)
            }
            _ => return None,
        })
    }
}
