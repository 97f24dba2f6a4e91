//! What `nsq-gpu check` says of a scene beside its warnings: sizes, sides, and how surfaces scatter.

use std::fmt::Write;

use glam::DVec3;

use crate::format::{MOST_NAMES, listed, shown, significant, thousands};
use crate::model::shapes::FrontSide;
use crate::model::sides::{Disagreement, MOST_WORK, SideFaults, wrong_sides};
use crate::model::surface_optics::reflectance;
use crate::model::{Bsdf, Frame, Interaction, Scatter, SceneIr, Shape, Surface};

/// Everything that deserves a note.
pub fn of(ir: &SceneIr) -> Vec<String> {
    let mut notes = of_sides(ir, &wrong_sides(ir, MOST_WORK));
    notes.extend(ir.surfaces.iter().flat_map(of_scattering));
    notes
}

// Sides

/// What is wrong with the sides of a scene, and what would be right.
pub fn of_sides(ir: &SceneIr, found: &SideFaults) -> Vec<String> {
    let mut notes: Vec<String> = found.turned.iter().map(|group| turned(ir, group)).collect();
    let more = found.disagreements.len().saturating_sub(MOST_NAMES);
    notes.extend(found.disagreements.iter().take(MOST_NAMES).map(|one| disagreement(ir, one)));
    if more > 0 {
        notes.push(format!(
            "the sides of {} more faces do not agree with what is before them",
            thousands(more as u64)
        ));
    }
    if found.num_unseen > 0 {
        let num = thousands(found.num_unseen as u64);
        notes.push(format!("the sides of {num} faces were not looked at, because the scene is large"));
    }
    notes
}

fn turned(ir: &SceneIr, group: &[usize]) -> String {
    let is_mesh = |&i: &usize| ir.surfaces[i].shape.mesh().is_some();
    let or_mesh = if group.iter().any(is_mesh) { ", or turn the triangles of the mesh" } else { "" };
    let cure = format!("exchange material_front and material_back{or_mesh}; --sides prints what lies where");
    match group {
        [face] => format!(
            "{} is turned inside out: its media are on the wrong sides of it, against all faces about it; {cure}",
            name(ir, *face)
        ),
        faces => format!(
            "the solid of {} is inside out: its faces agree with each other, and not with what is about them; {cure}, of each",
            listed(faces.iter().map(|&face| name(ir, face)))
        ),
    }
}

fn disagreement(ir: &SceneIr, &Disagreement { from, medium, to }: &Disagreement) -> String {
    let medium_name = |medium: usize| shown(&ir.media[medium].name);
    let start = format!("on one side of {} lies {}", name(ir, from), medium_name(medium));
    match to {
        None => format!(
            "{start}. Light that goes there meets no other face: that solid is open, or the face is turned"
        ),
        Some((to, there)) => format!(
            "{start}. Light that goes there meets {}, and the near side of that face is in {}. A face is missing between the \
             two, or one of them is turned",
            name(ir, to),
            medium_name(there)
        ),
    }
}

fn name(ir: &SceneIr, surface: usize) -> String {
    format!("`{}`", shown(&ir.surface_name(surface)))
}

/// A table of all surfaces: which side is the front, and which media lie in front and behind.
pub fn sides(ir: &SceneIr) -> String {
    let names: Vec<String> = (0..ir.surfaces.len()).map(|i| shown(&ir.surface_name(i))).collect();
    let fronts: Vec<String> =
        ir.surfaces.iter().map(|surface| front_of(&surface.frame, &surface.shape)).collect();
    let width =
        |texts: &[String]| texts.iter().map(|text| text.chars().count()).max().unwrap_or(0).max(8) + 2;
    let (of_names, of_fronts) = (width(&names), width(&fronts));
    let mut text = format!("  {:<of_names$}{:<of_fronts$}in front -> behind\n", "surface", "front");
    for ((surface, name), front) in ir.surfaces.iter().zip(&names).zip(&fronts) {
        let media = [surface.front, surface.back].map(|medium| shown(&ir.media[medium].name));
        let media = match surface.interaction {
            Interaction::Refractive => media.join(" -> "),
            Interaction::Reflective { .. } => format!("{}, a mirror on both sides", media[0]),
            Interaction::Absorbing => format!("{}, absorbs on both sides", media[0]),
        };
        let _ = writeln!(text, "  {name:<of_names$}{front:<of_fronts$}{media}");
    }
    text
}

fn front_of(frame: &Frame, shape: &Shape) -> String {
    match shape.front_side() {
        FrontSide::Outside => "outside".into(),
        FrontSide::Inside => "inside".into(),
        FrontSide::Below => format!("towards {}", direction(-frame.rotation.z_axis)),
    }
}

/// A direction as an axis, or as a vector.
fn direction(d: DVec3) -> String {
    const ROUNDED: f64 = 1e-9;
    let axes = [(d.x, "x"), (d.y, "y"), (d.z, "z")];
    match axes.into_iter().find(|(along, _)| along.abs() > 1.0 - ROUNDED) {
        Some((along, axis)) => format!("{}{axis}", if along > 0.0 { "+" } else { "-" }),
        None => format!("({:.3}, {:.3}, {:.3})", d.x, d.y, d.z),
    }
}

// Scattering

fn of_scattering(surface: &Surface) -> Vec<String> {
    let Some(scatter) = &surface.scatter else { return Vec::new() };
    let mut notes = Vec::new();
    if let Bsdf::Tabulated(tabulated) = &scatter.bsdf {
        notes.push(format!(
            "the table of `{}` has no azimuth: a lobe that was measured about the mirrored ray becomes a ring about the normal",
            shown(&surface.name)
        ));
        let table = &tabulated.table;
        let rows = (0..table.theta_i.len()).map(|row| (table.albedo(row), table.theta_i[row]));
        if let Some((albedo, theta_i)) =
            rows.min_by(|a, b| a.0.total_cmp(&b.0)).filter(|(albedo, _)| *albedo < LEAST_KEPT)
        {
            notes.push(format!(
                "the table of `{}` loses up to {} % of what it is to scatter, at an incidence of {theta_i} degrees: its values \
                 add up to {}",
                shown(&surface.name),
                significant(100.0 * (1.0 - albedo), 3),
                significant(albedo, 3)
            ));
        }
    }
    notes.extend(weak_mirror(surface, scatter));
    notes
}

/// A table that scatters less of what it gets deserves a note.
const LEAST_KEPT: f64 = 0.9;

/// Black paint is often written as a mirror whose BSDF is weak. All that does not scatter is then mirrored.
fn weak_mirror(surface: &Surface, Scatter { fraction, bsdf }: &Scatter) -> Option<String> {
    /// A BSDF of a lower level is weak.
    const WEAK: f64 = 0.2;
    /// A surface that mirrors so much is no black paint.
    const MIRRORS: f64 = 0.5;
    let Interaction::Reflective { .. } = surface.interaction else { return None };
    let level = bsdf.by_tis().map_or(1.0, |(tis, _)| tis);
    let scattered = fraction * if bsdf.keeps_level() { level } else { 1.0 };
    let mirrored = 1.0 - fraction;
    let returned = reflectance(surface, 0) * (mirrored + scattered);
    let is_perfect = reflectance(surface, 0) >= 1.0;
    (is_perfect && fraction * level <= WEAK && returned >= MIRRORS).then(|| {
        let how = match mirrored >= scattered {
            true => format!("{} % without scatter", significant(100.0 * mirrored, 3)),
            false => "all of it in the lobe, whose own level counts with \"scatter_fraction\": \"tis\" alone".into(),
        };
        format!(
            "`{}` is a mirror and no black paint, for its reflectance is 1: {} % of the light comes back, {how}; for paint give \
             the reflectance of the paint, such as 0.05, or \"interaction\": \"absorbing\"",
            shown(&surface.name),
            significant(100.0 * returned, 3)
        )
    })
}

// Sizes

/// Two corners of a box \[mm\].
type Corners = (DVec3, DVec3);

fn corners(ir: &SceneIr, frame: &Frame, shape: &Shape) -> Option<Corners> {
    let extent = shape.extent(&ir.meshes)?;
    let (middle, reach) =
        (frame.rotation * extent.middle + frame.origin, extent.reach_along(&frame.rotation));
    Some((middle - reach, middle + reach))
}

/// How far the scene and each mesh reach.
pub fn extents(ir: &SceneIr) -> Vec<String> {
    let surfaces = ir.surfaces.iter().filter_map(|surface| corners(ir, &surface.frame, &surface.shape));
    let near = ir.detectors.iter().filter(|detector| detector.kind.is_placed());
    let detectors =
        near.filter_map(|detector| corners(ir, &detector.frame, &Shape::Plane(detector.outline())));
    let sources = ir.sources.iter().map(|source| (source.frame.origin, source.frame.origin));
    let all = surfaces.chain(detectors).chain(sources);
    let whole = all.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
    let mut lines: Vec<String> =
        whole.iter().map(|corners| format!("extent: {}", reaching(corners))).collect();
    for surface in ir.surfaces.iter().filter(|surface| surface.shape.mesh().is_some()) {
        let Some(corners) = corners(ir, &surface.frame, &surface.shape) else { continue };
        lines.push(format!("mesh {}: {}", shown(&surface.name), reaching(&corners)));
    }
    lines
}

fn reaching((low, high): &Corners) -> String {
    let number = |value: f64| significant(value, 5);
    let size = (*high - *low).to_array().map(number).join(" x ");
    let axes = ["x", "y", "z"].into_iter().zip(low.to_array().into_iter().zip(high.to_array()));
    let spans: Vec<String> =
        axes.map(|(axis, (low, high))| format!("{axis} {} to {}", number(low), number(high))).collect();
    format!("{size} mm ({})", spans.join(", "))
}
