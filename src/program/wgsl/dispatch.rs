//! Dispatch over the kinds that occur in a scene: of detectors, sources, BSDFs and shapes.

use crate::error::Result;
use crate::model::shapes::Normal;
use crate::model::shapes::plane::FLAT;
use crate::model::{BsdfKind, ReflectProb, ShapeKind, SourceFunction};
use crate::program::layout::reals::literal;
use crate::program::wgsl::composition::Composition;
use std::fmt::Write;

impl Composition<'_> {
    /// Dispatch over all kinds but shapes, which belong to the search.
    pub(super) fn dispatch(&self) -> Result<String> {
        let others = [self.record(), self.emit(), self.sample_bsdf(), self.reflect_probability()?];
        Ok(self.normal_by_kind() + &others.concat())
    }

    /// Dispatch over the kinds of shapes that have a function for their normal. The other shapes are quadrics.
    fn normal_by_kind(&self) -> String {
        let head = "fn quadric_normal(surface: Surface, position: vec3<real>) -> vec3<real> {\n";
        let of_quadric = "    return normal_of_quadric(surface, position);\n}\n";
        if !self.features.has_own_normals() {
            return format!("{head}{of_quadric}");
        }
        let mut text = String::from(head);
        text.push_str(
            "    let origin = vec3<real>(surface.origin_x, surface.origin_y, surface.origin_z);\n    \
             let p = to_surface(surface, position - origin);\n",
        );
        for kind in self.features.shapes.iter().filter(|kind| kind.has_own_normal()) {
            let arguments: String = (0..kind.num_arguments()).map(|i| format!(", surface.a{i}")).collect();
            let (code, function) = (kind.code(), kind.function("normal"));
            let normal = format!("from_surface(surface, {function}(p{arguments}))");
            let _ = writeln!(text, "    if surface.shape == {code}u {{ return {normal}; }}");
        }
        text + of_quadric
    }

    /// Dispatch over the kinds of detectors.
    fn record(&self) -> String {
        let mut text = String::from("fn record(ray: Ray, detector: Detector, index: u32, ends: bool) {\n");
        for function in &self.features.detectors {
            let (code, name) = (function.code(), function.name());
            let index = if function.stores_rays() { "index, " } else { "" };
            let call = format!("record_{name}(ray, detector, {index}ends)");
            let _ = writeln!(text, "    if detector.kind == {code}u {{ {call}; }}");
        }
        text.push_str("}\n");
        text
    }

    /// Dispatch over the kinds of sources.
    fn emit(&self) -> String {
        let Some((last, others)) = self.features.sources.split_last() else {
            return String::new();
        };
        let mut text = String::from("fn emit(key: RayKey, e: Source) -> LocalRay {\n");
        for kind in others {
            let (code, name) = (*kind as u32, kind.name());
            let _ = writeln!(text, "    if e.kind == {code}u {{ return emit_{name}(key, e); }}");
        }
        let _ = writeln!(text, "    return emit_{}(key, e);\n}}", last.name());
        if self.features.uploads_rays() {
            let code = SourceFunction::StreamedRays as u32;
            let _ = writeln!(
                text,
                "fn has_uploaded_rays(e: Source) -> bool {{\n    return e.kind == {code}u;\n}}"
            );
        }
        text
    }

    /// Dispatch over the kinds of BSDFs: over what draws a direction and, where rays scatter towards targets, over what says how
    /// it is drawn (shaders/scatter_to).
    fn sample_bsdf(&self) -> String {
        let kinds = &self.features.bsdfs;
        let sample = |name: &str| format!("sample_{name}(s, surface)");
        if !self.features.scatters_to {
            return by_bsdf(kinds, "plain_sample_bsdf(s: Scattering, surface: Surface) -> Lobe", sample);
        }
        let draws = by_bsdf(kinds, "bsdf_lobe(s: Scattering, surface: Surface) -> Lobe", sample);
        let towards = kinds.iter().filter(|kind| !kind.wgsl().toward.is_empty());
        let towards: Vec<BsdfKind> = towards.copied().collect();
        let head = "bsdf_toward(s: Scattering, surface: Surface, direction: vec3<real>) -> Toward";
        let call = |name: &str| format!("toward_{name}(s, surface, direction)");
        draws + &by_bsdf(&towards, head, call)
    }

    /// The probability with which reflection is drawn, where that is not the reflectance itself.
    fn reflect_probability(&self) -> Result<String> {
        if !self.features.importance {
            return Ok(String::new());
        }
        let probability = match self.ir.sampling.reflect_prob {
            ReflectProb::Fresnel => "reflectance".into(),
            ReflectProb::Auto => "clamp(reflectance, 0.25, 0.75)".into(),
            ReflectProb::Constant(p) => literal(p, self.precision())?,
        };
        Ok(format!("fn reflect_probability(reflectance: real) -> real {{\n    return {probability};\n}}\n"))
    }
}

/// A function that calls one for the kind of the surface's BSDF, the last kind without a test. Empty where there is no
/// kind.
fn by_bsdf(kinds: &[BsdfKind], head: &str, call: impl Fn(&str) -> String) -> String {
    let Some((last, others)) = kinds.split_last() else {
        return String::new();
    };
    let mut text = format!("fn {head} {{\n");
    for kind in others {
        let _ =
            writeln!(text, "    if surface.bsdf == {}u {{ return {}; }}", *kind as u32, call(kind.name()));
    }
    let _ = writeln!(text, "    return {};\n}}", call(last.name()));
    text
}

/// A `Quadric` in WGSL that gives the distance of a point `o` from a shape with these arguments. A shape that is no
/// quadric gets a plane, at the shape's height above the point.
pub(super) fn quadric_of(kind: ShapeKind, o: &str, arguments: &str) -> String {
    match kind.wgsl().normal {
        Normal::Quadric(quadric) => quadric(&arguments.split(", ").collect::<Vec<_>>()),
        Normal::Facet => FLAT.into(),
        Normal::Own | Normal::Sag => {
            let height = kind.function("height");
            format!("Quadric(0.0, 0.0, 1.0, 2.0 * ({height}({o}, {arguments}) - ({o}).z))")
        }
    }
}

/// A function with the head `head`, which returns the result of `call` for the kind of its primitive `p`. `call` gets
/// the kind and the primitive's arguments. For other kinds the result is `otherwise`; if there is only one kind, the
/// kind is not tested.
pub(super) fn by_kind(
    head: &str,
    kinds: &[ShapeKind],
    otherwise: &str,
    call: impl Fn(ShapeKind, &str) -> String,
) -> String {
    let call = |kind: ShapeKind| {
        let arguments: String = (0..kind.num_arguments()).map(|i| format!(", p.a{i}")).collect();
        call(kind, &arguments)
    };
    if let [kind] = kinds {
        return format!("{head} {{\n    return {};\n}}\n", call(*kind));
    }
    let mut text = format!("{head} {{\n    switch p.shape {{\n");
    for kind in kinds {
        let _ = writeln!(text, "        case {}u: {{ return {}; }}", kind.code(), call(*kind));
    }
    let _ = writeln!(text, "        default: {{ return {otherwise}; }}\n    }}\n}}");
    text
}
