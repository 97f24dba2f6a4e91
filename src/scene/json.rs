//! The scene file as the user wrote it: Optiland's schema version 1 and the `nsq_gpu` block beside it.
//!
//! Field names, defaults and units are Optiland's: lengths in mm, wavelengths in um, flux in W, rotations in rad,
//! `half_angle_deg` in degrees. A radius of 0 or infinity means flat.

use std::borrow::Cow;
use std::collections::BTreeMap;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::Deserialize;

/// A scene file.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SceneFile {
    /// Where editors find the JSON Schema of the file; without effect.
    #[serde(default, rename = "$schema")]
    pub schema: Option<String>,
    /// Version of Optiland's schema: 1.
    #[schemars(range(min = 1, max = 1))]
    pub nsq_schema_version: u32,
    /// Lenses, mirrors and doublets.
    #[serde(default)]
    pub components: Vec<Component>,
    /// Sources of rays.
    #[serde(default)]
    pub sources: Vec<Source>,
    /// Detectors.
    #[serde(default)]
    pub detectors: Vec<Detector>,
    /// What schema version 1 cannot hold.
    #[serde(default)]
    pub nsq_gpu: Option<Block>,
}

pub use crate::model::sources::Written as Source;
pub use crate::model::written::{CoordinateSystem, Material, Spectrum};
pub use crate::scene::scatter_policy::{ScatterProb, ScatterTo};

/// A compound component, by its `type`.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(tag = "type")]
pub enum Component {
    /// A lens of two conic faces and an absorbing edge.
    Lens(Compound<Lens>),
    /// One reflecting conic.
    Mirror(Compound<Mirror>),
    /// Two cemented lenses.
    Doublet(Compound<Doublet>),
}

/// The frame of every compound component.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Compound<T> {
    /// Unique name.
    pub name: String,
    /// Frame of the front vertex.
    pub cs: CoordinateSystem,
    /// Shape and materials.
    pub config: T,
}

/// Configuration of a lens.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Lens {
    /// Radius of the front face \[mm\].
    pub r1: f64,
    /// Radius of the back face \[mm\].
    pub r2: f64,
    /// Centre thickness \[mm\].
    pub thickness: f64,
    /// The glass.
    pub material: Material,
    /// Semi-diameter of the front face \[mm\].
    pub front_aperture_radius: f64,
    /// Semi-diameter of the back face \[mm\]; the front face's if null.
    #[serde(default)]
    pub back_aperture_radius: Option<f64>,
    /// Conic constant of the front face.
    #[serde(default)]
    pub conic1: f64,
    /// Conic constant of the back face.
    #[serde(default)]
    pub conic2: f64,
}

/// Configuration of a mirror.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Mirror {
    /// Radius \[mm\].
    pub radius: f64,
    /// Reflectance in \[0, 1\].
    pub reflectance: f64,
    /// Conic constant.
    #[serde(default)]
    pub conic: f64,
    /// Semi-diameter \[mm\].
    pub aperture_radius: f64,
}

/// Configuration of a doublet.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Doublet {
    /// Radius of the front face \[mm\].
    pub r1: f64,
    /// Radius of the cemented face \[mm\].
    pub r2: f64,
    /// Radius of the back face \[mm\].
    pub r3: f64,
    /// Centre thickness of the first element \[mm\].
    pub thickness1: f64,
    /// Centre thickness of the second element \[mm\].
    pub thickness2: f64,
    /// Glass of the first element.
    pub material1: Material,
    /// Glass of the second element.
    pub material2: Material,
    /// Semi-diameter of every face \[mm\].
    pub aperture_radius: f64,
    /// Conic constant of the front face.
    #[serde(default)]
    pub conic1: f64,
    /// Conic constant of the cemented face.
    #[serde(default)]
    pub conic2: f64,
    /// Conic constant of the back face.
    #[serde(default)]
    pub conic3: f64,
}

pub use crate::model::detectors::{DetectorExtra, Written as Detector};

/// What schema version 1 cannot hold.
#[derive(Debug, Clone, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Block {
    /// Where editors find the JSON Schema of the block; without effect.
    #[serde(default, rename = "$schema")]
    pub schema: Option<String>,
    /// Version of this block: 1.
    #[schemars(range(min = 1, max = 1))]
    pub version: u32,
    /// Media by name.
    #[serde(default)]
    pub media: BTreeMap<String, Medium>,
    /// Single surfaces.
    #[serde(default)]
    pub surfaces: Vec<RawSurface>,
    /// Changes to surfaces of components, by the surface's name such as `L1.front`.
    #[serde(default)]
    pub overrides: BTreeMap<String, Override>,
    /// Names of all components and single surfaces in the order in which they are tried (of two hit at the same
    /// distance, the first wins); components first if null.
    #[serde(default)]
    pub order: Option<Vec<String>>,
    /// What moves as one, in the order in which light meets it.
    #[serde(default)]
    pub elements: Vec<Element>,
    /// Additions to detectors, by name.
    #[serde(default)]
    pub detectors: BTreeMap<String, DetectorExtra>,
    /// How rare branches are sampled.
    #[serde(default)]
    pub sampling: SamplingPolicy,
}

/// What moves as one, such as a lens of single surfaces: `L4.y` decentres it, `L4.rx` tilts it.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Element {
    /// Unique name among elements.
    pub name: String,
    /// Components and single surfaces, in the order in which light meets them. The frame of the first is the element's.
    pub faces: Vec<String>,
    /// What moves along, such as an edge and a mount.
    #[serde(default)]
    pub parts: Vec<String>,
    /// What stands behind the element and before the next one, such as a stop or a detector; `gap_1` is the space behind
    /// the first element that has this list. Null: no gap.
    #[serde(default)]
    pub behind: Option<Vec<String>>,
    /// Where the element turns about, in the frame of the first face \[mm\]; its vertex if null.
    #[serde(default)]
    pub pivot: Option<[f64; 3]>,
}

/// A medium, by its `type`.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
#[schemars(tag = "type")]
pub enum Medium {
    /// The same at every wavelength.
    Constant {
        /// Refractive index.
        n: f64,
        /// Extinction coefficient.
        #[serde(default)]
        k: f64,
    },
    /// Values at some wavelengths, linear between them; a source must not emit beyond them.
    Table {
        /// Wavelengths \[um\].
        wavelengths: Vec<f64>,
        /// Refractive index at each.
        n: Vec<f64>,
        /// Extinction coefficient at each; 0 if null.
        #[serde(default)]
        k: Option<Vec<f64>>,
    },
    /// A material of the catalog.
    Catalog {
        /// Name in the catalog.
        name: String,
    },
}

/// A single surface.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawSurface {
    /// Unique name among components and surfaces.
    pub name: String,
    /// Frame of the vertex, or of the centre of a sphere.
    pub cs: CoordinateSystem,
    /// Its shape.
    pub shape: Shape,
    /// What it does to a ray.
    pub interaction: Interaction,
    /// Medium on the side that the geometric normal points away from.
    #[serde(default)]
    pub material_front: Material,
    /// Medium on the side that the geometric normal points to; refractive surfaces only.
    #[serde(default)]
    pub material_back: Material,
    /// Reflectance of a reflective surface.
    #[serde(default)]
    pub reflectance: Option<Reflectance>,
    /// Scatter model.
    #[serde(default)]
    pub bsdf: Option<Bsdf>,
    /// Fraction of the rays that the scatter model takes.
    #[serde(default)]
    pub scatter_fraction: ScatterFraction,
    /// Coating; of a reflective surface its reflectance counts.
    #[serde(default)]
    pub coating: Option<Coating>,
}

pub use crate::model::shapes::Written as Shape;

/// What a surface does to a ray.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Interaction {
    /// Refraction and Fresnel reflection.
    Refractive,
    /// Reflection.
    Reflective,
    /// Absorption.
    Absorbing,
}

/// A value in \[0, 1\], constant or at exactly the wavelengths that the sources emit.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Reflectance {
    /// The same at every wavelength.
    #[serde(rename = "$number")]
    Constant(f64),
    /// A table.
    #[serde(rename = "$object")]
    Table {
        /// Wavelengths \[um\].
        wavelengths: Vec<f64>,
        /// Value at each.
        values: Vec<f64>,
    },
}

impl JsonSchema for Reflectance {
    fn schema_name() -> Cow<'static, str> {
        "Reflectance".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "description": "a value in [0, 1], or a table over exactly the wavelengths [um] that the sources emit",
            "oneOf": [
                { "type": "number", "minimum": 0, "maximum": 1 },
                {
                    "type": "object",
                    "properties": {
                        "wavelengths": { "type": "array", "items": { "type": "number" } },
                        "values": { "type": "array", "items": { "type": "number", "minimum": 0, "maximum": 1 } },
                    },
                    "required": ["wavelengths", "values"],
                    "additionalProperties": false,
                },
            ],
        })
    }
}

/// Changes to one surface of a component.
#[derive(Debug, Clone, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Override {
    /// What it does to a ray, instead of the component's choice.
    pub interaction: Option<Interaction>,
    /// Semi-diameter \[mm\] of a conic, instead of the component's.
    pub aperture_radius: Option<f64>,
    /// Reflectance, where the surface is reflective.
    pub reflectance: Option<Reflectance>,
    /// Scatter model.
    pub bsdf: Option<Bsdf>,
    /// Fraction of the rays that the scatter model takes; 1 if null.
    pub scatter_fraction: Option<ScatterFraction>,
    /// Coating; of a reflective surface its reflectance counts.
    pub coating: Option<Coating>,
}

pub use crate::model::bsdfs::Written as Bsdf;

/// Fraction of the rays that a scatter model takes.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ScatterFraction {
    /// The scatter model's own total integrated scatter, so that the surface has the BSDF that is written.
    Tis,
    /// A number.
    #[serde(rename = "$number")]
    Constant(f64),
}

impl Default for ScatterFraction {
    fn default() -> Self {
        ScatterFraction::Constant(1.0)
    }
}

impl JsonSchema for ScatterFraction {
    fn schema_name() -> Cow<'static, str> {
        "ScatterFraction".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "description": "a fraction of the rays, or `tis`: the scatter model's own total integrated scatter",
            "oneOf": [{ "const": "tis" }, { "type": "number", "minimum": 0, "maximum": 1 }],
        })
    }
}

/// A coating, by its `type`.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
#[schemars(tag = "type")]
pub enum Coating {
    /// Reflectance and transmittance at any angle; the rest is absorbed.
    Simple {
        /// Reflected fraction.
        reflectance: Reflectance,
        /// Transmitted fraction.
        transmittance: Reflectance,
    },
    /// Reflectance and transmittance by the angle of incidence, for light from either side; the rest is absorbed.
    Tabulated(TabulatedCoating),
}

/// A coating by wavelength and angle: one row per wavelength, one value per angle. Values are linear in the cosine of the
/// angle.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TabulatedCoating {
    /// Wavelengths \[um\]: all that the sources emit, in any order.
    pub wavelengths: Vec<f64>,
    /// Angles of incidence, each in the medium that light comes from, ascending from 0 to 90 \[deg\].
    pub angles: Vec<f64>,
    /// Reflected fraction of light from the front.
    pub reflectance: Vec<Vec<f64>>,
    /// Transmitted fraction of light from the front.
    pub transmittance: Vec<Vec<f64>>,
    /// Reflected fraction of light from the back.
    pub reflectance_back: Vec<Vec<f64>>,
    /// Transmitted fraction of light from the back.
    pub transmittance_back: Vec<Vec<f64>>,
}

/// How rare branches are sampled.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SamplingPolicy {
    /// Probability of drawing reflection at a refractive surface.
    pub reflect_prob: ReflectProb,
    /// Split rays of fewer events than this at refractive surfaces, and follow both branches. 0: never.
    pub split_depth: u32,
    /// Most rays that come of one launched ray and are alive at a time; of a fraction, so large a share of the launched
    /// rays may have one more. Unused while `split_depth` is 0.
    pub split_budget: f64,
    /// Russian roulette starts below this fraction of the mean flux of a new ray.
    pub rr_start_flux: f64,
    /// To which light rays are guided, if they are.
    pub guide: Option<GuidePolicy>,
    /// With which probability rays scatter where a share of the light does.
    pub scatter_prob: Option<ScatterProb>,
    /// Towards what some of the scattered rays go.
    pub scatter_to: Vec<ScatterTo>,
}

/// To which light rays are guided.
#[derive(Debug, Clone, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct GuidePolicy {
    /// The detector of that light; null: all detectors.
    pub detector: Option<String>,
    /// An expression that its paths match, as of `--where`; null: all paths. It keeps no light from a map.
    pub r#where: Option<String>,
}

impl Default for SamplingPolicy {
    fn default() -> Self {
        Self {
            reflect_prob: ReflectProb::Fresnel,
            split_depth: 0,
            split_budget: 4.0,
            rr_start_flux: 1e-3,
            guide: None,
            scatter_prob: None,
            scatter_to: Vec::new(),
        }
    }
}

/// Probability of drawing reflection.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ReflectProb {
    /// The Fresnel reflectance.
    Fresnel,
    /// The Fresnel reflectance, clipped to \[0.25, 0.75\].
    Auto,
    /// A constant.
    #[serde(rename = "$number")]
    Constant(f64),
}

impl JsonSchema for ReflectProb {
    fn schema_name() -> Cow<'static, str> {
        "ReflectProb".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "oneOf": [{ "enum": ["fresnel", "auto"] }, { "type": "number", "minimum": 0, "maximum": 1 }],
        })
    }
}
