//! What a scene may say without its user meaning it: it is traced as it is written, and told.

use std::collections::{HashMap, HashSet};

use glam::{DVec2, DVec3};

use super::json::{Detector, Material, Profile, ReflectProb, SceneFile, Source};
use super::materials::listed;
use super::media::MediaTable;
use super::place::quoted;
use super::surfaces::SceneSurface;
use crate::ir::lower::sensor;
use crate::ir::{Bsdf, Frame, Interaction, MediumId, Outline, Shape};
use crate::result::format::significant;

/// Everything that deserves a warning once all surfaces are known.
pub(super) fn of(
    file: &SceneFile,
    surfaces: &[SceneSurface],
    media: &MediaTable,
    wavelengths: &[f64],
) -> Vec<String> {
    let mut doubts: Vec<String> = surfaces.iter().filter_map(swapped_lobe).collect();
    doubts.extend(open_media(file, surfaces, media));
    doubts.extend(file.detectors.iter().filter_map(|detector| wavelengths_beyond(detector, wavelengths)));
    doubts.extend(hidden_detectors(file, surfaces));
    doubts.extend(one_branch(file, surfaces));
    doubts.extend(file.sources.iter().filter_map(rays_on_the_rim));
    doubts
}

// Scattering

/// On a refractive surface a Harvey-Shack lobe is about the ray that Fresnel's branch sends on, or about its mirror image,
/// on the other side.
fn swapped_lobe(surface: &SceneSurface) -> Option<String> {
    let Bsdf::HarveyShack { transmissive_fraction, .. } = surface.scatter.as_ref()?.bsdf else { return None };
    let is_swapped = surface.interaction == Interaction::Refractive && transmissive_fraction < 1.0;
    is_swapped.then(|| {
        format!(
            "of what {} scatters, {:.1} % goes to the other side than Fresnel's branch, as in Optiland: a \
             transmissive_fraction of 1 blurs both branches where they are",
            quoted(&surface.name),
            100.0 * (1.0 - transmissive_fraction)
        )
    })
}

// Media

/// Media that one open face alone borders on: a solid of it has no other face, most often because that one's medium was
/// forgotten.
fn open_media(file: &SceneFile, surfaces: &[SceneSurface], media: &MediaTable) -> Vec<String> {
    let mut num_faces: HashMap<Option<MediumId>, usize> = HashMap::new();
    for surface in surfaces {
        let sides = HashSet::from([media.id(&surface.front), media.id(&surface.back)]);
        sides.into_iter().for_each(|medium| *num_faces.entry(medium).or_default() += 1);
    }
    let of_sources: HashSet<_> = file.sources.iter().map(|source| media.id(source.medium())).collect();
    let is_lone = |medium: &Material| {
        let id = media.id(medium);
        *medium != Material::Vacuum && num_faces.get(&id) == Some(&1) && !of_sources.contains(&id)
    };
    let bounds = |surface: &&SceneSurface| {
        surface.interaction == Interaction::Refractive && surface.front != surface.back
    };
    let open = surfaces.iter().filter(bounds).filter(|surface| !is_closed(&surface.shape));
    open.flat_map(|surface| [(surface, &surface.front), (surface, &surface.back)])
        .filter(|(_, medium)| is_lone(medium))
        .map(|(surface, medium)| {
            format!(
                "{} alone borders on {}: if that is a solid, the face where light leaves it has lost its medium",
                quoted(&surface.name),
                quoted(medium.name())
            )
        })
        .collect()
}

fn is_closed(shape: &Shape) -> bool {
    match shape {
        Shape::Sphere { aperture_radius, .. } => aperture_radius.is_none(),
        Shape::Mesh(_) => true,
        Shape::Conic { .. } | Shape::Plane(_) | Shape::Annulus { .. } | Shape::Frustum { .. } => false,
    }
}

// Detectors

fn wavelengths_beyond(detector: &Detector, wavelengths: &[f64]) -> Option<String> {
    let Detector::Spectral(spectral) = detector else { return None };
    let beyond: Vec<String> = wavelengths
        .iter()
        .filter(|wavelength| !(spectral.wl_min..=spectral.wl_max).contains(wavelength))
        .map(f64::to_string)
        .collect();
    (!beyond.is_empty()).then(|| {
        format!(
            "detector {} counts light of {} um in its first or last bin, though its bins reach from {} to {} um, as in \
             Optiland",
            quoted(&spectral.name),
            listed(&beyond),
            spectral.wl_min,
            spectral.wl_max
        )
    })
}

/// Detectors in the plane of a surface, or of a detector before them in the list: of what coincides a ray meets the first
/// alone, as in Optiland.
fn hidden_detectors(file: &SceneFile, surfaces: &[SceneSurface]) -> Vec<String> {
    let sensors: Vec<_> = file.detectors.iter().map(|detector| sensor(detector, None)).collect();
    let mut before: Vec<Flat<'_>> = surfaces.iter().filter_map(Flat::of_surface).collect();
    let mut doubts = Vec::new();
    for sensor in &sensors {
        let flat = Flat::new(&sensor.name, sensor.frame, sensor.outline(), 0.0);
        if let Some(other) = before.iter().find(|other| other.covers(&flat)) {
            doubts.push(format!(
                "detector {} lies in the plane of {}: where the two coincide, rays meet the latter alone, as in Optiland; \
                 move one by a micrometre",
                quoted(&sensor.name),
                quoted(other.name)
            ));
        }
        before.push(flat);
    }
    doubts
}

/// A flat face.
struct Flat<'a> {
    name: &'a str,
    frame: Frame,
    /// Corners of a polygon within its plane \[mm\]; none if it has no end.
    corners: Vec<DVec2>,
    /// Radius of the hole in its middle \[mm\].
    hole: f64,
}

impl<'a> Flat<'a> {
    fn new(name: &'a str, frame: Frame, outline: Outline, hole: f64) -> Self {
        const CORNERS: u32 = 32;
        let corners = match outline {
            Outline::Infinite => Vec::new(),
            Outline::Rectangle { width, height } => {
                let corner = |x: f64, y: f64| 0.5 * DVec2::new(x * width, y * height);
                vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)]
            }
            Outline::Disk { radius } => (0..CORNERS)
                .map(|i| {
                    DVec2::from_angle(f64::from(i) * std::f64::consts::TAU / f64::from(CORNERS)) * radius
                })
                .collect(),
        };
        Flat { name, frame, corners, hole }
    }

    fn of_surface(surface: &'a SceneSurface) -> Option<Self> {
        let (outline, hole, z) = match surface.shape {
            Shape::Conic { curvature: 0.0, aperture_radius, .. } => {
                (Outline::Disk { radius: aperture_radius }, 0.0, 0.0)
            }
            Shape::Plane(outline) => (outline, 0.0, 0.0),
            Shape::Annulus { inner_radius, outer_radius, z_offset } => {
                (Outline::Disk { radius: outer_radius }, inner_radius, z_offset)
            }
            Shape::Conic { .. } | Shape::Frustum { .. } | Shape::Sphere { .. } | Shape::Mesh(_) => {
                return None;
            }
        };
        Some(Flat::new(&surface.name, super::frame::shifted(&surface.frame, z), outline, hole))
    }

    /// True if the two lie in one plane, within rounding, and have an area in common.
    fn covers(&self, other: &Flat<'_>) -> bool {
        const ROUNDINGS: f64 = 16.0 * f64::EPSILON;
        let (apart, normal) = (other.frame.origin - self.frame.origin, self.frame.rotation.z_axis);
        let size = self.frame.origin.abs().max(other.frame.origin.abs()).max_element().max(1.0);
        let is_parallel = normal.cross(other.frame.rotation.z_axis).length() <= ROUNDINGS;
        if !is_parallel || normal.dot(apart).abs() > ROUNDINGS * size {
            return false;
        }
        let local = |point: DVec3| (self.frame.rotation.transpose() * (point - self.frame.origin)).truncate();
        let corners: Vec<DVec2> = other
            .corners
            .iter()
            .map(|c| local(other.frame.origin + other.frame.rotation * c.extend(0.0)))
            .collect();
        let fits_the_hole = !corners.is_empty() && corners.iter().all(|corner| corner.length() <= self.hole);
        !fits_the_hole && overlap(&self.corners, &corners, ROUNDINGS * size)
    }
}

/// True if two convex polygons have an area in common: no edge of either has all of the other beyond it, within a rounding
/// \[mm\].
fn overlap(a: &[DVec2], b: &[DVec2], rounding: f64) -> bool {
    let separates = |edges: &[DVec2], others: &[DVec2]| {
        let around: f64 = pairs(edges).map(|(from, to)| from.perp_dot(to)).sum();
        pairs(edges).any(|(from, to)| {
            let edge = (to - from) * around.signum();
            let touch = edge.length() * (rounding + 1e-12 * edge.length());
            others.iter().all(|point| edge.perp_dot(*point - from) <= touch)
        })
    };
    a.is_empty() || b.is_empty() || !(separates(a, b) || separates(b, a))
}

fn pairs(corners: &[DVec2]) -> impl Iterator<Item = (DVec2, DVec2)> {
    corners.iter().copied().zip(corners.iter().copied().cycle().skip(1))
}

// Sources

/// Places of a Gaussian beam are drawn until one lies within its radius, but no more than 32 times, as in Optiland; then the
/// ray starts on the rim. Each draw lies beyond the radius with a probability of exp(-R^2 / 2 sigma^2).
fn rays_on_the_rim(source: &Source) -> Option<String> {
    /// That of shaders/emitters/collimated_gaussian.wgsl.
    const ATTEMPTS: f64 = 32.0;
    /// Fewer are lost in the noise of a million rays and more.
    const SHARE: f64 = 1e-6;
    let Source::Collimated(beam) = source else { return None };
    let sigma = beam.gaussian_sigma.unwrap_or(0.5 * beam.aperture_radius);
    let share = (-0.5 * ATTEMPTS * (beam.aperture_radius / sigma).powi(2)).exp();
    (beam.profile == Profile::Gaussian && share > SHARE).then(|| {
        format!(
            "source {} has a gaussian_sigma of {sigma} mm in a radius of {} mm: {} % of its rays start on the rim, because \
             their places are drawn no more than {ATTEMPTS} times, as in Optiland; a tophat profile or a smaller \
             gaussian_sigma has none there",
            quoted(&beam.name),
            beam.aperture_radius,
            significant(100.0 * share, 2)
        )
    })
}

// Sampling

/// A branch that is never drawn is missing in the result, whatever weight the other has.
fn one_branch(file: &SceneFile, surfaces: &[SceneSurface]) -> Option<String> {
    surfaces.iter().find(|surface| surface.interaction == Interaction::Refractive)?;
    let missing = match file.nsq_gpu.as_ref()?.sampling.reflect_prob {
        ReflectProb::Constant(0.0) => "reflection",
        ReflectProb::Constant(1.0) => "transmission",
        ReflectProb::Constant(_) | ReflectProb::Fresnel | ReflectProb::Auto => return None,
    };
    Some(format!(
        "with this reflect_prob no ray takes the {missing} of a refractive surface, beyond its first split_depth events: that \
         light is missing, and booked as importance loss"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;

    #[test]
    fn faces_in_one_plane_overlap_where_they_have_an_area_in_common() {
        let square = Outline::Rectangle { width: 2.0, height: 2.0 };
        let at = |x: f64, z: f64, turn: f64| Frame {
            origin: DVec3::new(x, 0.0, z),
            rotation: DMat3::from_rotation_z(turn),
        };
        let flat = |frame, outline, hole| Flat::new("", frame, outline, hole);
        let middle = flat(at(0.0, 0.0, 0.0), square, 0.0);
        for (frame, outline, covered) in [
            (at(0.0, 0.0, 0.0), square, true),
            (at(1.9, 0.0, 0.0), square, true),
            (at(2.0, 0.0, 0.0), square, false),
            (at(2.3, 0.0, 0.785), square, true),
            (at(2.5, 0.0, 0.785), square, false),
            (at(0.0, 1e-9, 0.0), square, false),
            (at(50.0, 0.0, 0.0), Outline::Infinite, true),
            (at(5.0, 0.0, 0.0), Outline::Disk { radius: 3.9 }, false),
            (at(5.0, 0.0, 0.0), Outline::Disk { radius: 4.1 }, true),
        ] {
            let other = flat(frame, outline, 0.0);
            assert_eq!(middle.covers(&other), covered, "{frame:?} {outline:?}");
            assert_eq!(other.covers(&middle), covered, "{frame:?} {outline:?}");
        }
        let ring = flat(at(0.0, 0.0, 0.0), Outline::Disk { radius: 9.0 }, 1.5);
        assert!(!ring.covers(&middle));
        assert!(ring.covers(&flat(at(1.0, 0.0, 0.0), square, 0.0)));
        let turned = Frame { origin: DVec3::ZERO, rotation: DMat3::from_rotation_x(1e-6) };
        assert!(!middle.covers(&flat(turned, square, 0.0)));
        let flipped = Frame { origin: DVec3::ZERO, rotation: DMat3::from_rotation_x(std::f64::consts::PI) };
        assert!(middle.covers(&flat(flipped, square, 0.0)));
    }
}
