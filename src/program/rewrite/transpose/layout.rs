//! Which numbers of the scene have adjoints, and in which order these are summed.

use crate::program::layout::bindings;
use crate::program::rewrite::jvp::rewriting::is_input;
use naga::{ArraySize, GlobalVariable, Handle, Module, Scalar, Type, TypeInner};

/// Sums after the sums of the numbers: deposits times the adjoints of their cells, rays with adjoints that are not
/// finite, and loops cut short.
pub const NUM_OTHER_SUMS: usize = 3;

/// True of a variable whose reals have adjoints: numbers of the scene, and what an invocation keeps.
pub(super) fn has_adjoint(module: &Module, variable: &GlobalVariable) -> bool {
    let is_sized = !matches!(
        module.types[variable.ty].inner,
        TypeInner::Array { size: ArraySize::Dynamic | ArraySize::Pending(_), .. }
    );
    is_sized && is_input(variable)
}

/// The numbers that have adjoints: by binding, then in their order in the buffer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Layout {
    /// The binding of a buffer, and how many reals it has.
    pub buffers: Vec<(u32, usize)>,
}

impl Layout {
    /// The layout of a composed module.
    pub fn of(module: &Module, real: Scalar) -> Self {
        let mut buffers: Vec<(u32, usize)> = bound(module)
            .map(|(binding, variable)| {
                let mut chains = Vec::new();
                add_chains(module, variable.1.ty, real, &mut Vec::new(), &mut chains);
                (binding, chains.len())
            })
            .filter(|(_, num)| *num > 0)
            .collect();
        buffers.sort_unstable();
        Layout { buffers }
    }

    /// The number of sums of an invocation.
    pub fn num_sums(&self) -> usize {
        self.num_numbers() + NUM_OTHER_SUMS
    }

    /// The number of numbers that have adjoints.
    pub fn num_numbers(&self) -> usize {
        self.buffers.iter().map(|(_, num)| num).sum()
    }
}

pub(super) fn bound(
    module: &Module,
) -> impl Iterator<Item = (u32, (Handle<GlobalVariable>, &GlobalVariable))> {
    module.global_variables.iter().filter_map(|(handle, variable)| {
        let binding = variable.binding.as_ref().filter(|binding| binding.group == bindings::SCENE)?;
        has_adjoint(module, variable).then_some((binding.binding, (handle, variable)))
    })
}

/// The ways to all reals of a type.
pub(super) fn add_chains(
    module: &Module,
    ty: Handle<Type>,
    real: Scalar,
    at: &mut Vec<u32>,
    found: &mut Vec<Vec<u32>>,
) {
    let mut add = |at: &mut Vec<u32>, index: u32, ty: Handle<Type>| {
        at.push(index);
        add_chains(module, ty, real, at, found);
        at.pop();
    };
    match &module.types[ty].inner {
        TypeInner::Scalar(scalar) if *scalar == real => found.push(at.clone()),
        TypeInner::Vector { size, scalar } if *scalar == real => {
            found.extend((0..*size as u32).map(|index| [&at[..], &[index]].concat()));
        }
        TypeInner::Struct { members, .. } => {
            (0..).zip(members).for_each(|(index, member)| add(at, index, member.ty));
        }
        TypeInner::Array { base, size: ArraySize::Constant(num), .. } => {
            (0..num.get()).for_each(|index| add(at, index, *base));
        }
        _ => {}
    }
}
