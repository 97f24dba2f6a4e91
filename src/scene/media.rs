//! Materials -> tables of n and k over the wavelengths of the scene.

use std::collections::{BTreeMap, HashMap};

use crate::model::place::{did_you_mean, key_of, quoted};
use crate::model::{Medium, MediumId};
use crate::scene::json::{Block, Component, Material, Medium as Described, SceneFile};
use crate::scene::materials;
use crate::scene::surfaces::look_up;
use crate::{Error, Result};

/// Every medium that a scene uses, vacuum first, and which one each of the user's words means.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct MediaTable {
    pub media: Vec<Medium>,
    ids: BTreeMap<Material, MediumId>,
    by_content: HashMap<Vec<u64>, MediumId>,
}

/// Resolves every material of the file at the wavelengths \[um\].
pub(super) fn resolve(
    file: &SceneFile,
    wavelengths: &[f64],
    warnings: &mut Vec<String>,
) -> Result<MediaTable> {
    let mut table = MediaTable::with_vacuum(wavelengths.len());
    let empty = Block::default();
    let block = file.nsq_gpu.as_ref().unwrap_or(&empty);
    for (place, material) in uses(file, block) {
        if table.ids.contains_key(material) {
            continue;
        }
        let (medium, said) = evaluate(&place, material, block, wavelengths)?;
        warnings.extend(said);
        table.insert(material, medium);
    }
    Ok(table)
}

impl MediaTable {
    fn with_vacuum(count: usize) -> Self {
        let vacuum =
            Medium { name: "vacuum".to_owned(), ambient: true, n: vec![1.0; count], k: vec![0.0; count] };
        let ids = BTreeMap::from([(Material::Vacuum, 0)]);
        MediaTable { media: vec![vacuum], ids, by_content: HashMap::new() }
    }

    /// Media of equal content share an index; vacuum stays apart from a solid of index 1.
    fn insert(&mut self, material: &Material, medium: Medium) {
        let content: Vec<u64> = medium.n.iter().chain(&medium.k).map(|x| x.to_bits()).collect();
        let next = self.media.len();
        let id = *self.by_content.entry(content).or_insert(next);
        if id == next {
            self.media.push(medium);
        }
        self.ids.insert(material.clone(), id);
    }

    /// The medium that the user's word means, if the scene uses it.
    pub(crate) fn id(&self, material: &Material) -> Option<MediumId> {
        self.ids.get(material).copied()
    }
}

/// Every place where the file uses a material.
fn uses<'a>(file: &'a SceneFile, block: &'a Block) -> Vec<(String, &'a Material)> {
    let mut uses = Vec::new();
    for (i, component) in file.components.iter().enumerate() {
        let at = |key: &str| format!("components[{i}].config.{key}");
        match component {
            Component::Lens(lens) => uses.push((at("material"), &lens.config.material)),
            Component::Mirror(_) => {}
            Component::Doublet(doublet) => {
                uses.push((at("material1"), &doublet.config.material1));
                uses.push((at("material2"), &doublet.config.material2));
            }
        }
    }
    for (i, surface) in block.surfaces.iter().enumerate() {
        uses.push((format!("nsq_gpu.surfaces[{i}].material_front"), &surface.material_front));
        uses.push((format!("nsq_gpu.surfaces[{i}].material_back"), &surface.material_back));
    }
    for (i, source) in file.sources.iter().enumerate() {
        uses.push((format!("sources[{i}].medium"), source.medium()));
    }
    uses
}

fn evaluate(
    place: &str,
    material: &Material,
    block: &Block,
    wavelengths: &[f64],
) -> Result<(Medium, Vec<String>)> {
    match material {
        Material::Vacuum => Ok((MediaTable::with_vacuum(wavelengths.len()).media.remove(0), Vec::new())),
        Material::Name(name) | Material::Catalog { name } => from_catalog(place, name, name, wavelengths),
        Material::Medium { name } => match block.media.get(name) {
            Some(described) => from_block(name, described, wavelengths),
            None => Err(Error::scene(
                place,
                format!("nsq_gpu.media has no {}", quoted(name)),
                did_you_mean(name, block.media.keys().map(String::as_str)),
            )),
        },
    }
}

fn from_block(name: &str, described: &Described, wavelengths: &[f64]) -> Result<(Medium, Vec<String>)> {
    let place = key_of("nsq_gpu.media", name);
    let medium = |n, k| Medium { name: name.to_owned(), ambient: false, n, k };
    match described {
        Described::Constant { n, k } => {
            Ok((medium(vec![*n; wavelengths.len()], vec![*k; wavelengths.len()]), Vec::new()))
        }
        Described::Table { wavelengths: listed, n, k } => {
            let k = match k {
                Some(k) => look_up(listed, k, wavelengths, &place)?,
                None => vec![0.0; wavelengths.len()],
            };
            Ok((medium(look_up(listed, n, wavelengths, &place)?, k), Vec::new()))
        }
        Described::Catalog { name: catalog_name } => {
            from_catalog(&key_of(&place, "name"), catalog_name, name, wavelengths)
        }
    }
}

/// The one door to the catalog.
fn from_catalog(place: &str, name: &str, label: &str, wavelengths: &[f64]) -> Result<(Medium, Vec<String>)> {
    let found = materials::resolve(name).map_err(|unknown| no_material(place, &unknown))?;
    let defects = found.entry.defects(wavelengths);
    if !defects.is_empty() {
        return Err(Error::scene(
            place,
            defects.join("; "),
            "choose a material whose data covers these wavelengths",
        ));
    }
    let table =
        |value: &dyn Fn(f64) -> f64| wavelengths.iter().map(|wavelength| value(*wavelength)).collect();
    let (n, k) =
        (table(&|wavelength| found.entry.n(wavelength)), table(&|wavelength| found.entry.k(wavelength)));
    let mut warnings = found.warnings;
    warnings.extend(found.entry.range_warnings(wavelengths));
    Ok((Medium { name: label.to_owned(), ambient: false, n, k }, warnings))
}

fn no_material(place: &str, unknown: &materials::Unknown) -> Error {
    let reason = unknown.reason.as_deref().unwrap_or("the catalog does not have it");
    let remedy = match unknown.suggestions.as_slice() {
        [] => "the command `materials` searches the catalog".to_owned(),
        near => {
            format!("did you mean {}?", near.iter().map(|name| quoted(name)).collect::<Vec<_>>().join(", "))
        }
    };
    Error::scene(place, format!("unknown material {}: {reason}", quoted(&unknown.name)), remedy)
}
