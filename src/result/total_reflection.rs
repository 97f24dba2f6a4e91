//! Where along a sequence light may have been totally reflected.
//!
//! A sequence says `R`, be the reflection total or not. Total reflection needs light that comes from the higher index.
//! It also needs an angle of incidence beyond the critical one. The angle is bounded from the source on. The directions
//! of light lie in a cone about an axis, and so do the normals of a face. Refraction, reflection and scattering make
//! another cone of it.
//!
//! The bound is never too small. So light in a plate with parallel faces is never suspected, whatever its angle outside. In a
//! steep lens the bound is too wide, and light is suspected that is not totally reflected.

use crate::model::{Conic, Interaction, MediumId, SceneIr, Sequence, StepKind, Surface};
use glam::DVec3;
use std::f64::consts::FRAC_PI_2;

/// Light at the critical angle itself is not beyond it, whatever the rounding.
const ROUNDING: f64 = 1e-9;

/// Lines within an angle of an axis. No two lines are further apart than a right angle.
#[derive(Debug, Clone, Copy)]
struct Cone {
    axis: DVec3,
    half_angle: f64,
}

/// Light on a boundary of two media.
struct Boundary {
    light: Cone,
    normals: Cone,
    /// The index that light comes from, over the one on the other side, at each wavelength.
    ratios: Vec<f64>,
}

/// The surfaces where light of a sequence may have been totally reflected.
pub fn possible(ir: &SceneIr, sequence: &Sequence) -> Vec<u32> {
    let source = &ir.sources[sequence.source as usize];
    let axis = source.frame.rotation * DVec3::Z;
    let mut light = Cone::new(axis, source.kind.half_angle());
    // None: it is not known.
    let mut medium = Some(source.medium);
    let mut found = Vec::new();
    for step in &sequence.steps {
        let surface = &ir.surfaces[step.surface as usize];
        let normals = normals_of(surface);
        let is_boundary = surface.interaction == Interaction::Refractive;
        let from_front = side(surface, medium);
        if is_boundary {
            let ratios = ratios(ir, surface, from_front, &source.spectrum.wavelengths);
            let boundary = Boundary { light, normals, ratios };
            if step.kind != StepKind::Transmitted && boundary.is_total_possible() {
                found.push(step.surface);
            }
            let passes = matches!(step.kind, StepKind::Transmitted | StepKind::ScatteredThrough);
            medium = from_front.map(|front| if front == passes { surface.back } else { surface.front });
            if step.kind == StepKind::Transmitted {
                light = boundary.transmitted();
            }
        }
        match step.kind {
            StepKind::Transmitted => {}
            StepKind::Reflected => light = light.mirrored(normals),
            StepKind::ScatteredThrough | StepKind::ScatteredBack => light = Cone::new(light.axis, FRAC_PI_2),
        }
    }
    found.sort_unstable();
    found.dedup();
    found
}

/// True for light that comes from the front. `None` if the light's medium does not show the side.
fn side(surface: &Surface, medium: Option<MediumId>) -> Option<bool> {
    match medium {
        Some(medium) if medium == surface.front => Some(true),
        Some(medium) if medium == surface.back => Some(false),
        _ => None,
    }
}

/// The ratios of refractive indices. Where the side is not known, both sides have theirs.
fn ratios(ir: &SceneIr, surface: &Surface, from_front: Option<bool>, wavelengths: &[usize]) -> Vec<f64> {
    let [front, back] = [surface.front, surface.back].map(|medium| &ir.media[medium].n);
    let of_front = wavelengths.iter().map(|&w| front[w] / back[w]);
    let of_back = wavelengths.iter().map(|&w| back[w] / front[w]);
    match from_front {
        Some(true) => of_front.collect(),
        Some(false) => of_back.collect(),
        None => of_front.chain(of_back).collect(),
    }
}

/// The cone of a surface's normals.
fn normals_of(surface: &Surface) -> Cone {
    let half_angle = match (surface.shape.flat(), surface.shape.conic()) {
        (Some(_), _) => 0.0,
        (None, Some(conic)) => steepest(&conic),
        (None, None) => FRAC_PI_2,
    };
    Cone::new(surface.frame.rotation * DVec3::Z, half_angle)
}

/// The angle between the axis and the normal at the rim, which is the largest.
fn steepest(conic: &Conic) -> f64 {
    let height = conic.curvature.abs() * conic.aperture_radius;
    let under_root = 1.0 - (1.0 + conic.conic) * height * height;
    if under_root <= 0.0 { FRAC_PI_2 } else { (height / under_root.sqrt()).atan() }
}

/// The angle between two lines.
fn between(a: DVec3, b: DVec3) -> f64 {
    a.cross(b).length().atan2(a.dot(b).abs())
}

impl Cone {
    fn new(axis: DVec3, half_angle: f64) -> Self {
        Cone { axis, half_angle: half_angle.min(FRAC_PI_2) }
    }

    /// Mirrored by a surface: a normal that is turned by an angle turns the light by twice as much.
    fn mirrored(self, normals: Cone) -> Self {
        let axis = self.axis - 2.0 * self.axis.dot(normals.axis) * normals.axis;
        Cone::new(axis, self.half_angle + 2.0 * normals.half_angle)
    }
}

impl Boundary {
    /// The largest angle of incidence.
    fn incidence(&self) -> f64 {
        let apart = between(self.light.axis, self.normals.axis);
        (self.light.half_angle + apart + self.normals.half_angle).min(FRAC_PI_2)
    }

    fn is_total_possible(&self) -> bool {
        let sine = self.incidence().sin();
        self.ratios.iter().any(|ratio| ratio * sine > 1.0 + ROUNDING)
    }

    /// The cone about the normals' axis, or about the light's axis, whichever is narrower.
    fn transmitted(&self) -> Cone {
        let incidence = self.incidence();
        let refracted = |ratio: f64, angle: f64| (ratio * angle.sin()).min(1.0).asin();
        let largest =
            |angle: &dyn Fn(f64) -> f64| self.ratios.iter().map(|&ratio| angle(ratio)).fold(0.0, f64::max);
        let about_normals = self.normals.half_angle + largest(&|ratio| refracted(ratio, incidence));
        // Beyond the critical angle nothing is transmitted, and up to there the deviation grows.
        let deviation = |ratio: f64| {
            let last = incidence.min((1.0 / ratio).min(1.0).asin());
            (refracted(ratio, last) - last).abs()
        };
        let about_light = self.light.half_angle + largest(&deviation);
        match about_normals < about_light {
            true => Cone::new(self.normals.axis, about_normals),
            false => Cone::new(self.light.axis, about_light),
        }
    }
}
