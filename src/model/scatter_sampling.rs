//! Scattering that is drawn on purpose: how often rays scatter at a surface, and towards what. Weights are exact, so that no
//! expectation changes.
//!
//! A telescope's mirror scatters a four-hundredth of its light, and a millionth of that meets the detector. Plain rays would
//! follow the other light. Shaders: shaders/scatter_to.

use crate::model::key_path::ticked;
use crate::model::shapes::Across;
use crate::model::shapes::plane::Outline;
use crate::model::{Sampling, Scatter, SceneIr, Shape};
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// How the scattering of one surface is drawn.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct ScatterSampling {
    /// The probability with which a ray scatters; none: the surface's own share of light.
    pub prob: Option<f64>,
    /// Towards what scattered rays go.
    pub targets: Vec<Target>,
}

/// What some of the scattered rays go towards.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Target {
    /// The share of the scattered rays.
    pub share: f64,
    /// The target.
    pub shape: TargetShape,
}

/// A target, in the scene's frame \[mm\].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum TargetShape {
    /// Directions about an axis, wherever the surface is: uniform over their solid angle.
    Cone {
        /// Unit vector.
        axis: [f64; 3],
        /// Half of the opening angle \[rad\].
        half_angle: f64,
    },
    /// A sphere: uniform over the solid angle that it fills.
    Sphere {
        /// Its centre.
        center: [f64; 3],
        /// Its radius.
        radius: f64,
    },
    /// A rectangle: uniform over its area.
    Rectangle {
        /// Its centre.
        center: [f64; 3],
        /// From the centre to the middles of two sides.
        half_sides: [[f64; 3]; 2],
    },
    /// A disk: uniform over its area.
    Disk {
        /// Its centre.
        center: [f64; 3],
        /// Two perpendicular radii.
        radii: [[f64; 3]; 2],
    },
}

/// What the user asks for: a target of the surfaces of a name.
#[derive(Debug, Clone, PartialEq)]
pub struct TargetRequest {
    /// Name of a surface; `*` stands for any characters.
    pub surface: String,
    /// The target.
    pub target: RequestedTarget,
    /// The share of the scattered rays.
    pub share: f64,
}

/// A target as the user says it.
#[derive(Debug, Clone, PartialEq)]
pub enum RequestedTarget {
    /// A detector or a surface.
    Named(String),
    /// A shape.
    Shape(TargetShape),
}

/// The share of a target that says none.
pub const DEFAULT_SHARE: f64 = 0.5;

/// Most targets of a surface.
const MOST_TARGETS: usize = 64;

/// Numbers of a target in the table of shaders/scatter_to/lobe.mixed.wgsl.
const NUMBERS: usize = 11;

/// Why something that was asked for cannot be.
#[derive(Debug, Clone, PartialEq)]
pub struct Refusal {
    /// The key: `scatter_prob`, or `scatter_to[2].target`.
    pub key: String,
    /// What is wrong.
    pub problem: String,
    /// What would be right.
    pub remedy: String,
}

fn refusal<T>(key: &str, problem: String, remedy: impl Into<String>) -> Result<T, Refusal> {
    Err(Refusal { key: key.into(), problem, remedy: remedy.into() })
}

/// How scattering is drawn at each surface of a scene: with probabilities of the surfaces of a name, or of all, and
/// towards targets. Empty if the scene asks for no such draws.
///
/// # Errors
/// [`Refusal`] with the first that makes no sense in the scene.
pub fn resolve(
    ir: &SceneIr,
    probs: &[(Option<String>, f64)],
    aims: &[TargetRequest],
) -> Result<Vec<ScatterSampling>, Refusal> {
    if probs.is_empty() && aims.is_empty() {
        return Ok(Vec::new());
    }
    let mut found = vec![ScatterSampling::default(); ir.surfaces.len()];
    for (name, prob) in probs {
        if !(*prob > 0.0 && *prob < 1.0) {
            let problem = format!("the probability {prob} leaves one branch undrawn");
            return refusal("scatter_prob", problem, "give a number between 0 and 1, such as 0.5");
        }
        let of_all = name.is_none();
        let scatters = || ir.surfaces.iter().filter_map(|surface| surface.scatter.as_ref());
        if of_all && !scatters().any(Scatter::is_of_a_part) {
            let problem = "no surface scatters a part of its light".into();
            return refusal(
                "scatter_prob",
                problem,
                "give one a `bsdf` and a scatter_fraction below 1, or leave it out",
            );
        }
        for surface in surfaces(ir, name.as_deref().unwrap_or("*"), "scatter_prob", of_all)? {
            let scatter = scatter_of(ir, surface);
            if scatter.is_some_and(Scatter::is_of_a_part) {
                found[surface].prob = Some(*prob);
            } else if !of_all {
                let scatters_all = scatter.is_some_and(|scatter| scatter.fraction > 0.0);
                let (name, share) = (ir.surface_name(surface), if scatters_all { "all" } else { "none" });
                let problem =
                    format!("{} scatters {share} of its light, so nothing is drawn there", ticked(&name));
                return refusal("scatter_prob", problem, "leave it out");
            }
        }
    }
    for (number, aim) in aims.iter().enumerate() {
        let key = |name: &str| format!("scatter_to[{number}].{name}");
        if !(aim.share > 0.0 && aim.share < 1.0) {
            let problem = format!("the share {} is none between 0 and 1", aim.share);
            return refusal(&key("share"), problem, "give a number between 0 and 1, such as 0.5");
        }
        let shape = aim.target.shape(ir, &key("target"))?;
        for surface in surfaces(ir, &aim.surface, &key("surface"), false)? {
            found[surface].targets.push(Target { share: aim.share, shape: shape.clone() });
            let sum: f64 = found[surface].targets.iter().map(|target| target.share).sum();
            if sum > HIGHEST_SUM || found[surface].targets.len() > MOST_TARGETS {
                let (name, num) = (ir.surface_name(surface), found[surface].targets.len());
                let problem = format!("the {num} targets of {} have shares of {sum} together", ticked(&name));
                let remedy = format!(
                    "the shares of one surface add up to at most {HIGHEST_SUM}, in at most {MOST_TARGETS} targets: the others follow its BSDF"
                );
                return refusal(&key("share"), problem, remedy);
            }
        }
    }
    Ok(found)
}

/// Sets how a scene draws its scattering. Rays that are sent on purpose towards rare light weigh little: roulette then leaves them
/// alone, unless it has a threshold other than the default.
pub fn set(ir: &mut SceneIr, sampling: Vec<ScatterSampling>) {
    if !sampling.is_empty() && ir.sampling.rr_start_flux == Sampling::default().rr_start_flux {
        ir.sampling.rr_start_flux = 0.0;
    }
    ir.scatter_sampling = sampling;
}

/// The largest sum of the shares of one surface. A weight is then at most a thousand times a plain ray's weight.
const HIGHEST_SUM: f64 = 0.999;

fn scatter_of(ir: &SceneIr, surface: usize) -> Option<&Scatter> {
    ir.surfaces[surface].scatter.as_ref()
}

/// The surfaces of a name that scatter. A name without `*` must be the name of a surface that scatters.
fn surfaces(ir: &SceneIr, name: &str, key: &str, may_be_none: bool) -> Result<Vec<usize>, Refusal> {
    let all: Vec<usize> =
        (0..ir.surfaces.len()).filter(|&surface| matches(name, &ir.surface_name(surface))).collect();
    let can = |surface: &usize| {
        scatter_of(ir, *surface).is_some_and(|scatter| !scatter.bsdf.kind().wgsl().toward.is_empty())
    };
    let can_scatter: Vec<usize> = all.iter().copied().filter(can).collect();
    if !can_scatter.is_empty() || may_be_none {
        return Ok(can_scatter);
    }
    let names: Vec<String> =
        (0..ir.surfaces.len()).filter(can).map(|surface| ir.surface_name(surface)).collect();
    let scattering = match names.is_empty() {
        true => "no surface of the scene scatters: give one a `bsdf`".into(),
        false => format!("these scatter: {}", listed(&names)),
    };
    match all.first() {
        None => refusal(key, format!("{} is no surface", ticked(name)), scattering),
        Some(_) => refusal(
            key,
            format!("{} scatters no light, or as a mirror does, without a density", ticked(name)),
            scattering,
        ),
    }
}

/// Some names.
fn listed(names: &[String]) -> String {
    const MOST: usize = 8;
    let first: Vec<String> = names.iter().take(MOST).map(|name| ticked(name)).collect();
    let more = if names.len() > MOST { format!(" and {} more", names.len() - MOST) } else { String::new() };
    first.join(", ") + &more
}

/// True if a name is of this pattern, in which `*` stands for any characters.
fn matches(pattern: &str, name: &str) -> bool {
    let Some((first, rest)) = pattern.split_once('*') else { return pattern == name };
    let Some(mut left) = name.strip_prefix(first) else { return false };
    let mut parts: Vec<&str> = rest.split('*').collect();
    let last = parts.pop().unwrap_or("");
    for part in parts {
        let Some(at) = left.find(part) else { return false };
        left = &left[at + part.len()..];
    }
    left.ends_with(last)
}

impl RequestedTarget {
    fn shape(&self, ir: &SceneIr, key: &str) -> Result<TargetShape, Refusal> {
        let name = match self {
            RequestedTarget::Shape(shape) => return shape.checked(key),
            RequestedTarget::Named(name) => name,
        };
        let detector = ir.detectors.iter().find(|detector| detector.name == *name);
        if let Some(detector) = detector {
            return plane(detector.outline(), &detector.frame).map_or_else(
                || refusal(key, format!("the detector {} has no edge", ticked(name)), "name a shape"),
                Ok,
            );
        }
        let Some(surface) = (0..ir.surfaces.len()).find(|&surface| ir.surface_name(surface) == *name) else {
            let names: Vec<String> = ir.detectors.iter().map(|detector| detector.name.clone()).collect();
            return refusal(
                key,
                format!("{} is no detector and no surface", ticked(name)),
                format!("the detectors are {}; or name a surface, or a shape", listed(&names)),
            );
        };
        let surface = &ir.surfaces[surface];
        let flat =
            if let Shape::Plane(outline) = &surface.shape { plane(*outline, &surface.frame) } else { None };
        let ball = || {
            let extent = surface.shape.extent(&ir.meshes)?;
            let across = match extent.across {
                Across::Disk(radius) => radius,
                Across::Rectangle(half) => half.length(),
            };
            let center = surface.frame.origin + surface.frame.rotation * extent.middle;
            Some(TargetShape::Sphere { center: center.into(), radius: across.hypot(extent.half_height) })
        };
        flat.or_else(ball).map_or_else(
            || {
                refusal(
                    key,
                    format!("the surface {} has no edge", ticked(name)),
                    "give it an aperture, or name a shape",
                )
            },
            Ok,
        )
    }
}

/// A plane's part, if it has an edge.
fn plane(outline: Outline, frame: &crate::model::Frame) -> Option<TargetShape> {
    let center = frame.origin.into();
    let axes = |x: f64, y: f64| [(frame.rotation.x_axis * x).into(), (frame.rotation.y_axis * y).into()];
    match outline {
        Outline::Infinite => None,
        Outline::Rectangle { width, height } => {
            Some(TargetShape::Rectangle { center, half_sides: axes(0.5 * width, 0.5 * height) })
        }
        Outline::Disk { radius } => Some(TargetShape::Disk { center, radii: axes(radius, radius) }),
    }
}

impl TargetShape {
    /// A cone about an axis of any length.
    pub fn cone(axis: [f64; 3], half_angle_deg: f64) -> Self {
        let unit = DVec3::from(axis).try_normalize().map_or([f64::NAN; 3], Into::into);
        TargetShape::Cone { axis: unit, half_angle: half_angle_deg.to_radians() }
    }

    /// A disk about a normal of any length.
    pub fn disk(center: [f64; 3], normal: [f64; 3], radius: f64) -> Self {
        let radii = DVec3::from(normal).try_normalize().map_or([[f64::NAN; 3]; 2], |normal| {
            let (one, other) = normal.any_orthonormal_pair();
            [(one * radius).into(), (other * radius).into()]
        });
        TargetShape::Disk { center, radii }
    }

    fn checked(&self, key: &str) -> Result<TargetShape, Refusal> {
        let is_finite = self.numbers().iter().all(|number| number.is_finite() && number.abs() <= 1e12);
        let (is_right, remedy) = match self {
            TargetShape::Cone { half_angle, .. } => (
                *half_angle > 1e-6 && *half_angle <= std::f64::consts::PI,
                "a cone has an axis that is not 0, and half_angle_deg above 0 and up to 180",
            ),
            TargetShape::Sphere { radius, .. } => {
                (*radius > 0.0, "a sphere has a center [mm] and a radius above 0 [mm]")
            }
            TargetShape::Rectangle { half_sides: sides, .. } | TargetShape::Disk { radii: sides, .. } => (
                sides.iter().all(|side| DVec3::from(*side).length() > 0.0),
                "a disk has a center [mm], a normal that is not 0, and a radius above 0 [mm]",
            ),
        };
        if is_finite && is_right {
            Ok(self.clone())
        } else {
            refusal(key, "the shape is none".into(), remedy)
        }
    }

    /// The numbers after the share: the kind, then three vectors.
    fn numbers(&self) -> Vec<f64> {
        let (kind, vectors) = match self {
            TargetShape::Cone { axis, half_angle } => {
                // 1 - cos, which keeps its digits where the angle is small.
                let height = 2.0 * (0.5 * half_angle).sin().powi(2);
                (0.0, [*axis, [height, 0.0, 0.0], [0.0; 3]])
            }
            TargetShape::Sphere { center, radius } => (1.0, [*center, [*radius, 0.0, 0.0], [0.0; 3]]),
            TargetShape::Rectangle { center, half_sides: [u, v] } => (2.0, [*center, *u, *v]),
            TargetShape::Disk { center, radii: [u, v] } => (3.0, [*center, *u, *v]),
        };
        std::iter::once(kind).chain(vectors.into_iter().flatten()).collect()
    }
}

impl ScatterSampling {
    /// The table of its targets as the shaders read it: their places are those relative to the surface's origin.
    pub fn table(&self, origin: DVec3) -> Vec<f64> {
        let row = |target: &Target| {
            let mut numbers = target.shape.numbers();
            if !matches!(target.shape, TargetShape::Cone { .. }) {
                numbers[1..4]
                    .iter_mut()
                    .zip(origin.to_array())
                    .for_each(|(number, origin)| *number -= origin);
            }
            numbers.insert(1, target.share);
            debug_assert_eq!(numbers.len(), NUMBERS);
            numbers
        };
        self.targets.iter().flat_map(row).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_star_stands_for_any_characters() {
        for (pattern, name, expected) in [
            ("*", "", true),
            ("baffle*", "baffle_3", true),
            ("*.front", "L1.front", true),
            ("b*e_*3", "baffle_13", true),
            ("b*e_*3", "baffle_1", false),
            ("a*a", "a", false),
            ("baffle", "baffle_3", false),
        ] {
            assert_eq!(matches(pattern, name), expected, "{pattern} {name}");
        }
    }
}
