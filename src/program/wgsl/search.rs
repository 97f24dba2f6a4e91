//! The search for the primitive that a ray meets next: one call a primitive, a loop over a table, or a tree.

use crate::error::Result;
use crate::model::shapes::Quadric;
use crate::model::shapes::plane::FLAT;
use crate::model::{Frame, Shape, ShapeKind};
use crate::program::layout::tables;
use crate::program::wgsl::composition::Composition;
use crate::program::wgsl::dispatch::{by_kind, quadric_of};
use crate::program::wgsl::rows::frame_functions;
use std::fmt::Write;
use std::ops::Range;

impl Composition<'_> {
    /// A scene that is compiled in has one call a primitive, with numbers. A scene in tables has a loop over the
    /// primitives' records, or a tree and the few primitives beside it.
    pub(super) fn nearest_primitive(&self) -> Result<String> {
        let num = self.num_primitives();
        if self.options.baked {
            return self.nearest_in_turn("nearest_primitive", 0..num);
        }
        let mut text = self.nearest_primitive_table();
        if self.tree.is_some() {
            let apart = self.options.tree_primitives(self.ir).end..num;
            text.push_str(&self.nearest_in_turn("nearest_apart", apart)?);
        }
        Ok(text)
    }

    fn nearest_in_turn(&self, name: &str, primitives: Range<usize>) -> Result<String> {
        let candidates = primitives.map(|i| (i, format!("ray.last == {i}u")));
        self.nearest_of(&format!("{name}(ray: Ray, start: Hit)"), "start", None, candidates)
    }

    /// A function that finds the nearest of some primitives, one after the other. Each candidate comes with the
    /// condition that the ray stands on it. If `nearer` is given, that primitive is a conic, and only its nearer
    /// crossing is tested.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] if the precision cannot hold a number.
    pub fn nearest_of(
        &self,
        head: &str,
        start: &str,
        nearer: Option<usize>,
        candidates: impl Iterator<Item = (usize, String)>,
    ) -> Result<String> {
        let primitives = crate::model::primitives::primitives(self.ir);
        let mut text = format!("fn {head} -> Hit {{\n    var best = {start};\n");
        if self.contacts.any() {
            text.push_str("    let here = standing(ray);\n");
        }
        for (i, leaving) in candidates {
            let (frame, shape) = &primitives[i];
            let function = match nearer == Some(i) {
                true => "nearer_conic_distance",
                false => &shape.kind().function("distance"),
            };
            text.push_str(&self.try_primitive(i, frame, shape, function, &leaving)?);
        }
        text.push_str("    return best;\n}\n");
        Ok(text)
    }

    /// The ray's position and direction in the frame of a primitive.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] if the precision cannot hold a number.
    pub fn in_frame(&self, frame: &Frame) -> Result<(String, String)> {
        let v = format!("ray.position - {}", self.vector(frame.origin - self.centre)?);
        if !tables::any_rotated(self.ir, std::iter::once(frame)) {
            return Ok((v, "ray.direction".into()));
        }
        let [x, y, z] = [frame.rotation.x_axis, frame.rotation.y_axis, frame.rotation.z_axis];
        let [x, y, z] = [self.vector(x)?, self.vector(y)?, self.vector(z)?];
        let rotation = format!("Rotation({x}, {y}, {z})");
        Ok((format!("to_local({v}, {rotation})"), format!("to_local(ray.direction, {rotation})")))
    }

    /// Makes a primitive's hit the `best` one if it is nearer. `leaving` is the condition that the ray stands on the
    /// primitive.
    fn try_primitive(
        &self,
        i: usize,
        frame: &Frame,
        shape: &Shape,
        function: &str,
        leaving: &str,
    ) -> Result<String> {
        let kind = ShapeKind::of(shape);
        let farthest = if kind.is_searched() { ", best.distance" } else { "" };
        let mut arguments = String::new();
        for argument in self.places.arguments(shape) {
            let _ = write!(arguments, "{}, ", self.real(argument)?);
        }
        let (o, d) = self.in_frame(frame)?;
        if kind.is_searched() && self.searches_facets() {
            let contact = self.contact_records().row(&self.numbers, i)?;
            let distance = format!("{function}({o}, {d}, {arguments}{leaving}, farthest_from(best))");
            return Ok(format!(
                "    search_facets(ray, here, {contact});\n    \
                 best = nearer_facet(best, ray, {i}u, {distance});\n"
            ));
        }
        let mut leaving = leaving.to_string();
        if self.contacts.is_born_on(i) {
            let quadric = match shape.quadric() {
                Some(Quadric { radial, axial, offset, constant }) => {
                    let [radial, axial, offset] = [self.real(radial)?, self.real(axial)?, self.real(offset)?];
                    format!("Quadric({radial}, {axial}, {offset}, {})", self.real(constant)?)
                }
                None => quadric_of(kind, &o, arguments.trim_end_matches(", ")),
            };
            leaving = format!("({leaving}) | is_born_on(ray, {o}, {quadric})");
        }
        if !self.contacts.touches(i) {
            return Ok(format!(
                "    best = nearer(best, {function}({o}, {d}, {arguments}{leaving}{farthest}), {i}u);\n"
            ));
        }
        let contact = self.contact_records().row(&self.numbers, i)?;
        let holds = kind.function("holds");
        let stands = format!("({leaving}) | stands_on(here, {contact})");
        let elsewhere = format!("{function}({o}, {d}, {arguments}{stands})");
        let holds = format!("{holds}({o}, {})", arguments.trim_end_matches(", "));
        Ok(format!("    best = nearer_in_contact(best, ray, here, {i}u, {contact}, {elsewhere}, {holds});\n"))
    }

    /// The functions with which the loop over a table, or the walk of a tree, tests a primitive.
    fn nearest_primitive_table(&self) -> String {
        let primitives = &crate::model::primitives::primitives(self.ir)[..self.options.num_in_table(self.ir)];
        let rotated = tables::any_rotated(self.ir, primitives.iter().map(|(frame, _)| frame));
        let kinds = ShapeKind::among(primitives.iter().map(|(_, shape)| shape));
        let mut text = frame_functions("Primitive", "primitive", rotated);
        text += &by_kind(
            "fn shape_distance(p: Primitive, o: vec3<real>, d: vec3<real>, leaving: bool, farthest: real) -> real",
            &kinds,
            "MISS",
            |kind, arguments| {
                let farthest = if kind.is_searched() { ", farthest" } else { "" };
                format!("{}(o, d{arguments}, leaving{farthest})", kind.function("distance"))
            },
        );
        if self.contacts.any() {
            let head = "fn shape_holds(p: Primitive, o: vec3<real>) -> bool";
            text += &by_kind(head, &kinds, "false", |kind, a| format!("{}(o{a})", kind.function("holds")));
            let head = "fn shape_quadric(p: Primitive, o: vec3<real>) -> Quadric";
            text += &by_kind(head, &kinds, FLAT, |kind, arguments| {
                quadric_of(kind, "o", arguments.trim_start_matches(", "))
            });
        }
        text
    }

    /// True if facets of meshes are in contact, or sources lie on them.
    pub(super) fn searches_facets(&self) -> bool {
        let is_mesh = |i: usize| self.ir.surfaces.get(i).is_some_and(|s| s.shape.mesh().is_some());
        let births = (0..self.ir.surfaces.len()).any(|i| is_mesh(i) && self.contacts.is_born_on(i));
        births || !self.contacts.facets.is_empty()
    }
}
