//! Compound components -> surfaces, as Optiland builds them: names, order, media, frames.

use crate::model::key_path::key_of;
use crate::model::shapes::conic::curvature;
use crate::model::{Annulus, Conic, Frame, Frustum, Shape};
use crate::scene::frame::{frame_of, shifted};
use crate::scene::json::{
    Component, Compound, CoordinateSystem, Doublet, Interaction, Lens, Material, Mirror, Override,
};
use crate::scene::volume::{self, Face, Leak};
use crate::{Error, Result};

/// A surface of a compound before its interaction is settled.
#[derive(Debug, Clone)]
pub(super) struct Part {
    /// Such as `L1.front`.
    pub name: String,
    pub frame: Frame,
    /// Position of the vertex along the compound's z \[mm\].
    pub z: f64,
    pub shape: Shape,
    pub interaction: Interaction,
    /// Reflectance of the compound, where it has one.
    pub reflectance: Option<f64>,
    pub front: Material,
    pub back: Material,
}

impl Component {
    /// The user's name for it.
    pub fn name(&self) -> &str {
        match self {
            Component::Lens(lens) => &lens.name,
            Component::Mirror(mirror) => &mirror.name,
            Component::Doublet(doublet) => &doublet.name,
        }
    }

    /// Frame of the front vertex.
    pub fn cs(&self) -> &CoordinateSystem {
        match self {
            Component::Lens(lens) => &lens.cs,
            Component::Mirror(mirror) => &mirror.cs,
            Component::Doublet(doublet) => &doublet.cs,
        }
    }

    /// The surfaces of the component, in order.
    pub(super) fn parts(&self) -> Vec<Part> {
        match self {
            Component::Lens(lens) => lens_parts(lens),
            Component::Mirror(mirror) => mirror_parts(mirror),
            Component::Doublet(doublet) => doublet_parts(doublet),
        }
    }

    /// Checks that the surfaces, after overrides, enclose the glass. `place` is the component's.
    pub(super) fn check_closed(&self, parts: &[Part], place: &str) -> Result<()> {
        let config = key_of(place, "config");
        match self {
            Component::Lens(lens) => check_solid(parts.iter(), &lens.name, &config),
            Component::Mirror(_) => Ok(()),
            Component::Doublet(doublet) => {
                let [front, cemented, back, crown, flint] = parts else { return Ok(()) };
                check_solid(
                    [front, cemented, crown].into_iter(),
                    &format!("{}.crown", doublet.name),
                    &config,
                )?;
                check_solid([cemented, back, flint].into_iter(), &format!("{}.flint", doublet.name), &config)
            }
        }
    }
}

impl Part {
    /// Applies what the user changed of the shape.
    pub(super) fn apply(&mut self, change: &Override) {
        if let (Some(radius), Shape::Conic(conic)) = (change.aperture_radius, &mut self.shape) {
            conic.aperture_radius = radius;
        }
        if let Some(interaction) = change.interaction {
            self.interaction = interaction;
        }
    }
}

/// Builds the parts of one compound, whose vertices stand along its z axis.
struct Builder<'a> {
    name: &'a str,
    parts: Vec<Part>,
}

impl Builder<'_> {
    fn refractive(
        &mut self,
        suffix: &str,
        (frame, z): (Frame, f64),
        shape: Shape,
        front: &Material,
        back: &Material,
    ) {
        self.parts.push(Part {
            name: format!("{}.{suffix}", self.name),
            frame,
            z,
            shape,
            interaction: Interaction::Refractive,
            reflectance: None,
            front: front.clone(),
            back: back.clone(),
        });
    }

    fn absorbing(&mut self, suffix: &str, (frame, z): (Frame, f64), shape: Shape) {
        self.parts.push(Part {
            name: format!("{}.{suffix}", self.name),
            frame,
            z,
            shape,
            interaction: Interaction::Absorbing,
            reflectance: None,
            front: Material::Vacuum,
            back: Material::Vacuum,
        });
    }
}

fn conic(radius: f64, conic: f64, aperture_radius: f64) -> Conic {
    Conic { curvature: curvature(radius), conic, aperture_radius }
}

fn cylinder(radius: f64, z_front: f64, z_back: f64) -> Shape {
    Shape::Frustum(Frustum { r_front: radius, r_back: radius, z_front, z_back })
}

fn lens_parts(lens: &Compound<Lens>) -> Vec<Part> {
    /// Apertures that differ by less have no rim between them \[mm\].
    const SAME_RADIUS: f64 = 1e-9;
    let Lens { r1, r2, thickness, material, front_aperture_radius: front_radius, conic1, conic2, .. } =
        &lens.config;
    let back_radius = lens.config.back_aperture_radius.unwrap_or(*front_radius);
    let front = (frame_of(&lens.cs), 0.0);
    let back = (shifted(&front.0, *thickness), *thickness);
    let (front_face, back_face) = (conic(*r1, *conic1, *front_radius), conic(*r2, *conic2, back_radius));
    let (front_sag, back_sag) = (front_face.sag(*front_radius), back_face.sag(back_radius));
    let (narrow, wide) = (front_radius.min(back_radius), front_radius.max(back_radius));

    let mut build = Builder { name: &lens.name, parts: Vec::new() };
    build.refractive("front", front, Shape::Conic(front_face), &Material::Vacuum, material);
    build.refractive("back", back, Shape::Conic(back_face), material, &Material::Vacuum);
    build.absorbing("edge", front, cylinder(wide, front_sag, thickness + back_sag));
    if wide - narrow > SAME_RADIUS {
        let (at, z_offset) = if *front_radius > back_radius { (back, back_sag) } else { (front, front_sag) };
        build.absorbing(
            "rim",
            at,
            Shape::Annulus(Annulus { inner_radius: narrow, outer_radius: wide, z_offset }),
        );
    }
    build.parts
}

fn mirror_parts(mirror: &Compound<Mirror>) -> Vec<Part> {
    let Mirror { radius, reflectance, conic: conic_constant, aperture_radius } = mirror.config;
    vec![Part {
        name: format!("{}.surface", mirror.name),
        frame: frame_of(&mirror.cs),
        z: 0.0,
        shape: Shape::Conic(conic(radius, conic_constant, aperture_radius)),
        interaction: Interaction::Reflective,
        reflectance: Some(reflectance),
        front: Material::Vacuum,
        back: Material::Vacuum,
    }]
}

fn doublet_parts(doublet: &Compound<Doublet>) -> Vec<Part> {
    let config = &doublet.config;
    let radius = config.aperture_radius;
    let total = config.thickness1 + config.thickness2;
    let front = (frame_of(&doublet.cs), 0.0);
    let cemented = (shifted(&front.0, config.thickness1), config.thickness1);
    let back = (shifted(&cemented.0, config.thickness2), total);
    let faces = [(config.r1, config.conic1), (config.r2, config.conic2), (config.r3, config.conic3)];
    let faces = faces.map(|(r, k)| conic(r, k, radius));
    let [rim_front, rim_cemented, rim_back] = faces.map(|face| face.sag(radius));
    let (rim_cemented, rim_back) = (config.thickness1 + rim_cemented, total + rim_back);
    let [face_front, face_cemented, face_back] = faces.map(Shape::Conic);

    let (crown, flint) = (&config.material1, &config.material2);
    let mut build = Builder { name: &doublet.name, parts: Vec::new() };
    build.refractive("front", front, face_front, &Material::Vacuum, crown);
    build.refractive("cemented", cemented, face_cemented, crown, flint);
    build.refractive("back", back, face_back, flint, &Material::Vacuum);
    build.absorbing("edge_crown", front, cylinder(radius, rim_front, rim_cemented));
    build.absorbing("edge_flint", front, cylinder(radius, rim_cemented, rim_back));
    build.parts
}

fn check_solid<'a>(parts: impl Iterator<Item = &'a Part>, solid: &str, place: &str) -> Result<()> {
    let parts: Vec<&Part> = parts.collect();
    let Some(first) = parts.first() else { return Ok(()) };
    let boundary: Vec<Face<'_>> =
        parts.iter().map(|part| Face { name: &part.name, z: part.z, shape: part.shape.clone() }).collect();
    let to_local = first.frame.rotation.transpose();
    volume::check(&boundary, |direction| to_local * direction).map_err(|leak| leaking(&leak, solid, place))
}

fn leaking(leak: &Leak, solid: &str, place: &str) -> Error {
    match leak {
        Leak::Gap { surface, gap } => Error::scene(
            place,
            format!(
                "the surfaces of `{solid}` do not close: the rim of `{surface}` is {gap:.3e} mm from any other"
            ),
            "make the aperture radii of neighbouring surfaces agree",
        ),
        Leak::Parity { crossings } => Error::scene(
            place,
            format!(
                "the surfaces of `{solid}` do not enclose it: a ray from its middle crosses them {crossings} times"
            ),
            "increase the thickness or reduce the aperture radius, so that the faces do not meet before the rim",
        ),
    }
}
