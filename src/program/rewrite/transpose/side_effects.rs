//! A module that adds nothing to sums: the reverse pass traces light again, and only its adjoints are wanted.

use crate::program::rewrite::function_builder::inner_blocks_mut;
use naga::{AddressSpace, Block, Expression, Function, GlobalVariable, Handle, Module, Statement};
use std::collections::HashSet;

/// The module without atomics, and without writes to what invocations share. What an atomic would have given is zero, so
/// that no loop may wait for an atomic.
pub(super) fn strip_side_effects(module: &Module) -> Module {
    let mut stripped = module.clone();
    let is_shared = |space: AddressSpace| !matches!(space, AddressSpace::Private | AddressSpace::Function);
    let variables = module.global_variables.iter();
    let shared: HashSet<Handle<GlobalVariable>> =
        variables.filter(|(_, v)| is_shared(v.space)).map(|(handle, _)| handle).collect();
    for (_, function) in stripped.functions.iter_mut() {
        silence(function, &shared);
    }
    stripped
}

fn silence(function: &mut Function, shared: &HashSet<Handle<GlobalVariable>>) {
    let writes: HashSet<Handle<Expression>> = function
        .expressions
        .iter()
        .map(|(handle, _)| handle)
        .filter(|handle| root_of(function, *handle).is_some_and(|variable| shared.contains(&variable)))
        .collect();
    for (_, expression) in function.expressions.iter_mut() {
        if let Expression::AtomicResult { ty, .. } = expression {
            *expression = Expression::ZeroValue(*ty);
        }
    }
    function.body = without_writes(std::mem::take(&mut function.body), &writes);
}

/// The variable that a pointer leads into.
fn root_of(function: &Function, pointer: Handle<Expression>) -> Option<Handle<GlobalVariable>> {
    match function.expressions[pointer] {
        Expression::GlobalVariable(variable) => Some(variable),
        Expression::Access { base, .. } | Expression::AccessIndex { base, .. } => root_of(function, base),
        _ => None,
    }
}

fn without_writes(block: Block, writes: &HashSet<Handle<Expression>>) -> Block {
    let mut out = Block::new();
    for (mut statement, span) in block.span_into_iter() {
        match &mut statement {
            Statement::Atomic { .. } => continue,
            Statement::Store { pointer, .. } if writes.contains(pointer) => continue,
            other => inner_blocks_mut(other)
                .for_each(|block| *block = without_writes(std::mem::take(block), writes)),
        }
        out.push(statement, span);
    }
    out
}
