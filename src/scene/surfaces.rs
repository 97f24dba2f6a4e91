//! All surfaces of a scene in the order in which they are tried, with the user's changes applied.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::path::Path;

use glam::DVec3;

use crate::model::bsdfs::{BsdfContext, Labelled};
use crate::model::key_path::{did_you_mean, key_of, quoted};
use crate::model::{self, Frame};
use crate::scene::compounds::Part;
use crate::scene::frame::{frame_of, moved};
use crate::scene::json::{
    Bsdf, Coating, Interaction, Material, Override, RawSurface, Reflectance, ScatterFraction, SceneFile,
};
use crate::scene::meshes::{Meshes, Placed};
use crate::{Error, Result};

/// A surface whose materials are still the user's words.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct SceneSurface {
    pub name: String,
    pub frame: Frame,
    pub shape: model::Shape,
    pub interaction: model::Interaction,
    pub coating: Option<model::Coating>,
    pub scatter: Option<model::Scatter>,
    pub front: Material,
    pub back: Material,
}

/// Builds the surfaces of every component and every single surface, in the scene's order.
pub(super) fn build(
    file: &SceneFile,
    wavelengths: &[f64],
    meshes: &Meshes,
    folder: &Path,
    warnings: &mut Vec<String>,
) -> Result<Vec<SceneSurface>> {
    let reading = &mut BsdfContext { folder, warnings };
    let none = BTreeMap::new();
    let overrides = file.nsq_gpu.as_ref().map_or(&none, |block| &block.overrides);
    let mut groups = Vec::new();
    for (index, component) in file.components.iter().enumerate() {
        let place = format!("components[{index}]");
        let parts = changed(component.parts(), overrides);
        component.check_closed(&parts, &place)?;
        let surfaces: Result<Vec<_>> =
            parts.into_iter().map(|part| finish(part, overrides, wavelengths, reading)).collect();
        groups.push((component.name(), surfaces?));
    }
    for (index, raw) in file.nsq_gpu.iter().flat_map(|block| &block.surfaces).enumerate() {
        let place = format!("nsq_gpu.surfaces[{index}]");
        groups.push((&raw.name, vec![single(raw, &place, wavelengths, meshes.placed(index), reading)?]));
    }
    check_labels(&groups)?;
    warn_of_idle_reflectance(file, &groups, reading.warnings);
    reading.warnings.extend(groups.iter().flat_map(|(_, surfaces)| surfaces).filter_map(overreach));
    check_override_names(file, overrides)?;
    match file.nsq_gpu.as_ref().and_then(|block| block.order.as_ref()) {
        Some(order) => in_order(groups, order),
        None => Ok(groups.into_iter().flat_map(|(_, surfaces)| surfaces).collect()),
    }
}

fn changed(mut parts: Vec<Part>, overrides: &BTreeMap<String, Override>) -> Vec<Part> {
    for part in &mut parts {
        if let Some(change) = overrides.get(&part.name) {
            part.apply(change);
        }
    }
    parts
}

/// Settles the interaction of a part. Like Optiland's, a surface that does not transmit has its front medium on both
/// sides.
fn finish(
    part: Part,
    overrides: &BTreeMap<String, Override>,
    wavelengths: &[f64],
    reading: &mut BsdfContext<'_>,
) -> Result<SceneSurface> {
    let place = key_of("nsq_gpu.overrides", &part.name);
    let change = overrides.get(&part.name);
    let own = part.reflectance.map(Reflectance::Constant);
    let finish = Finish {
        kind: part.interaction,
        reflectance: change.and_then(|change| change.reflectance.as_ref()),
        default_reflectance: own.as_ref(),
        coating: change.and_then(|change| change.coating.as_ref()),
        bsdf: change.and_then(|change| change.bsdf.as_ref()),
        scatter_fraction: change.and_then(|change| change.scatter_fraction).unwrap_or_default(),
    };
    let interaction = finish.interaction(&place, wavelengths)?;
    let back = if part.interaction == Interaction::Refractive { part.back } else { part.front.clone() };
    Ok(SceneSurface {
        name: part.name.clone(),
        frame: part.frame,
        shape: part.shape,
        interaction,
        coating: finish.coating(&place, wavelengths)?,
        scatter: finish.scatter(&part.name, &place, reading)?,
        front: part.front,
        back,
    })
}

fn single(
    raw: &RawSurface,
    place: &str,
    wavelengths: &[f64],
    mesh: Option<Placed>,
    reading: &mut BsdfContext<'_>,
) -> Result<SceneSurface> {
    let finish = Finish {
        kind: raw.interaction,
        reflectance: raw.reflectance.as_ref(),
        default_reflectance: None,
        coating: raw.coating.as_ref(),
        bsdf: raw.bsdf.as_ref(),
        scatter_fraction: raw.scatter_fraction,
    };
    let refractive = raw.interaction == Interaction::Refractive;
    if !refractive && ![&Material::Vacuum, &raw.material_front].contains(&&raw.material_back) {
        reading.warnings.push(format!(
            "the material_back of {} is ignored, because its interaction is not `refractive`",
            quoted(&raw.name)
        ));
    }
    Ok(SceneSurface {
        name: raw.name.clone(),
        frame: moved(&frame_of(&raw.cs), mesh.map_or(DVec3::ZERO, |mesh| mesh.centre)),
        shape: raw.shape.shape(&key_of(place, "shape"), mesh.map(|mesh| mesh.mesh))?,
        interaction: finish.interaction(place, wavelengths)?,
        coating: finish.coating(place, wavelengths)?,
        scatter: finish.scatter(&raw.name, place, reading)?,
        front: raw.material_front.clone(),
        back: if refractive { raw.material_back.clone() } else { raw.material_front.clone() },
    })
}

/// What the user wrote of a surface's finish.
struct Finish<'a> {
    kind: Interaction,
    reflectance: Option<&'a Reflectance>,
    /// The reflectance of the component, where the surface is given none.
    default_reflectance: Option<&'a Reflectance>,
    coating: Option<&'a Coating>,
    bsdf: Option<&'a Bsdf>,
    scatter_fraction: ScatterFraction,
}

impl Finish<'_> {
    fn interaction(&self, place: &str, wavelengths: &[f64]) -> Result<model::Interaction> {
        Ok(match self.kind {
            Interaction::Refractive => model::Interaction::Refractive,
            Interaction::Absorbing => model::Interaction::Absorbing,
            Interaction::Reflective => {
                model::Interaction::Reflective { reflectance: self.mirror_reflectance(place, wavelengths)? }
            }
        })
    }

    /// A mirror's reflectance is given as such, or by a coating; the component's own comes last.
    fn mirror_reflectance(&self, place: &str, wavelengths: &[f64]) -> Result<Vec<f64>> {
        let coating_place = key_of(place, "coating");
        if self.reflectance.is_some() && self.coating.is_some() {
            return Err(Error::scene(
                coating_place,
                "the mirror has both a reflectance and a coating",
                "give one of the two",
            ));
        }
        if let Some(coating) = self.coating {
            let coating = coating.at(wavelengths, &coating_place)?;
            // A table has the reflectance by angle.
            let reflectance = coating.simple().map(|simple| simple.reflectance.clone());
            return Ok(reflectance.unwrap_or_else(|| vec![1.0; wavelengths.len()]));
        }
        let place = key_of(place, "reflectance");
        match self.reflectance.or(self.default_reflectance) {
            Some(reflectance) => reflectance.at(wavelengths, &place),
            None => Err(Error::scene(
                place,
                "a reflective surface has no reflectance",
                "give a number in [0, 1] or a table; there is no default",
            )),
        }
    }

    /// A mirror takes a simple coating as its reflectance.
    fn coating(&self, place: &str, wavelengths: &[f64]) -> Result<Option<model::Coating>> {
        match (self.kind, self.coating) {
            (Interaction::Refractive, Some(coating))
            | (Interaction::Reflective, Some(coating @ Coating::Tabulated(_))) => {
                coating.at(wavelengths, &key_of(place, "coating")).map(Some)
            }
            (Interaction::Refractive | Interaction::Reflective | Interaction::Absorbing, _) => Ok(None),
        }
    }

    /// An absorbing surface scatters nothing, as in Optiland.
    fn scatter(
        &self,
        name: &str,
        place: &str,
        reading: &mut BsdfContext<'_>,
    ) -> Result<Option<model::Scatter>> {
        let absorbs = self.kind == Interaction::Absorbing;
        for (what, given) in [("BSDF", self.bsdf.is_some()), ("coating", self.coating.is_some())] {
            if absorbs && given {
                reading
                    .warnings
                    .push(format!("the {what} of {} is ignored, because it is `absorbing`", quoted(name)));
            }
        }
        match (self.bsdf, self.scatter_fraction) {
            (None, ScatterFraction::Constant(fraction)) if fraction < 1.0 => reading.warnings.push(format!(
                "the scatter_fraction of {} changes nothing, because it has no `bsdf`",
                quoted(name)
            )),
            (None, ScatterFraction::Tis) => {
                return Err(Error::scene(
                    key_of(place, "scatter_fraction"),
                    "`tis` is the total integrated scatter of a BSDF, and the surface has none",
                    "give a `bsdf`, or remove scatter_fraction",
                ));
            }
            _ => {}
        }
        match self.bsdf {
            Some(bsdf) if !absorbs => {
                let surface = Labelled { name, place: &key_of(place, "bsdf") };
                let bsdf = bsdf.bsdf(&surface, reading)?;
                Ok(Some(match self.scatter_fraction {
                    ScatterFraction::Constant(fraction) => model::Scatter { fraction, bsdf },
                    ScatterFraction::Tis => by_tis(&bsdf, key_of(place, "scatter_fraction"))?,
                }))
            }
            _ => Ok(None),
        }
    }
}

/// Scattering of the level that the BSDF was written with.
fn by_tis(bsdf: &model::Bsdf, place: String) -> Result<model::Scatter> {
    let Some((tis, bsdf)) = bsdf.by_tis() else {
        return Err(Error::scene(
            place,
            "a `specular` BSDF has no total integrated scatter",
            "give a number from 0 to 1",
        ));
    };
    /// Sums round.
    const HIGHEST: f64 = 1.0 + 1e-9;
    match tis {
        tis if tis > HIGHEST => Err(Error::scene(
            place,
            format!("the total integrated scatter of the BSDF is {tis:.6}, more light than there is"),
            format!("give a BSDF of {:.6} times the height or less, or a number from 0 to 1", 1.0 / tis),
        )),
        tis if tis > 0.0 => Ok(model::Scatter { fraction: tis.min(1.0), bsdf }),
        _ => Err(Error::scene(
            place,
            "the BSDF scatters nothing at normal incidence, where `tis` is taken",
            "give a BSDF that does, or a number from 0 to 1",
        )),
    }
}

impl Reflectance {
    /// The values at the wavelengths of the scene \[um\].
    pub(super) fn at(&self, wavelengths: &[f64], place: &str) -> Result<Vec<f64>> {
        match self {
            Reflectance::Constant(value) => Ok(vec![*value; wavelengths.len()]),
            Reflectance::Table { wavelengths: listed, values } => look_up(listed, values, wavelengths, place),
        }
    }
}

/// Picks the tabulated values at exactly the wavelengths of the scene \[um\].
pub(super) fn look_up(listed: &[f64], values: &[f64], wavelengths: &[f64], place: &str) -> Result<Vec<f64>> {
    let table: HashMap<u64, f64> = listed.iter().map(|x| x.to_bits()).zip(values.iter().copied()).collect();
    let value_at = |wavelength: &f64| {
        table.get(&wavelength.to_bits()).copied().ok_or_else(|| {
            Error::scene(
                key_of(place, "wavelengths"),
                format!("the table has no value at {wavelength} um, which a source emits"),
                "list every wavelength of every source; values are not interpolated",
            )
        })
    };
    wavelengths.iter().map(value_at).collect()
}

type Group<'a> = (&'a str, Vec<SceneSurface>);

/// Labels of surfaces key the results, so no two may agree.
fn check_labels(groups: &[Group<'_>]) -> Result<()> {
    let mut seen = HashSet::new();
    for surface in groups.iter().flat_map(|(_, surfaces)| surfaces) {
        if !seen.insert(surface.name.as_str()) {
            return Err(Error::scene(
                "nsq_gpu.surfaces",
                format!("two surfaces are called {}", quoted(&surface.name)),
                "rename one; a lens L1 has the surfaces L1.front, L1.back, L1.edge and maybe L1.rim",
            ));
        }
    }
    Ok(())
}

/// Says if the aperture of a closed conic reaches beyond its widest point, where there is no surface.
fn overreach(surface: &SceneSurface) -> Option<String> {
    let conic = surface.shape.conic()?;
    let widest = conic.widest();
    let name = quoted(&surface.name);
    (conic.aperture_radius > widest)
        .then(|| format!("{name} ends at {widest} mm from its axis, within its aperture"))
}

/// Like Optiland, a surface that does not reflect ignores its reflectance; that is rarely meant.
fn warn_of_idle_reflectance(file: &SceneFile, groups: &[Group<'_>], warnings: &mut Vec<String>) {
    let Some(block) = &file.nsq_gpu else { return };
    let raw = block.surfaces.iter().filter(|raw| raw.reflectance.is_some()).map(|raw| raw.name.as_str());
    let changed = block.overrides.iter().filter(|(_, change)| change.reflectance.is_some());
    let given: HashSet<&str> = raw.chain(changed.map(|(name, _)| name.as_str())).collect();
    for surface in groups.iter().flat_map(|(_, surfaces)| surfaces) {
        let reflects = matches!(surface.interaction, model::Interaction::Reflective { .. });
        if !reflects && given.contains(surface.name.as_str()) {
            let name = quoted(&surface.name);
            warnings.push(format!(
                "the reflectance of {name} is ignored, because its interaction is not `reflective`"
            ));
        }
    }
}

fn check_override_names(file: &SceneFile, overrides: &BTreeMap<String, Override>) -> Result<()> {
    if overrides.is_empty() {
        return Ok(());
    }
    let parts: Vec<Part> = file.components.iter().flat_map(|component| component.parts()).collect();
    let by_name: HashMap<&str, &Part> = parts.iter().map(|part| (part.name.as_str(), part)).collect();
    for (name, change) in overrides {
        let place = key_of("nsq_gpu.overrides", name);
        let Some(part) = by_name.get(name.as_str()) else {
            let advice = did_you_mean(name, parts.iter().map(|part| part.name.as_str()));
            return Err(Error::scene(place, "no component has a surface of this name", advice));
        };
        if change.aperture_radius.is_some() && !matches!(part.shape, model::Shape::Conic(_)) {
            return Err(Error::scene(
                key_of(&place, "aperture_radius"),
                "this surface has no aperture of its own",
                "change the aperture radii of the faces instead",
            ));
        }
    }
    Ok(())
}

/// Sorts the groups by a list that must name each of them once.
fn in_order(groups: Vec<Group<'_>>, order: &[String]) -> Result<Vec<SceneSurface>> {
    let names: Vec<&str> = groups.iter().map(|(name, _)| *name).collect();
    let mut waiting: HashMap<&str, Vec<SceneSurface>> = groups.into_iter().collect();
    let mut surfaces = Vec::new();
    for (index, name) in order.iter().enumerate() {
        let Some(group) = waiting.remove(name.as_str()) else {
            let (problem, remedy) = if names.contains(&name.as_str()) {
                ("this name stands in the order twice".to_owned(), "remove one of the two".to_owned())
            } else {
                (format!("nothing is called {}", quoted(name)), did_you_mean(name, names.iter().copied()))
            };
            return Err(Error::scene(format!("nsq_gpu.order[{index}]"), problem, remedy));
        };
        surfaces.extend(group);
    }
    match names.iter().find(|name| waiting.contains_key(*name)) {
        Some(missing) => Err(Error::scene(
            "nsq_gpu.order",
            format!("{} is missing", quoted(missing)),
            "name every component and every surface once",
        )),
        None => Ok(surfaces),
    }
}
