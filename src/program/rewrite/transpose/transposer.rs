//! The state of transposing a module, which all its functions share.

use crate::error::{Error, Result};
use crate::program::rewrite::jvp::rewriting::Rewriting;
use crate::program::rewrite::transpose::layout::has_adjoint;
use crate::program::rewrite::transpose::names::OF_PASS;
use naga::valid::ModuleInfo;
use naga::{
    AddressSpace, Expression, Function, GlobalVariable, Handle, Module, Scalar, Span, StructMember, Type,
    TypeInner,
};
use std::collections::{HashMap, HashSet};

/// What is known of a function, given which of its arguments vary.
#[derive(Debug, Clone, Default)]
pub(super) struct Activity {
    /// Its values, and pointers to variables, that vary.
    pub(super) varied: HashSet<Handle<Expression>>,
    /// The result varies.
    pub(super) varies: bool,
    /// Adjoints can come from within it, or go through its pointers, whatever becomes of its result.
    pub(super) has_effects: bool,
}

/// True of a pointer.
pub(super) fn is_pointer(inner: &TypeInner) -> bool {
    matches!(inner, TypeInner::Pointer { .. } | TypeInner::ValuePointer { .. })
}

/// A function of the old module in two halves: one that goes forward and records what the way back needs, and one that goes
/// back.
#[derive(Debug, Clone)]
pub(super) struct Transposed {
    /// As the function was; a last argument points to the record, if there is one.
    pub(super) forward: Handle<Function>,
    /// The way back gives the adjoints of the arguments. For each argument that points to reals, the function takes a
    /// pointer to adjoints. Then come the adjoint of the result (if the result varies), and the record (if there is
    /// one).
    pub(super) back: Handle<Function>,
    /// The type of the record.
    pub(super) record: Option<Handle<Type>>,
    /// The type of the adjoints of arguments that are values: a struct.
    pub(super) adjoints: Option<Handle<Type>>,
    /// Where an argument's adjoint lies in that struct.
    pub(super) members: Vec<Option<u32>>,
    /// The result varies.
    pub(super) varies: bool,
}

/// The new module as it grows.
pub(super) struct Transposer<'a> {
    /// The old module.
    pub(super) module: &'a Module,
    info: &'a ModuleInfo,
    /// The new module. Functions without adjoints are the old module's.
    pub(super) rewriting: Rewriting<'a>,
    /// The variables that hold the adjoints of another's reals.
    pub(super) twins: HashMap<Handle<GlobalVariable>, Handle<GlobalVariable>>,
    pub(super) activities: HashMap<(Handle<Function>, Vec<bool>), Activity>,
    pub(super) transposed: HashMap<(Handle<Function>, Vec<bool>), Transposed>,
    num_structs: usize,
}

impl<'a> Transposer<'a> {
    pub(super) fn new(module: &'a Module, info: &'a ModuleInfo, real: Scalar) -> Self {
        let rewriting = Rewriting::new(module, info, real, 1);
        Transposer {
            module,
            info,
            rewriting,
            twins: HashMap::new(),
            activities: HashMap::new(),
            transposed: HashMap::new(),
            num_structs: 0,
        }
    }

    /// Gives each variable with reals of the scene, or of the invocation, a private twin for their adjoints. Tables of unknown
    /// length have none.
    pub(super) fn add_twins(&mut self) {
        for (handle, variable) in self.module.global_variables.iter() {
            let is_of_pass = variable.name.as_deref().is_some_and(|name| OF_PASS.contains(&name));
            if has_adjoint(self.module, variable) && !is_of_pass && self.rewriting.has_reals(variable.ty) {
                let name = variable.name.as_ref().map(|name| format!("{name}_adjoint"));
                let space = AddressSpace::Private;
                let twin = GlobalVariable { name, space, binding: None, init: None, ..variable.clone() };
                let twin = self.rewriting.new.global_variables.append(twin, Span::UNDEFINED);
                self.twins.insert(handle, twin);
            }
        }
    }

    /// The name of an old function.
    pub(super) fn name(&self, function: Handle<Function>) -> &'a str {
        self.module.functions[function].name.as_deref().unwrap_or_default()
    }

    /// The old function of a name.
    pub(super) fn function(&self, name: &str) -> Result<Handle<Function>> {
        let mut all = self.module.functions.iter();
        let found = all.find(|(_, function)| function.name.as_deref() == Some(name));
        found
            .map(|(handle, _)| handle)
            .ok_or_else(|| Error::Internal(format!("no {name} in the shader of adjoints")))
    }

    /// The variable of a name.
    pub(super) fn global(&self, name: &str) -> Result<Handle<GlobalVariable>> {
        let mut all = self.module.global_variables.iter();
        let found = all.find(|(_, variable)| variable.name.as_deref() == Some(name));
        found
            .map(|(handle, _)| handle)
            .ok_or_else(|| Error::Internal(format!("no variable {name} in the shader of adjoints")))
    }

    /// What naga knows of the old module.
    pub(super) fn info(&self) -> &'a ModuleInfo {
        self.info
    }

    /// The new function that is as an old one was.
    pub(super) fn plain(&self, function: Handle<Function>) -> Handle<Function> {
        self.rewriting.functions[&function].plain
    }

    /// The type of an old value.
    pub(super) fn inner(&self, function: Handle<Function>, value: Handle<Expression>) -> &'a TypeInner {
        self.info[function][value].ty.inner_with(&self.module.types)
    }

    /// The type of an old value, with a handle in the new module.
    pub(super) fn type_of(&mut self, function: Handle<Function>, value: Handle<Expression>) -> Handle<Type> {
        match &self.info[function][value].ty {
            naga::proc::TypeResolution::Handle(handle) => *handle,
            naga::proc::TypeResolution::Value(inner) => self.type_with(inner.clone()),
        }
    }

    /// A nameless type of the new module.
    pub(super) fn type_with(&mut self, inner: TypeInner) -> Handle<Type> {
        self.rewriting.new.types.insert(Type { name: None, inner }, Span::UNDEFINED)
    }

    pub(super) fn has_reals(&self, inner: &TypeInner) -> bool {
        self.rewriting.inner_has_reals(inner)
    }

    /// A new struct of these types.
    pub(super) fn structure(&mut self, what: &str, types: &[Handle<Type>]) -> Result<Handle<Type>> {
        let mut layouter = naga::proc::Layouter::default();
        let new = &mut self.rewriting.new;
        layouter.update(new.to_ctx()).map_err(|error| Error::Internal(error.to_string()))?;
        let (mut members, mut end, mut alignment) = (Vec::new(), 0, naga::proc::Alignment::ONE);
        for (number, ty) in types.iter().enumerate() {
            let layout = layouter[*ty];
            let offset = layout.alignment.round_up(end);
            let name = Some(format!("member_{number}"));
            members.push(StructMember { name, ty: *ty, binding: None, offset });
            end = offset + layout.size;
            alignment = alignment.max(layout.alignment);
        }
        self.num_structs += 1;
        let name = Some(format!("{what}_{}", self.num_structs));
        let inner = TypeInner::Struct { members, span: alignment.round_up(end).max(1) };
        Ok(new.types.insert(Type { name, inner }, Span::UNDEFINED))
    }
}
