//! Figures by which maps are judged: uniformity, widths and angles, the flux of regions, each with its error.
//!
//! ```text
//! field      the values of a map over a plane, for every kind of detector
//! region     a part of that plane, and what the viewer says of it
//! crossings  where a profile falls below a part of its peak
//! noise      what noise as large as the map's own does to a figure
//! judged     the figures of a detector (found), and as lines of text
//! ```

mod crossings;
pub mod field;
pub mod found;
pub mod judged;
mod noise;
pub mod region;
mod text;

pub use crate::result::figures::found::{Figure, Figures, Named, RegionFigures};
pub use crate::result::figures::judged::{Asked, judge, judge_all};
pub use crate::result::figures::text::text;
