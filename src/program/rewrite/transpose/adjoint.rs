//! The adjoint of one value, as far as it is known: of the whole, or of some of its parts.

use naga::{Expression, Handle};
use std::collections::BTreeMap;

/// An adjoint. What has neither a whole nor a part is zero.
#[derive(Debug, Clone, Default)]
pub(super) struct Adjoint {
    /// Of the whole value, in its type.
    pub(super) whole: Option<Handle<Expression>>,
    /// Of members of a struct, components of a vector, or elements of an array; added to the whole.
    pub(super) parts: BTreeMap<u32, Adjoint>,
}

impl Adjoint {
    /// The adjoint of a whole value.
    pub(super) fn whole(value: Handle<Expression>) -> Self {
        Adjoint { whole: Some(value), parts: BTreeMap::new() }
    }

    /// The adjoint of a value of which only one part has an adjoint.
    pub(super) fn part(index: u32, part: Adjoint) -> Self {
        Adjoint { whole: None, parts: BTreeMap::from([(index, part)]) }
    }

    /// True if nothing is known to be other than zero.
    pub(super) fn is_zero(&self) -> bool {
        self.whole.is_none() && self.parts.values().all(Adjoint::is_zero)
    }
}
