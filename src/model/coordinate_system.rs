//! Coordinate systems as scene files give them.

use schemars::JsonSchema;
use serde::Deserialize;

/// A coordinate system: rotated about x, then y, then z (fixed axes), then moved; within `reference_cs` if given.
#[derive(Debug, Clone, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CoordinateSystem {
    /// Origin \[mm\].
    pub x: f64,
    /// Origin \[mm\].
    pub y: f64,
    /// Origin \[mm\].
    pub z: f64,
    /// Rotation about x \[rad\].
    pub rx: f64,
    /// Rotation about y \[rad\].
    pub ry: f64,
    /// Rotation about z \[rad\].
    pub rz: f64,
    /// The system that this one stands in; the global one if null.
    pub reference_cs: Option<Box<CoordinateSystem>>,
}
