//! Other programs that trace the same cases, as child processes.
//!
//! ```text
//! peer      what a program must do to be compared
//! child     a Python process that answers requests, line by line
//! optiland  Optiland's NumPy and Torch backends: every case, and maps
//! mitsuba   Mitsuba 3 with Embree: one search a ray
//! drjit     a kernel written by hand for one scene
//! ```

mod child;
pub mod drjit;
pub mod mitsuba;
pub mod optiland;
mod peer;

pub use crate::bench::peers::drjit::DrJit;
pub use crate::bench::peers::mitsuba::Mitsuba;
pub use crate::bench::peers::optiland::Optiland;
pub use crate::bench::peers::peer::{Peer, PeerRun};
