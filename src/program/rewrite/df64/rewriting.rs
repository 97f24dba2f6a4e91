//! The state of rewriting a module, which all its functions share.

use crate::error::{Error, Result};
use crate::model::double_word::split;
use naga::valid::ModuleInfo;
use naga::{Expression, Handle, Literal, Module, Scalar, Span, Type, TypeInner, VectorSize};
use std::collections::HashMap;

/// How the names of the library's functions begin.
pub(super) const PREFIX: &str = "df64_";

pub(super) fn unknown(what: impl std::fmt::Debug) -> Error {
    Error::Internal(format!("df64 has no counterpart of {what:?}"))
}

/// The new module as it grows, and the new handles of the old module's parts.
pub(super) struct Rewriting<'a> {
    pub(super) old: &'a Module,
    pub(super) info: &'a ModuleInfo,
    pub(super) new: Module,
    pub(super) types: HashMap<Handle<Type>, Handle<Type>>,
    pub(super) constants: HashMap<Handle<naga::Constant>, Handle<naga::Constant>>,
    pub(super) globals: HashMap<Handle<naga::GlobalVariable>, Handle<naga::GlobalVariable>>,
    pub(super) functions: HashMap<Handle<naga::Function>, Handle<naga::Function>>,
    pub(super) library: HashMap<String, Handle<naga::Function>>,
    /// Pairs of literals, by the bits of the f64.
    pub(super) literals: HashMap<u64, Handle<naga::Constant>>,
}

impl<'a> Rewriting<'a> {
    pub(super) fn new(old: &'a Module, info: &'a ModuleInfo) -> Self {
        Rewriting {
            old,
            info,
            new: Module::default(),
            types: HashMap::new(),
            constants: HashMap::new(),
            globals: HashMap::new(),
            functions: HashMap::new(),
            library: HashMap::new(),
            literals: HashMap::new(),
        }
    }

    pub(super) fn insert_type(&mut self, name: Option<String>, inner: TypeInner) -> Handle<Type> {
        self.new.types.insert(Type { name, inner }, Span::UNDEFINED)
    }

    /// The type of a real.
    pub(super) fn pair(&mut self) -> Handle<Type> {
        self.insert_type(None, TypeInner::Vector { size: VectorSize::Bi, scalar: Scalar::F32 })
    }

    /// The type of a vector of reals: a column each.
    pub(super) fn columns(&mut self, size: VectorSize) -> Handle<Type> {
        let inner = TypeInner::Matrix { columns: size, rows: VectorSize::Bi, scalar: Scalar::F32 };
        self.insert_type(None, inner)
    }

    pub(super) fn map_type(&mut self, old: Handle<Type>) -> Result<Handle<Type>> {
        if let Some(new) = self.types.get(&old) {
            return Ok(*new);
        }
        // What an exchange of integers gives: naga knows the type by its place in the module.
        let predeclared = &self.old.special_types.predeclared_types;
        if let Some((kind, _)) = predeclared.iter().find(|(_, known)| **known == old) {
            let new = self.new.generate_predeclared_type(kind.clone());
            self.types.insert(old, new);
            return Ok(new);
        }
        let kind = &self.old.types[old];
        let new = match &kind.inner {
            TypeInner::Scalar(Scalar::F64) => self.pair(),
            TypeInner::Vector { size, scalar: Scalar::F64 } => self.columns(*size),
            TypeInner::Pointer { base, space } => {
                let base = self.map_type(*base)?;
                self.insert_type(kind.name.clone(), TypeInner::Pointer { base, space: *space })
            }
            TypeInner::Array { base, size, .. } => {
                let base = self.map_type(*base)?;
                let stride = self.layout(base)?.1;
                self.insert_type(kind.name.clone(), TypeInner::Array { base, size: *size, stride })
            }
            TypeInner::Struct { members, .. } => {
                let inner = self.structure(members)?;
                self.insert_type(kind.name.clone(), inner)
            }
            TypeInner::Matrix { scalar: Scalar::F64, .. }
            | TypeInner::ValuePointer { scalar: Scalar::F64, .. } => {
                return Err(unknown(&kind.inner));
            }
            other => self.insert_type(kind.name.clone(), other.clone()),
        };
        self.types.insert(old, new);
        Ok(new)
    }

    /// Alignment of a type, and the distance of two in an array \[bytes\].
    pub(super) fn layout(&self, kind: Handle<Type>) -> Result<(u32, u32)> {
        let mut layouter = naga::proc::Layouter::default();
        layouter.update(self.new.to_ctx()).map_err(|error| Error::Internal(error.to_string()))?;
        let layout = layouter[kind];
        Ok((layout.alignment.round_up(1), layout.to_stride()))
    }

    /// A struct, with its members laid out anew by WGSL's rules.
    pub(super) fn structure(&mut self, members: &[naga::StructMember]) -> Result<TypeInner> {
        let (mut end, mut alignment) = (0_u32, 1);
        let mut placed = Vec::new();
        for member in members {
            let ty = self.map_type(member.ty)?;
            let align = self.layout(ty)?.0;
            let offset = end.next_multiple_of(align);
            end = offset + self.new.types[ty].inner.size(self.new.to_ctx());
            alignment = alignment.max(align);
            placed.push(naga::StructMember { ty, offset, ..member.clone() });
        }
        Ok(TypeInner::Struct { members: placed, span: end.next_multiple_of(alignment) })
    }

    /// The constant that holds a literal.
    pub(super) fn literal(&mut self, value: f64) -> Result<Handle<naga::Constant>> {
        if let Some(constant) = self.literals.get(&value.to_bits()) {
            return Ok(*constant);
        }
        let init = self.literal_expression(value)?;
        let ty = self.pair();
        let constant = naga::Constant { name: None, ty, init };
        let constant = self.new.constants.append(constant, Span::UNDEFINED);
        self.literals.insert(value.to_bits(), constant);
        Ok(constant)
    }

    pub(super) fn literal_expression(&mut self, value: f64) -> Result<Handle<Expression>> {
        let pair = split(value);
        if !pair[0].is_finite() {
            return Err(Error::Internal(format!("{value:e} in a shader does not fit df64")));
        }
        let ty = self.pair();
        let components =
            pair.map(|part| self.new.global_expressions.append(literal_f32(part), Span::UNDEFINED)).to_vec();
        Ok(self.new.global_expressions.append(Expression::Compose { ty, components }, Span::UNDEFINED))
    }

    /// The value of a constant that is an f64.
    pub(super) fn constant_value(&self, constant: Handle<naga::Constant>) -> Option<f64> {
        match self.old.global_expressions[self.old.constants[constant].init] {
            Expression::Literal(Literal::F64(value)) => Some(value),
            _ => None,
        }
    }

    pub(super) fn globals(&mut self) -> Result<()> {
        if !self.old.overrides.is_empty() {
            return Err(unknown("an override"));
        }
        let mut expressions = HashMap::new();
        for (handle, expression) in self.old.global_expressions.iter() {
            let new = self.global_expression(expression, &expressions)?;
            expressions.insert(handle, new);
        }
        for (handle, constant) in self.old.constants.iter() {
            let ty = self.map_type(constant.ty)?;
            let new = naga::Constant { name: constant.name.clone(), ty, init: expressions[&constant.init] };
            let new = self.new.constants.append(new, Span::UNDEFINED);
            self.constants.insert(handle, new);
        }
        for (handle, variable) in self.old.global_variables.iter() {
            let ty = self.map_type(variable.ty)?;
            let init = variable.init.map(|init| expressions[&init]);
            let new = naga::GlobalVariable { ty, init, ..variable.clone() };
            let new = self.new.global_variables.append(new, Span::UNDEFINED);
            self.globals.insert(handle, new);
        }
        Ok(())
    }

    pub(super) fn global_expression(
        &mut self,
        expression: &Expression,
        known: &HashMap<Handle<Expression>, Handle<Expression>>,
    ) -> Result<Handle<Expression>> {
        let new = match expression {
            Expression::Literal(Literal::F64(value)) => return self.literal_expression(*value),
            Expression::Literal(literal) => Expression::Literal(*literal),
            Expression::Constant(constant) => match self.constants.get(constant) {
                Some(constant) => Expression::Constant(*constant),
                None => return Ok(known[&self.old.constants[*constant].init]),
            },
            Expression::ZeroValue(ty) => Expression::ZeroValue(self.map_type(*ty)?),
            Expression::Compose { ty, components } => Expression::Compose {
                ty: self.map_type(*ty)?,
                components: components.iter().map(|component| known[component]).collect(),
            },
            other => return Err(unknown(other)),
        };
        Ok(self.new.global_expressions.append(new, Span::UNDEFINED))
    }

    /// Begins an entry point by copying the zero that protects rounded results (shaders/math/df64.wgsl).
    pub(super) fn copy_zero(&self, function: &mut naga::Function) -> Result<()> {
        let mut global = |name: &str| {
            let mut variables = self.new.global_variables.iter();
            let found = variables.find(|(_, variable)| variable.name.as_deref() == Some(name));
            let (variable, _) =
                found.ok_or_else(|| Error::Internal(format!("no {name} in the df64 shader")))?;
            Ok::<_, Error>(function.expressions.append(Expression::GlobalVariable(variable), Span::UNDEFINED))
        };
        let (pointer, source) = (global("df64_zero")?, global("df64_zero_source")?);
        let value = function.expressions.append(Expression::Load { pointer: source }, Span::UNDEFINED);
        let mut body = naga::Block::new();
        body.push(naga::Statement::Emit(naga::Range::new_from_bounds(value, value)), Span::UNDEFINED);
        body.push(naga::Statement::Store { pointer, value }, Span::UNDEFINED);
        body.extend_block(std::mem::take(&mut function.body));
        function.body = body;
        Ok(())
    }

    pub(super) fn library_function(&self, name: &str) -> Result<Handle<naga::Function>> {
        self.library
            .get(&format!("{PREFIX}{name}"))
            .copied()
            .ok_or_else(|| Error::Internal(format!("shaders/math/df64.wgsl has no {PREFIX}{name}")))
    }
}

pub(super) fn literal_f32(value: f32) -> Expression {
    Expression::Literal(Literal::F32(value))
}
