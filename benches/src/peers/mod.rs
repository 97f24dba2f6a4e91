//! Other programs that trace the same cases, as child processes.
//!
//! ```text
//! peer      what a program must do to be compared
//! child     a Python process that answers requests, line by line
//! optiland  Optiland's NumPy backend: every case
//! mitsuba   Mitsuba 3 with Embree: one search a ray
//! drjit     a kernel written by hand for one scene
//! ```

mod child;
pub mod drjit;
pub mod mitsuba;
pub mod optiland;
mod peer;

pub use crate::peers::drjit::DrJit;
pub use crate::peers::mitsuba::Mitsuba;
pub use crate::peers::optiland::Optiland;
pub use crate::peers::peer::{Peer, PeerRun};
