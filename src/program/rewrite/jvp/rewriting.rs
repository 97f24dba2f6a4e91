//! The state of rewriting a module, which all its functions share.

use crate::error::{Error, Result};
use crate::program::rewrite::function_builder::called;
use crate::program::rewrite::rules::rule;
use naga::valid::ModuleInfo;
use naga::{
    AddressSpace, Block, Function, GlobalVariable, Handle, Module, ResourceBinding, Scalar, Span,
    StorageAccess, Type, TypeInner,
};
use std::collections::HashMap;

/// The distance from a buffer's binding to its first twin's, and from each twin's to the next. Each parameter has a
/// twin.
pub const BINDING_STRIDE: u32 = 200;

/// Uniform buffers that every adapter of WebGPU binds.
const MOST_UNIFORMS: usize = 12;

/// A function of the new module.
#[derive(Debug, Clone, Copy)]
pub(in crate::program) struct NewFunction {
    /// As it was.
    pub(in crate::program) plain: Handle<Function>,
    /// The twin with tangents. `None` if no tangent can go in, come out, or be noted within.
    pub(in crate::program) with_tangents: Option<Handle<Function>>,
}

/// True of a variable that shaders do not write for the host, nor share between invocations.
pub(in crate::program) fn is_input(variable: &GlobalVariable) -> bool {
    match variable.space {
        AddressSpace::Private | AddressSpace::Uniform => true,
        AddressSpace::Storage { access } => !access.contains(StorageAccess::STORE),
        _ => false,
    }
}

/// The new module as it grows. Types, constants and variables keep their handles.
pub(in crate::program) struct Rewriting<'a> {
    pub(in crate::program) old: &'a Module,
    pub(in crate::program) info: &'a ModuleInfo,
    pub(in crate::program) new: Module,
    pub(in crate::program) real: Scalar,
    /// Tangents beside each real.
    pub(in crate::program) num: usize,
    pub(in crate::program) globals: HashMap<Handle<GlobalVariable>, Vec<Handle<GlobalVariable>>>,
    pub(in crate::program) functions: HashMap<Handle<Function>, NewFunction>,
    /// Results with their tangents, by the type of the result.
    duals: HashMap<Handle<Type>, Handle<Type>>,
}

impl<'a> Rewriting<'a> {
    pub(in crate::program) fn new(old: &'a Module, info: &'a ModuleInfo, real: Scalar, num: usize) -> Self {
        let mut new = old.clone();
        new.functions = Default::default();
        new.entry_points = Vec::new();
        let (globals, functions, duals) = (HashMap::new(), HashMap::new(), HashMap::new());
        Rewriting { old, info, new, real, num, globals, functions, duals }
    }

    /// True if a value of the type holds a real, or points to one.
    pub(in crate::program) fn has_reals(&self, ty: Handle<Type>) -> bool {
        self.inner_has_reals(&self.new.types[ty].inner)
    }

    pub(in crate::program) fn inner_has_reals(&self, inner: &TypeInner) -> bool {
        match inner {
            TypeInner::Scalar(scalar)
            | TypeInner::Vector { scalar, .. }
            | TypeInner::Matrix { scalar, .. }
            | TypeInner::ValuePointer { scalar, .. } => *scalar == self.real,
            TypeInner::Pointer { base, .. } | TypeInner::Array { base, .. } => self.has_reals(*base),
            TypeInner::Struct { members, .. } => members.iter().any(|member| self.has_reals(member.ty)),
            _ => false,
        }
    }

    /// Gives a twin for each parameter to every variable that holds reals, and that shaders do not write for the host.
    ///
    /// Twins of uniforms are uniforms where an adapter surely binds so many. Lavapipe reads these faster than other buffers.
    pub(in crate::program) fn globals(&mut self) {
        let uniforms = || self.old.global_variables.iter().filter(|(_, v)| v.space == AddressSpace::Uniform);
        let num_twins = self.num * uniforms().filter(|(_, variable)| self.has_reals(variable.ty)).count();
        let are_uniforms = uniforms().count() + num_twins <= MOST_UNIFORMS;
        for (handle, variable) in self.old.global_variables.iter() {
            if !is_input(variable) || !self.has_reals(variable.ty) {
                continue;
            }
            let twins = (1..=self.num as u32).map(|number| {
                let binding = variable.binding.map(|binding| ResourceBinding {
                    binding: binding.binding + number * BINDING_STRIDE,
                    ..binding
                });
                let name = variable.name.as_ref().map(|name| format!("{name}_tangent_{number}"));
                let space = match variable.space {
                    AddressSpace::Uniform if !are_uniforms => {
                        AddressSpace::Storage { access: StorageAccess::LOAD }
                    }
                    space => space,
                };
                let twin = GlobalVariable { name, binding, space, init: None, ..variable.clone() };
                self.new.global_variables.append(twin, Span::UNDEFINED)
            });
            self.globals.insert(handle, twins.collect());
        }
    }

    /// A result with its tangents: a struct of the value, then one member for each parameter.
    pub(in crate::program) fn dual(&mut self, ty: Handle<Type>) -> Result<Handle<Type>> {
        if let Some(dual) = self.duals.get(&ty) {
            return Ok(*dual);
        }
        let mut layouter = naga::proc::Layouter::default();
        layouter.update(self.new.to_ctx()).map_err(|error| Error::Internal(error.to_string()))?;
        let layout = layouter[ty];
        let stride = layout.to_stride();
        let members = (0..=self.num as u32).map(|number| naga::StructMember {
            name: Some(if number == 0 { "value".into() } else { format!("tangent_{number}") }),
            ty,
            binding: None,
            offset: number * stride,
        });
        let inner = TypeInner::Struct { members: members.collect(), span: (self.num as u32 + 1) * stride };
        let name = Some(format!("Dual_{}", ty.index()));
        let dual = self.new.types.insert(Type { name, inner }, Span::UNDEFINED);
        self.duals.insert(ty, dual);
        Ok(dual)
    }

    /// The function of this name, as it was.
    pub(in crate::program) fn plain(&self, name: &str) -> Result<Handle<Function>> {
        let mut functions = self.new.functions.iter();
        let found = functions.find(|(_, function)| function.name.as_deref() == Some(name));
        let (handle, _) =
            found.ok_or_else(|| Error::Internal(format!("no {name} in the shader of derivatives")))?;
        Ok(handle)
    }

    /// True if tangents can go into a function, come out of it, or be noted in it.
    pub(in crate::program) fn has_tangents(&self, function: &Function) -> bool {
        let in_types =
            function.arguments.iter().map(|argument| argument.ty).chain(function.result.iter().map(|r| r.ty));
        in_types.into_iter().any(|ty| self.has_reals(ty))
            || function.local_variables.iter().any(|(_, local)| self.has_reals(local.ty))
            || function.expressions.iter().any(|(_, expression)| match expression {
                naga::Expression::GlobalVariable(variable) => self.globals.contains_key(variable),
                _ => false,
            })
            || self.calls_with_tangents(&function.body)
    }

    fn calls_with_tangents(&self, block: &Block) -> bool {
        called(block).into_iter().any(|function| {
            let name = self.old.functions[function].name.as_deref().unwrap_or_default();
            rule(name).is_some() || self.functions[&function].with_tangents.is_some()
        })
    }
}
