//! What many entries of scene files have: frames, materials and spectra, as the user wrote them.

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::Deserialize;
use std::borrow::Cow;

/// A coordinate system: rotated about x, then y, then z (fixed axes), then moved; within `reference_cs` if given.
#[derive(Debug, Clone, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CoordinateSystem {
    /// Its name, if its numbers are to have one: `barrel.y`. Copies of a frame have one name, and move together.
    pub name: Option<String>,
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

/// A material where one is used.
#[derive(Debug, Clone, Default, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Material {
    /// null.
    #[default]
    #[serde(rename = "$null")]
    Vacuum,
    /// A catalog name as plain text.
    #[serde(rename = "$string")]
    Name(String),
    /// `{"type": "catalog", "name": ...}`.
    Catalog {
        /// Name in the catalog.
        name: String,
    },
    /// `{"type": "medium", "name": ...}`, a key of `nsq_gpu.media`.
    Medium {
        /// Key in `nsq_gpu.media`.
        name: String,
    },
}

impl Material {
    /// What the user calls it.
    pub fn name(&self) -> &str {
        match self {
            Material::Vacuum => "vacuum",
            Material::Name(name) | Material::Catalog { name } | Material::Medium { name } => name,
        }
    }
}

impl JsonSchema for Material {
    fn schema_name() -> Cow<'static, str> {
        "Material".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "description": "null for vacuum, a catalog name, or a reference to nsq_gpu.media",
            "oneOf": [
                { "type": "null" },
                { "type": "string" },
                {
                    "type": "object",
                    "properties": {
                        "type": { "enum": ["catalog", "medium"] },
                        "name": { "type": "string" },
                    },
                    "required": ["type", "name"],
                    "additionalProperties": false,
                },
            ],
        })
    }
}

/// A discrete spectrum.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Spectrum {
    /// Wavelengths \[um\].
    pub wavelengths: Vec<f64>,
    /// Weight of each wavelength.
    pub weights: Vec<f64>,
}
