//! What `.png` files and the window of the viewer share: scales, colours, pixels and ticks.
//!
//! ```text
//! scale     values -> positions along the colours -> colours
//! raster    cells -> pixels, by means; discs and circles
//! pyramid   a large map at coarser resolutions
//! polar     directions -> pixels of a disc
//! ticks     round numbers along an axis
//! srgb      X, Y and Z -> colours of a screen
//! true_color  maps of X, Y and Z -> pixels
//! ```

pub mod polar;
pub mod pyramid;
pub mod raster;
pub mod scale;
pub mod srgb;
pub mod ticks;
pub mod true_color;

/// Red, green and blue.
pub type Rgb = [u8; 3];
