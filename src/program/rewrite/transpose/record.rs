//! What the way forward records for the way back.

use naga::{Expression, Function, Handle, Statement, Type};
use std::collections::HashMap;

/// A statement of the old function, by its address.
pub(super) fn key_of(statement: &Statement) -> usize {
    std::ptr::from_ref(statement) as usize
}

/// What the way back needs of the way forward.
#[derive(Default)]
pub(super) struct Record {
    /// Types of its members.
    pub(super) types: Vec<Handle<Type>>,
    /// Members that hold values.
    pub(super) values: HashMap<Handle<Expression>, u32>,
    /// Calls whose functions have a way back, by their statements: the half that goes forward, and the member that holds its
    /// record.
    pub(super) calls: HashMap<usize, (Handle<Function>, Option<u32>)>,
}
