//! What surfaces take of the light, and what they do with it: sums over what the user wrote.

use crate::model::{Coating, Interaction, SceneIr, Surface};

/// The reflectance of a mirror or a simple coating at a wavelength of the scene; 1 elsewhere.
pub fn reflectance(surface: &Surface, wavelength: usize) -> f64 {
    match (&surface.interaction, &surface.coating) {
        (Interaction::Reflective { reflectance }, _) => reflectance[wavelength],
        (Interaction::Refractive, Some(Coating::Simple(coating))) => coating.reflectance[wavelength],
        (Interaction::Refractive | Interaction::Absorbing, _) => 1.0,
    }
}

/// T / (1 - R) of a simple coating at a wavelength of the scene: the transmitted share of what it does not reflect.
pub fn coating_pass(surface: &Surface, wavelength: usize) -> f64 {
    match surface.coating.as_ref().and_then(Coating::simple) {
        None => 1.0,
        Some(coating) if coating.reflectance[wavelength] >= 1.0 => 0.0,
        // R + T may exceed 1 by the rounding of what the user wrote.
        Some(coating) => {
            (coating.transmittance[wavelength] / (1.0 - coating.reflectance[wavelength])).min(1.0)
        }
    }
}

/// Surfaces that take a part of the rays they reflect.
pub fn lossy_mirrors(ir: &SceneIr) -> impl Iterator<Item = u32> + '_ {
    let lossy = |surface: &Surface| match &surface.interaction {
        Interaction::Reflective { reflectance } => {
            surface.coating.is_some() || reflectance.iter().any(|&r| r != 1.0)
        }
        Interaction::Refractive | Interaction::Absorbing => false,
    };
    (0..).zip(&ir.surfaces).filter(move |(_, surface)| lossy(surface)).map(|(i, _)| i)
}

/// The least share of its weight, above 0, that a ray keeps at a mirror or a simple coating. A share of 0 does not
/// count, because roulette leaves a weight of 0 alone.
pub fn least_share(ir: &SceneIr) -> f64 {
    let at = |surface: &Surface, wavelength: usize| match &surface.interaction {
        Interaction::Reflective { .. } => reflectance(surface, wavelength),
        Interaction::Refractive | Interaction::Absorbing => coating_pass(surface, wavelength),
    };
    let wavelengths = 0..ir.wavelengths.len();
    let shares = ir.surfaces.iter().flat_map(|surface| wavelengths.clone().map(move |w| at(surface, w)));
    shares.filter(|&share| share > 0.0).fold(1.0, f64::min)
}

/// True if rays are split at refractive surfaces.
pub fn splits(ir: &SceneIr) -> bool {
    ir.sampling.split_depth > 0 && ir.surfaces.iter().any(|s| s.interaction == Interaction::Refractive)
}

/// True if both branches of a split may scatter to one side. Then a ray may bring light twice by one sequence of events.
pub fn branches_scatter(ir: &SceneIr) -> bool {
    let scatters = |s: &Surface| s.interaction == Interaction::Refractive && s.scatter.is_some();
    splits(ir) && ir.surfaces.iter().any(scatters)
}

/// True if two media border on each other somewhere.
pub fn has_boundaries(ir: &SceneIr) -> bool {
    ir.surfaces.iter().any(is_boundary)
}

/// True if a ray that passes the surface comes into another medium.
pub fn is_boundary(surface: &Surface) -> bool {
    surface.interaction == Interaction::Refractive && surface.front != surface.back
}
