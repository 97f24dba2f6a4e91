//! The df64 tier: the f64 module with every real as the unevaluated sum of two f32, for devices without f64.
//!
//! The physics is composed as for f64, parsed, and rewritten in naga's representation: an f64 becomes a `vec2<f32>`
//! (high, low), a `vecN<f64>` a matrix of N such columns, and every operation a call of `shaders/math/df64.wgsl`. What
//! comes out is WGSL again, without any f64.

mod function;

use crate::error::{Error, Result};
use crate::program::df64::function::rewrite_function;
pub use crate::program::layout::bindings::DF64_ZERO as ZERO;
use naga::valid::{Capabilities, ModuleInfo, ValidationFlags, Validator};
use naga::{Expression, Handle, Literal, Module, Scalar, Span, Type, TypeInner, VectorSize};
use std::collections::HashMap;

/// Double-word arithmetic, which reads [`ZERO`].
pub const LIBRARY: &str = include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/shaders/math/df64.wgsl"));

/// Names of the library's functions begin with this.
const PREFIX: &str = "df64_";

/// A number as the unevaluated sum of two f32: (high, low), where high is the sum rounded to nearest.
pub fn split(value: f64) -> [f32; 2] {
    let high = value as f32;
    let low = value - f64::from(high);
    [high, if low.is_finite() { low as f32 } else { 0.0 }]
}

/// The number that a pair stands for. The sum is exact for the pair of any f64.
pub fn join([high, low]: [f32; 2]) -> f64 {
    f64::from(high) + f64::from(low)
}

/// An f64 as a pair holds it.
pub fn rounded(value: f64) -> f64 {
    join(split(value))
}

/// The module with pairs in place of f64, and its WGSL. `source` must hold `shaders/math/df64.wgsl`.
///
/// # Errors
/// [`Error::Internal`] if the shader uses f64 in a way that has no counterpart.
pub fn rewrite(module: &Module) -> Result<(Module, String)> {
    let info = validate(module, Capabilities::all())?;
    let mut rewriting = Rewriting::new(module, &info);
    rewriting.globals()?;
    rewriting.functions()?;
    rewriting.entry_points()?;
    let rewritten = rewriting.new;
    let info = validate(&rewritten, Capabilities::all().difference(Capabilities::FLOAT64))?;
    let wgsl = naga::back::wgsl::write_string(&rewritten, &info, naga::back::wgsl::WriterFlags::empty())
        .map_err(|error| Error::internal("writing the df64 shader", &error))?;
    Ok((rewritten, wgsl))
}

fn validate(module: &Module, capabilities: Capabilities) -> Result<ModuleInfo> {
    Validator::new(ValidationFlags::all(), capabilities)
        .validate(module)
        .map_err(|error| Error::internal("the df64 shader", &error))
}

fn unknown(what: impl std::fmt::Debug) -> Error {
    Error::Internal(format!("df64 has no counterpart of {what:?}"))
}

/// The new module as it grows, and where the parts of the old one went.
struct Rewriting<'a> {
    old: &'a Module,
    info: &'a ModuleInfo,
    new: Module,
    types: HashMap<Handle<Type>, Handle<Type>>,
    constants: HashMap<Handle<naga::Constant>, Handle<naga::Constant>>,
    globals: HashMap<Handle<naga::GlobalVariable>, Handle<naga::GlobalVariable>>,
    functions: HashMap<Handle<naga::Function>, Handle<naga::Function>>,
    library: HashMap<String, Handle<naga::Function>>,
    /// Pairs of literals, by the bits of the f64.
    literals: HashMap<u64, Handle<naga::Constant>>,
}

impl<'a> Rewriting<'a> {
    fn new(old: &'a Module, info: &'a ModuleInfo) -> Self {
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

    fn insert_type(&mut self, name: Option<String>, inner: TypeInner) -> Handle<Type> {
        self.new.types.insert(Type { name, inner }, Span::UNDEFINED)
    }

    /// The type of a real.
    fn pair(&mut self) -> Handle<Type> {
        self.insert_type(None, TypeInner::Vector { size: VectorSize::Bi, scalar: Scalar::F32 })
    }

    /// The type of a vector of reals: a column each.
    fn columns(&mut self, size: VectorSize) -> Handle<Type> {
        let inner = TypeInner::Matrix { columns: size, rows: VectorSize::Bi, scalar: Scalar::F32 };
        self.insert_type(None, inner)
    }

    fn map_type(&mut self, old: Handle<Type>) -> Result<Handle<Type>> {
        if let Some(new) = self.types.get(&old) {
            return Ok(*new);
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
    fn layout(&self, kind: Handle<Type>) -> Result<(u32, u32)> {
        let mut layouter = naga::proc::Layouter::default();
        layouter.update(self.new.to_ctx()).map_err(|error| Error::Internal(error.to_string()))?;
        let layout = layouter[kind];
        Ok((layout.alignment.round_up(1), layout.to_stride()))
    }

    /// WGSL's rules lay the members out anew.
    fn structure(&mut self, members: &[naga::StructMember]) -> Result<TypeInner> {
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
    fn literal(&mut self, value: f64) -> Result<Handle<naga::Constant>> {
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

    fn literal_expression(&mut self, value: f64) -> Result<Handle<Expression>> {
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
    fn constant_value(&self, constant: Handle<naga::Constant>) -> Option<f64> {
        match self.old.global_expressions[self.old.constants[constant].init] {
            Expression::Literal(Literal::F64(value)) => Some(value),
            _ => None,
        }
    }

    fn globals(&mut self) -> Result<()> {
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

    fn global_expression(
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

    /// The library first, because everything else calls it.
    fn functions(&mut self) -> Result<()> {
        let is_library =
            |function: &naga::Function| function.name.as_ref().is_some_and(|name| name.starts_with(PREFIX));
        let (library, others): (Vec<_>, Vec<_>) =
            self.old.functions.iter().partition(|(_, function)| is_library(function));
        for (handle, function) in library.into_iter().chain(others) {
            let info = self.info;
            let new = rewrite_function(self, function, &info[handle])?;
            let name = new.name.clone();
            let new = self.new.functions.append(new, Span::UNDEFINED);
            self.functions.insert(handle, new);
            if let Some(name) = name.filter(|_| is_library(function)) {
                self.library.insert(name, new);
            }
        }
        Ok(())
    }

    fn entry_points(&mut self) -> Result<()> {
        let info = self.info;
        for (i, entry) in self.old.entry_points.iter().enumerate() {
            let mut function = rewrite_function(self, &entry.function, info.get_entry_point(i))?;
            self.copy_zero(&mut function)?;
            self.new.entry_points.push(naga::EntryPoint { function, ..entry.clone() });
        }
        Ok(())
    }

    /// Begins an entry point with what the library's barrier reads.
    fn copy_zero(&self, function: &mut naga::Function) -> Result<()> {
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

    fn library_function(&self, name: &str) -> Result<Handle<naga::Function>> {
        self.library
            .get(&format!("{PREFIX}{name}"))
            .copied()
            .ok_or_else(|| Error::Internal(format!("shaders/math/df64.wgsl has no {PREFIX}{name}")))
    }
}

fn literal_f32(value: f32) -> Expression {
    Expression::Literal(Literal::F32(value))
}
