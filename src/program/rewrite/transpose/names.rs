//! Names that shaders and this module share (shaders/derivatives/adjoints.wgsl).

use crate::error::Error;

/// The function that gives the adjoint of a cell.
pub(super) const ADJOINT_OF: &str = "adjoint_of";

/// The variable that sums what the loss gains by forward derivatives.
pub(super) const FORWARD_NOTED: &str = "forward_noted";

/// The variable that says that a driver cut loops short: 0 or 1.
pub(super) const CUT_LOOPS: &str = "cut_loops";

/// The variable that counts rays that are not added.
pub(super) const LOST: &str = "lost";

/// Ends the name of a function that goes a way and back.
pub(super) const BACK: &str = "_back";

/// Private variables that belong to the pass, and have no adjoints. Any other private variable with reals has a twin for its
/// adjoint. Each event must write such a variable before it reads it: an event is walked back alone.
pub(super) const OF_PASS: [&str; 5] = ["last_hit", "noted", LOST, CUT_LOOPS, FORWARD_NOTED];

/// The error of a function that does something for which there is no way back. `Transposer::transposed` catches the error,
/// and writes the function's way back from its tangents. Where tangents cannot serve either, the user reads the error.
pub(super) fn no_way_back(name: &str) -> Error {
    Error::NoWayBack(name.to_owned())
}

/// The function that adds adjoints to the sums.
pub(super) const ADD_UP: &str = "add_up_adjoints";
/// The function that writes the sums of an invocation.
pub(super) const WRITE: &str = "write_adjoints";
