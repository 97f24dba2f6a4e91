//! What a scene may say without its user meaning it: it is traced as it is written, with a warning.

use std::collections::{HashMap, HashSet};

use crate::format::significant;
use crate::model::key_path::quoted;
use crate::model::{Interaction, Medium, MediumId, Mesh};
use crate::scene::coincidence;
use crate::scene::json::{Detector, Material, ReflectProb, SceneFile};
use crate::scene::materials::listed;
use crate::scene::media::MediaTable;
use crate::scene::surfaces::SceneSurface;

/// Everything that deserves a warning once all surfaces are known.
pub(super) fn of(
    file: &SceneFile,
    surfaces: &[SceneSurface],
    meshes: &[Mesh],
    media: &MediaTable,
    wavelengths: &[f64],
) -> Vec<String> {
    let mut warnings: Vec<String> = surfaces.iter().filter_map(of_bsdf).collect();
    warnings.extend(open_media(file, surfaces, media));
    warnings.extend(file.detectors.iter().filter_map(|detector| wavelengths_beyond(detector, wavelengths)));
    warnings.extend(coincidence::warnings(file, surfaces, meshes, media));
    warnings.extend(one_branch(file, surfaces));
    warnings.extend(surfaces.iter().filter_map(|surface| metal(surface, media)));
    warnings.extend(file.sources.iter().filter_map(|source| source.kind().warning(source.name())));
    warnings
}

/// What deserves a warning where a scene is traced in f32.
pub(super) fn of_f32(surfaces: &[SceneSurface]) -> Vec<String> {
    surfaces.iter().filter_map(terms_beyond_f32).collect()
}

/// The same warning of several things is one, with their names: a lens may have ten faces of one roughness.
pub(super) fn grouped(warnings: Vec<String>) -> Vec<String> {
    let mut groups: Vec<(String, Vec<String>)> = Vec::new();
    let mut by_rest: HashMap<String, usize> = HashMap::new();
    for warning in warnings {
        let parts: Vec<&str> = warning.splitn(3, '"').collect();
        let [before, name, after] = parts[..] else {
            groups.push((warning, Vec::new()));
            continue;
        };
        let rest = format!("{before}\"\"{after}");
        match by_rest.get(&rest) {
            Some(&group) if groups[group].0 == warning => {}
            Some(&group) => groups[group].1.push(format!("\"{name}\"")),
            None => {
                by_rest.insert(rest, groups.len());
                groups.push((warning, Vec::new()));
            }
        }
    }
    let text = |(first, others): (String, Vec<String>)| match others.is_empty() {
        true => first,
        false => format!("{first}; the same holds for {}", listed(&others)),
    };
    groups.into_iter().map(text).collect()
}

// Scattering

fn of_bsdf(surface: &SceneSurface) -> Option<String> {
    surface.scatter.as_ref()?.bsdf.warning(&surface.name, &surface.interaction)
}

// Shapes

/// Polynomials of a high order may have terms far larger than their sum.
fn terms_beyond_f32(surface: &SceneSurface) -> Option<String> {
    /// Largest error of a height in f32 that deserves no word \[mm\].
    const LARGEST: f64 = 1e-4;
    let error = surface.shape.terms_size() * f64::from(f32::EPSILON);
    (error > LARGEST).then(|| {
        format!(
            "the terms of {} add up to far more than its height: in f32 that is off by up to {error:.1e} mm; trace it in f64 or df64",
            quoted(&surface.name)
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
    let is_single = |medium: &Material| {
        let id = media.id(medium);
        *medium != Material::Vacuum && num_faces.get(&id) == Some(&1) && !of_sources.contains(&id)
    };
    let bounds = |surface: &&SceneSurface| {
        surface.interaction == Interaction::Refractive && surface.front != surface.back
    };
    let open = surfaces.iter().filter(bounds).filter(|surface| !surface.shape.is_closed());
    open.flat_map(|surface| [(surface, &surface.front), (surface, &surface.back)])
        .filter(|(_, medium)| is_single(medium))
        .map(|(surface, medium)| {
            format!(
                "{} alone borders on {}: if that is a solid, the face where light leaves it has lost its medium",
                quoted(&surface.name),
                quoted(medium.name())
            )
        })
        .collect()
}

// Detectors

fn wavelengths_beyond(detector: &Detector, wavelengths: &[f64]) -> Option<String> {
    let [low, high] = detector.band()?;
    let beyond: Vec<String> = wavelengths
        .iter()
        .filter(|wavelength| !(low..=high).contains(wavelength))
        .map(f64::to_string)
        .collect();
    (!beyond.is_empty()).then(|| {
        format!(
            "detector {} counts light of {} um in its first or last bin, though its bins reach from {low} to {high} um, as \
             in Optiland",
            quoted(detector.name()),
            listed(&beyond),
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
         light is missing, and counted as importance loss"
    ))
}

/// A face between media of which one absorbs so much that the reflectance is not Fresnel's of n alone.
fn metal(surface: &SceneSurface, media: &MediaTable) -> Option<String> {
    /// A reflectance at normal incidence that is off by less is no metal's.
    const OFF: f64 = 0.01;
    if surface.interaction != Interaction::Refractive || surface.coating.is_some() {
        return None;
    }
    let [front, back] = [media.id(&surface.front)?, media.id(&surface.back)?].map(|id| &media.media[id]);
    let number = |medium: &Medium, i: usize| Some((*medium.n.get(i)?, *medium.k.get(i)?));
    (0..front.n.len()).find_map(|i| {
        let ((n1, k1), (n2, k2)) = (number(front, i)?, number(back, i)?);
        let by_n = ((n1 - n2) / (n1 + n2)).powi(2);
        let right = ((n1 - n2).powi(2) + (k1 - k2).powi(2)) / ((n1 + n2).powi(2) + (k1 + k2).powi(2));
        (right - by_n > OFF).then(|| {
            let metal = if k2 > k1 { back } else { front };
            format!(
                "{} reflects {} % at normal incidence, for a refractive face takes the index n of {} alone; with its k of {} the face would reflect {} %: make it a mirror of that reflectance, or give it a coating",
                quoted(&surface.name),
                significant(100.0 * by_n, 3),
                quoted(&metal.name),
                significant(k1.max(k2), 3),
                significant(100.0 * right, 3)
            )
        })
    })
}

#[cfg(test)]
mod tests {
    use super::grouped;
    use crate::Scene;
    use crate::model::Precision;
    use serde_json::json;

    #[test]
    fn the_same_warning_of_several_things_is_one() {
        let of = |names: &[&str]| -> Vec<String> {
            names.iter().map(|name| format!("the lobe of \"{name}\" loses 4 %")).collect()
        };
        let two = "the lobe of \"a\" loses 4 %; the same holds for \"b\"";
        assert_eq!(grouped(of(&["a", "b"])), [two]);
        let others = vec!["\"a\" is open".to_owned(), "no name".to_owned(), "no name".to_owned()];
        assert_eq!(grouped([of(&["a"]), others.clone()].concat()), [of(&["a"]), others].concat());
    }

    /// Aluminium reflects 92 % by n and k, and 7 % by n.
    #[test]
    fn a_metal_that_refracts_is_said() {
        let warnings = |k: f64| {
            let face = json!({"name": "front", "shape": {"type": "plane", "width": 100, "height": 100}, "cs": {},
                "interaction": "refractive", "material_back": {"type": "medium", "name": "metal"}});
            let text = json!({"nsq_schema_version": 1, "components": [],
                "detectors": [{"type": "irradiance", "name": "back", "cs": {"z": -10.0}, "width": 30.0, "height": 30.0}],
                "sources": [{"type": "collimated", "name": "beam", "cs": {"z": -5.0}, "total_flux": 1.0,
                    "spectrum": {"wavelengths": [0.55], "weights": [1.0]}}],
                "nsq_gpu": {"version": 1, "media": {"metal": {"type": "constant", "n": 0.591, "k": k}}, "surfaces": [face]}});
            Scene::from_json(&text.to_string()).unwrap().warnings_in(Precision::F64).join("; ")
        };
        let found = warnings(5.28);
        assert!(found.contains("reflects 6.61 %") && found.contains("would reflect 92.2 %"), "{found}");
        assert!(!warnings(0.01).contains("would reflect"));
    }
}
