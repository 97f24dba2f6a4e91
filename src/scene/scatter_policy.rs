//! What a scene file says of scattering that is drawn on purpose: `scatter_prob` and `scatter_to`.

use crate::error::{Error, Result};
use crate::model::SceneIr;
use crate::model::scatter_sampling::{
    DEFAULT_SHARE, Refusal, RequestedTarget, TargetRequest, TargetShape, resolve, set,
};
use crate::scene::json::SamplingPolicy;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::Deserialize;
use std::borrow::Cow;
use std::collections::BTreeMap;

/// With which probability rays scatter. Weights are exact.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub enum ScatterProb {
    /// At every surface that scatters some of its light.
    #[serde(rename = "$number")]
    All(f64),
    /// By the surface's name, in which `*` stands for any characters.
    #[serde(rename = "$object")]
    BySurface(BTreeMap<String, f64>),
}

impl JsonSchema for ScatterProb {
    fn schema_name() -> Cow<'static, str> {
        "ScatterProb".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        let between = serde_json::json!({ "type": "number", "exclusiveMinimum": 0, "exclusiveMaximum": 1 });
        json_schema!({
            "description": "a probability for every surface that scatters some of its light, or one by the surface's name",
            "oneOf": [between.clone(), { "type": "object", "additionalProperties": between }],
        })
    }
}

/// Towards what some of the rays go that a surface scatters.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ScatterTo {
    /// The surface's name, in which `*` stands for any characters.
    pub surface: String,
    /// The target.
    pub target: ScatterTarget,
    /// The share of the scattered rays.
    #[serde(default = "half")]
    pub share: f64,
}

fn half() -> f64 {
    DEFAULT_SHARE
}

/// A target: the name of a detector or a surface, or one shape.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum ScatterTarget {
    /// A detector or a surface.
    #[serde(rename = "$string")]
    Named(String),
    /// One shape, in global coordinates.
    #[serde(rename = "$object")]
    Shape {
        /// Directions about an axis.
        #[serde(default)]
        cone: Option<ConeTarget>,
        /// A sphere.
        #[serde(default)]
        sphere: Option<SphereTarget>,
        /// A disk.
        #[serde(default)]
        disk: Option<DiskTarget>,
    },
}

/// Directions about an axis, wherever the surface is.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ConeTarget {
    /// A vector along the axis, of any length.
    pub axis: [f64; 3],
    /// Half of the opening angle \[deg\].
    pub half_angle_deg: f64,
}

/// A sphere.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SphereTarget {
    /// Centre \[mm\].
    pub center: [f64; 3],
    /// Radius \[mm\].
    pub radius: f64,
}

/// A disk.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DiskTarget {
    /// Centre \[mm\].
    pub center: [f64; 3],
    /// A vector along its axis, of any length.
    pub normal: [f64; 3],
    /// Radius \[mm\].
    pub radius: f64,
}

impl JsonSchema for ScatterTarget {
    fn schema_name() -> Cow<'static, str> {
        "ScatterTarget".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let one = |key: &str, shape: Schema| {
            serde_json::json!({
                "type": "object", "properties": { key: shape }, "required": [key], "additionalProperties": false,
            })
        };
        json_schema!({
            "description": "the name of a detector or a surface, or one shape in global coordinates",
            "oneOf": [
                { "type": "string" },
                one("cone", generator.subschema_for::<ConeTarget>()),
                one("sphere", generator.subschema_for::<SphereTarget>()),
                one("disk", generator.subschema_for::<DiskTarget>()),
            ],
        })
    }
}

/// The key of the shapes of a target.
const SHAPES: &str = "give the name of a detector or a surface, or one of cone, sphere and disk";

impl ScatterTarget {
    fn aim(&self, key: &str) -> std::result::Result<RequestedTarget, Refusal> {
        let found = match self {
            ScatterTarget::Named(name) => return Ok(RequestedTarget::Named(name.clone())),
            ScatterTarget::Shape { cone, sphere, disk } => [
                cone.as_ref().map(|cone| TargetShape::cone(cone.axis, cone.half_angle_deg)),
                sphere.as_ref().map(|ball| TargetShape::Sphere { center: ball.center, radius: ball.radius }),
                disk.as_ref().map(|disk| TargetShape::disk(disk.center, disk.normal, disk.radius)),
            ],
        };
        let mut shapes = found.into_iter().flatten();
        match (shapes.next(), shapes.next()) {
            (Some(shape), None) => Ok(RequestedTarget::Shape(shape)),
            (first, _) => Err(Refusal {
                key: key.into(),
                problem: format!(
                    "the target has {} shape",
                    if first.is_some() { "more than one" } else { "no" }
                ),
                remedy: SHAPES.into(),
            }),
        }
    }
}

/// Sets how a scene draws its scattering, as its file says.
///
/// # Errors
/// [`Error::Scene`] with the place of what makes no sense in the scene.
pub(crate) fn apply(policy: &SamplingPolicy, ir: &mut SceneIr) -> Result<()> {
    let refused = |Refusal { key, problem, remedy }| Error::Scene {
        place: format!("nsq_gpu.sampling.{key}"),
        problem,
        remedy,
    };
    let probs = match &policy.scatter_prob {
        None => Vec::new(),
        Some(ScatterProb::All(prob)) => vec![(None, *prob)],
        Some(ScatterProb::BySurface(by_name)) => {
            by_name.iter().map(|(name, prob)| (Some(name.clone()), *prob)).collect()
        }
    };
    let aim = |(number, to): (usize, &ScatterTo)| {
        let target = to.target.aim(&format!("scatter_to[{number}].target"))?;
        Ok(TargetRequest { surface: to.surface.clone(), target, share: to.share })
    };
    let aims = policy.scatter_to.iter().enumerate().map(aim).collect::<std::result::Result<Vec<_>, _>>();
    let found = aims.and_then(|aims| resolve(ir, &probs, &aims)).map_err(refused)?;
    set(ir, found);
    Ok(())
}
