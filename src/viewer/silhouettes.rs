//! The scene from the side: its surfaces, detectors and sources as curves in a plane, and the bounds of some of them.

use crate::error::{Error, Result};
use crate::model::key_path::{did_you_mean, quoted};
use crate::model::shapes::{Geometry, circle};
use crate::model::{Frame, Interaction, Mesh, SceneIr};
use crate::scene::path_expression::{glob, is_surface_of};
use crate::viewer::plot::View;
use crate::viewer::settings::Plane;
use glam::DVec3;

/// Points of a curve.
type Curve = Vec<DVec3>;

/// Something in the scene as it appears from the side.
pub struct Silhouette {
    /// The name of the surface, detector or source.
    pub name: String,
    /// What it is.
    pub kind: Kind,
    /// Its curves in the plane \[mm\]. A point is a curve of one point.
    pub curves: Vec<Vec<(f64, f64)>>,
}

/// What stands in a scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs, reason = "the names say it")]
pub enum Kind {
    Refractive,
    Reflective,
    Absorbing,
    Detector,
    Source,
}

/// All that stands somewhere in a scene. The directions of a far-field detector have no place.
pub fn silhouettes(ir: &SceneIr, plane: Plane) -> Vec<Silhouette> {
    let silhouette = |name: String, kind, curves: Vec<Curve>| {
        let project = |curve: Curve| curve.into_iter().map(|point| plane.project(point)).collect();
        Silhouette { name, kind, curves: curves.into_iter().map(project).collect() }
    };
    let surfaces = ir.surfaces.iter().enumerate().map(|(number, surface)| {
        let kind = match surface.interaction {
            Interaction::Refractive => Kind::Refractive,
            Interaction::Reflective { .. } => Kind::Reflective,
            Interaction::Absorbing => Kind::Absorbing,
        };
        let curves = curves(&surface.frame, &*surface.shape, &ir.meshes, plane);
        silhouette(ir.surface_name(number), kind, curves)
    });
    let placed = ir.detectors.iter().filter(|detector| detector.kind.is_placed());
    let detectors = placed.map(|detector| {
        let curves = curves(&detector.frame, &detector.outline(), &[], plane);
        silhouette(detector.name.clone(), Kind::Detector, curves)
    });
    let sources = ir.sources.iter().map(|source| {
        let curves = match source.kind.is_point() {
            true => vec![vec![source.frame.origin]],
            false => curves(&source.frame, &source.kind.births(), &[], plane),
        };
        silhouette(source.name.clone(), Kind::Source, curves)
    });
    surfaces.chain(detectors).chain(sources).collect()
}

/// The least view of all silhouettes with some room around them.
pub fn home(silhouettes: &[Silhouette]) -> View {
    bounds(silhouettes, 1.0).unwrap_or(View::new((-1.0, 1.0), (-1.0, 1.0))).padded(0.06)
}

/// The view of surfaces, elements, sources and detectors of these names. A `*` in a name is any characters.
///
/// # Errors
/// [`Error::Usage`] if nothing of a name has a place in the scene.
pub fn fit(ir: &SceneIr, plane: Plane, names: &[String]) -> Result<View> {
    let all = silhouettes(ir, plane);
    if let Some(name) = names.iter().find(|name| !all.iter().any(|silhouette| silhouette.is_of(name))) {
        return Err(missing(ir, &all, name));
    }
    // A point has room that suits the scene.
    let View { x, y } = home(&all);
    let room = 0.05 * (x.1 - x.0).max(y.1 - y.0);
    let is_fitted = |silhouette: &Silhouette| names.iter().any(|name| silhouette.is_of(name));
    let fitted: Vec<Silhouette> = all.into_iter().filter(is_fitted).collect();
    let none = || Error::Usage("--fit names nothing".into());
    Ok(bounds(&fitted, room).ok_or_else(none)?.padded(0.1))
}

fn missing(ir: &SceneIr, all: &[Silhouette], name: &str) -> Error {
    let mut detectors = ir.detectors.iter();
    if detectors.any(|detector| detector.name == name) {
        let problem = format!(
            "--fit {}: a far-field detector has directions, and no place in the side view",
            quoted(name)
        );
        return Error::Usage(problem);
    }
    let elements = all.iter().filter_map(|silhouette| Some(silhouette.name.rsplit_once('.')?.0));
    let mut known: Vec<&str> =
        elements.chain(all.iter().map(|silhouette| silhouette.name.as_str())).collect();
    known.dedup();
    let advice = did_you_mean(name, known);
    Error::Usage(format!(
        "--fit {}: no element, face, source or detector is called so; {advice}",
        quoted(name)
    ))
}

impl Silhouette {
    /// True if a name or a pattern stands for it, or for the element of the surface.
    fn is_of(&self, name: &str) -> bool {
        match self.kind {
            Kind::Detector | Kind::Source => glob(name, &self.name),
            Kind::Refractive | Kind::Reflective | Kind::Absorbing => is_surface_of(name, &self.name),
        }
    }
}

/// The bounds of silhouettes; none if they have no point. What lies in one plane or on one axis has some area still, and
/// a point has this much room on each side \[mm\].
fn bounds(silhouettes: &[Silhouette], room: f64) -> Option<View> {
    const NONE: (f64, f64) = (f64::INFINITY, f64::NEG_INFINITY);
    let wider = |(low, high): (f64, f64), at: f64| (low.min(at), high.max(at));
    let points = silhouettes.iter().flat_map(|silhouette| silhouette.curves.iter().flatten());
    let (x, y) = points.fold((NONE, NONE), |(x, y), point| (wider(x, point.0), wider(y, point.1)));
    if !(x.0.is_finite() && y.0.is_finite()) {
        return None;
    }
    let size = (x.1 - x.0).max(y.1 - y.0);
    let least = if size > 0.0 { 0.05 * size } else { room };
    let grown =
        |(low, high): (f64, f64)| if high - low < least { (low - least, high + least) } else { (low, high) };
    Some(View::new(grown(x), grown(y)))
}

/// A surface as curves: its section with the plane through its axis that faces the viewer, its rims and its edges.
fn curves(frame: &Frame, shape: &dyn Geometry, meshes: &[Mesh], plane: Plane) -> Vec<Curve> {
    let radial = radial(frame, plane);
    let section = shape.section().into_iter();
    let section = section.map(|curve| curve.iter().map(|p| radial * p.x + DVec3::Z * p.y).collect());
    // Seen from the side, a rim is a line through the surface, which would only hide the surface's shape.
    let (across, up) = plane.project(frame.rotation * DVec3::Z);
    let from_the_side = across.hypot(up) > 0.95;
    let rims = shape.rims().into_iter().filter(|_| !from_the_side).map(|(radius, z)| circle(radius, z));
    let curves = section.chain(rims).chain(shape.edges(meshes));
    curves.map(|curve: Curve| placed(frame, &curve)).collect()
}

fn placed(frame: &Frame, curve: &[DVec3]) -> Curve {
    curve.iter().map(|&point| frame.rotation * point + frame.origin).collect()
}

/// The local direction, at a right angle to the axis, that appears longest along the vertical of the view.
fn radial(frame: &Frame, plane: Plane) -> DVec3 {
    let along = |axis: DVec3| plane.project(frame.rotation * axis);
    // The combination of local x and y with the largest part along the vertical, then along the horizontal.
    let ((hx, vx), (hy, vy)) = (along(DVec3::X), along(DVec3::Y));
    let vertical = DVec3::new(vx, vy, 0.0);
    let horizontal = DVec3::new(hx, hy, 0.0);
    let best = if vertical.length() >= horizontal.length() - 1e-9 { vertical } else { horizontal };
    best.try_normalize().unwrap_or(DVec3::Y)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn ir(scene: &str) -> SceneIr {
        crate::Scene::from_path(format!("scenes/{scene}.json").as_ref()).unwrap().lower().unwrap()
    }

    fn fitted(ir: &SceneIr, plane: Plane, names: &[&str]) -> Result<View> {
        let names: Vec<String> = names.iter().map(|name| (*name).to_string()).collect();
        fit(ir, plane, &names)
    }

    /// A range without the room of a tenth on each side.
    fn bare((low, high): (f64, f64)) -> (f64, f64) {
        let pad = (high - low) / 12.0;
        (low + pad, high - pad)
    }

    fn is_close(found: (f64, f64), expected: (f64, f64)) -> bool {
        (found.0 - expected.0).abs() < 1e-9 && (found.1 - expected.1).abs() < 1e-9
    }

    #[test]
    fn a_fitted_view_holds_what_the_file_says() {
        let ir = ir("searchlight");
        // The pane stands at z = -30 mm, 5 mm thick, with a radius of 60 mm, and is turned by 0.05 about y. It is thin: it
        // has 6 mm of room.
        let (sin, cos) = 0.05_f64.sin_cos();
        for names in [&["window"][..], &["window.front", "window.back"], &["win*"]] {
            let view = fitted(&ir, Plane::ZY, names).unwrap();
            assert!(is_close(bare(view.x), (-36.0, -24.0 + 5.0 * cos)), "{names:?} {view:?}");
            assert!(is_close(bare(view.y), (-60.0, 60.0)), "{names:?} {view:?}");
        }
        let both = fitted(&ir, Plane::ZX, &["window", "behind"]).unwrap();
        assert!(is_close(bare(both.x), (-30.0 - 60.0 * sin, 75.0)), "{both:?}");
        assert!(is_close(bare(both.y), (-100.0, 100.0)), "{both:?}");
        // From the front, too.
        let front = fitted(&ir, Plane::XY, &["behind"]).unwrap();
        assert!(is_close(bare(front.x), (-100.0, 100.0)) && is_close(bare(front.y), (-100.0, 100.0)));
    }

    #[test]
    fn a_name_that_does_not_exist_is_answered() {
        let ir = ir("searchlight");
        for (name, words) in [
            ("windwo", "did you mean `window`?"),
            ("window.fornt", "did you mean `window.front`?"),
            ("behinf", "did you mean `behind`?"),
            ("arcs", "did you mean `arc`?"),
            ("beam", "no place in the side view"),
            ("", "known here: "),
        ] {
            let said = fitted(&ir, Plane::ZY, &["window", name]).unwrap_err().to_string();
            assert!(said.contains(words) && said.contains(&quoted(name)), "{name}: {said}");
        }
    }
}
