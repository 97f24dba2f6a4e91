//! What `.png` files and the window of the viewer share: scales, colours, pixels and ticks.
//!
//! ```text
//! scale     values -> positions along the colours -> colours
//! raster    cells -> pixels, by means; discs and circles
//! pyramid   a large map at coarser resolutions
//! polar     directions -> pixels of a disc
//! ticks     round numbers along an axis
//! ```

pub mod polar;
pub mod pyramid;
pub mod raster;
pub mod scale;
pub mod ticks;

/// Red, green and blue.
pub type Rgb = [u8; 3];
