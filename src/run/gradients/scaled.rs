//! Parameters in units of their own size, and the scenes about the traced one by which the host differentiates its numbers.

use crate::error::{Error, Result};
use crate::format::shown;
use crate::model::{Allowance, Coating, Frame, Interaction, Medium, ReflectProb, SceneIr, SimpleCoating};
use crate::program::features::has_unit_gradients;
use crate::program::rewrite::jvp::Parameter;
use crate::scene::named_entries::{last_key, moves};
use glam::DMat3;
use rayon::prelude::*;

/// Differences of sixth order: how many steps from the scene, and the factor.
const CENTRAL: [(f64, f64); 6] =
    [(1.0, 0.75), (-1.0, -0.75), (2.0, -0.15), (-2.0, 0.15), (3.0, 1.0 / 60.0), (-3.0, -1.0 / 60.0)];
/// The same from one side, where a number cannot go below, or above, what it is.
const ONE_SIDED: [(f64, f64); 7] =
    [(0.0, -2.45), (1.0, 6.0), (2.0, -7.5), (3.0, 20.0 / 3.0), (4.0, -3.75), (5.0, 1.2), (6.0, -1.0 / 6.0)];
/// A step, relative to the size of the number.
const STEP: f64 = 2e-3;
/// A step of a position \[mm\] or an angle \[rad\].
const FRAME_STEP: f64 = 1e-3;
/// A change of a coefficient that counts moves a shape by so much of its size.
const MOVED: f64 = 1e-2;
/// The size of a k that is 0: glass of 10 mm with this k takes a quarter of green light.
const ABSORPTION: f64 = 1e-6;

/// A parameter in units of its natural size, so that sums of derivatives neither overflow nor lose digits.
#[derive(Debug, Clone)]
pub(super) struct Scaled {
    pub(super) parameter: Parameter,
    pub(super) size: f64,
    /// Two scenes of the stencil, and how much larger the number is in the first.
    pub(super) ends: ([usize; 2], f64),
}

impl Scaled {
    /// The parameter of a name, whose number is `value` in the scene. `with` gives the scene with another number.
    ///
    /// # Errors
    /// [`Error::Usage`] for a number by which nothing can be differentiated.
    pub(super) fn new(
        ir: &SceneIr,
        name: &str,
        value: f64,
        with: impl Fn(f64) -> Result<SceneIr> + Sync,
    ) -> Result<Self> {
        let key = last_key(name);
        if !value.is_finite() || value == 0.0 && is_radius(key) {
            return Err(Error::Usage(format!(
                "`{}` is {value}: a flat face has no derivative by its radius; give it a large radius, such as 1e6",
                shown(name)
            )));
        }
        let is_frame = moves(key);
        let is_of_list = !name.ends_with(key);
        let by_shape = || size_by_shape(ir, |change| with(value + change));
        let size = match is_of_list.then(by_shape).flatten() {
            Some(size) => size.max(value.abs()),
            None if key == "k" => value.abs().max(ABSORPTION),
            None if is_frame || value == 0.0 => 1.0,
            None if key.starts_with("conic") => value.abs().max(1.0),
            None => value.abs(),
        };
        let step = if is_frame { FRAME_STEP } else { STEP * size };
        let stencil = |points: &[(f64, f64)], sign: f64| -> Result<Vec<(f64, SceneIr)>> {
            let points = points
                .par_iter()
                .map(|(steps, factor)| Ok((sign * factor * size / step, with(value + sign * steps * step)?)));
            points.collect()
        };
        let central = stencil(&CENTRAL, 1.0).map(|found| (found, ([0, 1], 2.0 * step)));
        let (stencil, ends) = central.or_else(|error| {
            let of_sign = |sign: f64| Ok((stencil(&ONE_SIDED, sign)?, ([1, 0], sign * step)));
            of_sign(1.0).or_else(|_: Error| of_sign(-1.0)).map_err(|_| changed_a_little(name, error))
        })?;
        if stencil.iter().any(|(_, there)| lights_dark_source(ir, there)) {
            return Err(Error::Usage(format!(
                "`{}` is {value}: a dark source launches a single ray, which shows no derivative; give it a flux above 0",
                shown(name)
            )));
        }
        if stencil.iter().any(|(_, there)| takes_undrawn(ir, there)) {
            return Err(Error::Usage(format!(
                "`{}` is {value}: no ray takes the branch whose share it changes, so a trace sees no derivative; \
                 give it a value such as 0.001 or 0.999, or compare two scenes by `nsq-gpu diff`",
                shown(name)
            )));
        }
        Ok(Scaled { parameter: Parameter { name: name.to_owned(), stencil }, size, ends })
    }

    /// The two scenes of the stencil that lie farthest apart: the one with less of the parameter, then the one with more. Of a
    /// stencil on one side, the farthest scene comes first, then the traced one.
    pub(super) fn farthest(&self) -> [&SceneIr; 2] {
        let stencil = &self.parameter.stencil;
        let last = stencil.len() - 1;
        [last, if self.is_central() { last - 1 } else { 0 }].map(|end| &stencil[end].1)
    }

    /// True if the stencil has more of the parameter and less.
    pub(super) fn is_central(&self) -> bool {
        self.parameter.stencil.len() == CENTRAL.len()
    }
}

/// A name as it is without quotes.
pub(super) fn unquoted(name: &str) -> String {
    name.replace('"', "")
}

/// True of `radius`, `radius_x`, `r1`, `r2`, and so on: 0 stands for a flat face.
fn is_radius(key: &str) -> bool {
    let digits = key.strip_prefix('r').unwrap_or_default();
    matches!(key, "radius" | "radius_x" | "radius_y")
        || !digits.is_empty() && digits.chars().all(|digit| digit.is_ascii_digit())
}

/// How large a change of a coefficient is one that counts: it moves points of a shape by [`MOVED`] of the shape's size. None if
/// the number changes no shape. `with` gives the scene in which the number is so much larger.
fn size_by_shape(ir: &SceneIr, with: impl Fn(f64) -> Result<SceneIr>) -> Option<f64> {
    let moved = |there: &SceneIr| {
        let surfaces = ir.surfaces.iter().zip(&there.surfaces);
        let moved = surfaces.map(|(here, there)| {
            let [here, there] = [here, there].map(|surface| surface.shape.samples());
            let size = here.iter().map(|p| p.truncate().length()).fold(0.0, f64::max);
            let most = here.iter().zip(&there).map(|(here, there)| here.distance(*there)).fold(0.0, f64::max);
            most / size
        });
        moved.filter(|moved| moved.is_finite()).fold(0.0, f64::max)
    };
    let mut change = 1e-9;
    // Powers as high as 20 of a size of 1000 mm are within reach.
    for _ in 0..24 {
        let there = with(change);
        if let Ok(there) = &there
            && ir.surfaces.iter().zip(&there.surfaces).all(|(here, there)| here.shape == there.shape)
        {
            return None;
        }
        match there.map(|there| moved(&there)) {
            Ok(moved) if moved < 1e-6 => change *= 1e3,
            Ok(moved) if moved <= MOVED => return Some(change * MOVED / moved),
            _ => change *= 1e-3,
        }
    }
    None
}

/// The error of a scene that a small change has made wrong.
fn changed_a_little(name: &str, error: Error) -> Error {
    Error::Usage(format!("`{}` cannot be changed a little, so it has no derivative: {error}", shown(name)))
}

/// True if a source without light has light in another scene.
fn lights_dark_source(ir: &SceneIr, there: &SceneIr) -> bool {
    ir.sources.iter().zip(&there.sources).any(|(here, there)| appears(here.total_flux, there.total_flux))
}

/// True of what is 0 in the traced scene alone.
fn appears(here: f64, there: f64) -> bool {
    here == 0.0 && there != 0.0
}

/// True if a branch that no ray of the traced scene takes has light in another scene.
fn takes_undrawn(ir: &SceneIr, there: &SceneIr) -> bool {
    let by_fresnel = ir.sampling.reflect_prob == ReflectProb::Fresnel;
    ir.surfaces.iter().zip(&there.surfaces).any(|(here, there)| {
        let scatter = here.scatter.as_ref().zip(there.scatter.as_ref()).is_some_and(|(here, there)| {
            let lobes = [&here.bsdf, &there.bsdf].map(|bsdf| bsdf.transmissive_fraction());
            let shares = [[here.fraction, there.fraction], lobes];
            shares.iter().any(|[here, there]| appears(*here, *there) || appears(1.0 - here, 1.0 - there))
        });
        let coatings = here
            .coating
            .as_ref()
            .and_then(Coating::simple)
            .zip(there.coating.as_ref().and_then(Coating::simple));
        let any =
            |here: &[f64], there: &[f64]| here.iter().zip(there).any(|(&here, &there)| appears(here, there));
        let reflects = coatings.is_some_and(|(here, there)| any(&here.reflectance, &there.reflectance));
        let passes = coatings.is_some_and(|(here, there)| {
            let pass =
                |coating: &SimpleCoating| coating.reflectance.iter().map(|r| 1.0 - r).collect::<Vec<_>>();
            any(&pass(here), &pass(there))
        });
        scatter || by_fresnel && here.interaction == Interaction::Refractive && (reflects || passes)
    })
}

/// What shaders must allow for, so that all scenes about the traced one have its shaders.
pub(super) fn allowance(ir: &SceneIr, parameters: &[Scaled]) -> Allowance {
    let scenes = || parameters.iter().flat_map(|scaled| &scaled.parameter.stencil).map(|(_, scene)| scene);
    let frames = |ir: &SceneIr| -> Vec<Frame> {
        let surfaces = ir.surfaces.iter().map(|surface| surface.frame);
        let sources = ir.sources.iter().map(|source| source.frame);
        surfaces.chain(ir.detectors.iter().map(|detector| detector.frame)).chain(sources).collect()
    };
    let is_turned = |ir: &SceneIr| -> Vec<bool> {
        frames(ir).iter().map(|frame| frame.rotation != DMat3::IDENTITY).collect()
    };
    let here = is_turned(ir);
    Allowance {
        turned: scenes().any(|scene| is_turned(scene) != here),
        absorbing: scenes().any(|scene| scene.media.iter().any(Medium::absorbs)),
        conic: scenes().any(|scene| !has_unit_gradients(scene)),
    }
}
