//! Functions whose derivative does not follow from their text.

use naga::{Expression, Handle};

/// The rule of a function.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::program) enum Rule {
    /// The result has no tangent, and the function is called as it is.
    Constant,
    /// The result has the tangent of the second argument.
    Attached,
    /// The tangent of the second argument goes to the sum of the first.
    Note,
    /// The tangent is the result times the argument's tangent.
    Exponential,
    /// The tangent is the argument's tangent over the argument.
    Logarithm,
    /// The tangent comes from another function of the argument; with a sign.
    Turned(&'static str, f64),
    /// The result has no derivative. On a way back, another function gives the result again.
    Recalled(&'static str),
}

impl Rule {
    /// The argument of a call whose change is the result's. `None` if the result has no derivative.
    pub(in crate::program) fn differentiated(
        self,
        arguments: &[Handle<Expression>],
    ) -> Option<Handle<Expression>> {
        match self {
            Rule::Constant | Rule::Note | Rule::Recalled(_) => None,
            Rule::Attached => arguments.get(1).copied(),
            Rule::Exponential | Rule::Logarithm | Rule::Turned(..) => arguments.first().copied(),
        }
    }

    /// The argument of a call whose change counts: for the result, or for a sum.
    pub(in crate::program) fn sees(self, arguments: &[Handle<Expression>]) -> Option<Handle<Expression>> {
        match self {
            Rule::Note => arguments.get(1).copied(),
            other => other.differentiated(arguments),
        }
    }
}

/// The function that adds a tangent to a sum: (cell, tangent, number of the parameter).
pub(in crate::program) const DEPOSIT: &str = "deposit_tangent";

/// The rule of a function, if it has one. Rules go by the name alone: a function of one of these names has no derivative of
/// its own, wherever it stands. Decisions and searches are constant, and so are integer sums and what the host records.
pub(in crate::program) fn rule(name: &str) -> Option<Rule> {
    Some(match name {
        "detached"
        | "nearest_primitive"
        | "quantize"
        | "quantize_counted"
        | "deposit"
        | "plain_deposit_weight"
        | "plain_deposit_tap"
        | "plain_deposit_taps"
        | "is_number"
        | "is_depositable"
        | "below"
        | "append_event"
        | "has_position"
        | "deposit_tangent"
        | "record_hit"
        | "record_birth"
        | "record_death" => Rule::Constant,
        "search" => Rule::Recalled("recalled_hit"),
        "attached" => Rule::Attached,
        "note" => Rule::Note,
        "exp_real" | "exp_near_zero" => Rule::Exponential,
        "log_real" => Rule::Logarithm,
        "sin_real" => Rule::Turned("cos_real", 1.0),
        "cos_real" => Rule::Turned("sin_real", -1.0),
        _ => return None,
    })
}
