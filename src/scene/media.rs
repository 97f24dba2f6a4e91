//! Materials -> tables of n and k over the wavelengths of the scene.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use crate::model::key_path::{did_you_mean, key_of, quoted};
use crate::model::{Medium, MediumId};
use crate::scene::json::{Block, Component, Material, Medium as Described, SceneFile};
use crate::scene::materials::{self, Dispersion, Table};
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
            let ([n, k], said) = interpolated(&place, listed, [Some(n), k.as_ref()], wavelengths)?;
            Ok((medium(n, k), said))
        }
        Described::Catalog { name: catalog_name } => {
            from_catalog(&key_of(&place, "name"), catalog_name, name, wavelengths)
        }
    }
}

/// Indices of neighbours in a table that differ by more than this say little of what lies between.
const COARSE: f64 = 1e-3;

/// n and k of a table at the wavelengths of the scene \[um\], linear between the wavelengths of the table, as Optiland has tables.
/// A list that is missing is 0. Beside them stands where the table is coarse.
fn interpolated(
    place: &str,
    listed: &[f64],
    values: [Option<&Vec<f64>>; 2],
    wavelengths: &[f64],
) -> Result<([Vec<f64>; 2], Vec<String>)> {
    let mut order: Vec<usize> = (0..listed.len()).collect();
    order.sort_by(|a, b| listed[*a].total_cmp(&listed[*b]));
    let sorted: Arc<[f64]> = order.iter().map(|i| listed[*i]).collect();
    let no_table = || Error::scene(place, "the table is empty", "give at least one wavelength [um]");
    let table = |values: Option<&Vec<f64>>| {
        let values = order.iter().map(|i| values.map_or(0.0, |values| values[*i])).collect();
        Table::new(Arc::clone(&sorted), values).ok_or_else(no_table)
    };
    let (n, k) = (table(values[0])?, table(values[1])?);
    let (first, last) = n.range();
    let mut said = Vec::new();
    for wavelength in wavelengths {
        if !(first..=last).contains(wavelength) {
            return Err(Error::scene(
                key_of(place, "wavelengths"),
                format!("the table has no value at {wavelength} um, which a source emits"),
                format!(
                    "the table is from {first} to {last} um; list wavelengths on both sides of {wavelength} um"
                ),
            ));
        }
        let above = sorted.partition_point(|sample| sample < wavelength);
        let (below, above) = (sorted[above.saturating_sub(1)], sorted[above]);
        let apart = (n.at(above) - n.at(below)).abs();
        if above != *wavelength && apart > COARSE {
            said.push(format!(
                "{place}: n at {wavelength} um is interpolated between {below} and {above} um, where n differs by \
                 {apart:.1e}; list wavelengths that lie closer"
            ));
        }
    }
    let at = |table: &Table| wavelengths.iter().map(|wavelength| table.at(*wavelength)).collect();
    Ok(([at(&n), at(&k)], said))
}

/// The name of a medium that is a table over wavelengths, if the scene uses one: it has no derivative by them.
pub(crate) fn tabulated(file: &SceneFile) -> Option<String> {
    let empty = Block::default();
    let block = file.nsq_gpu.as_ref().unwrap_or(&empty);
    let is_table = |name: &str| {
        materials::resolve(name).is_ok_and(|found| matches!(found.entry.dispersion(), Dispersion::Table(_)))
    };
    let found = uses(file, block).into_iter().find_map(|(_, material)| match material {
        Material::Vacuum => None,
        Material::Name(name) | Material::Catalog { name } => is_table(name).then_some(name),
        Material::Medium { name } => match block.media.get(name)? {
            Described::Constant { .. } => None,
            Described::Table { .. } => Some(name),
            Described::Catalog { name: entry } => is_table(entry).then_some(name),
        },
    });
    found.cloned()
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

#[cfg(test)]
mod tests {
    use super::*;

    fn at(listed: &[f64], n: &[f64], wavelengths: &[f64]) -> Result<(Vec<f64>, Vec<String>)> {
        let ([n, k], said) = interpolated("glass", listed, [Some(&n.to_vec()), None], wavelengths)?;
        assert_eq!(k, vec![0.0; wavelengths.len()]);
        Ok((n, said))
    }

    #[test]
    fn a_table_is_linear_between_its_wavelengths_in_any_order_and_itself_at_them() {
        let (listed, n) = ([0.65, 0.45, 0.55], [1.5, 1.5004, 1.5003]);
        let (found, said) = at(&listed, &n, &[0.45, 0.5, 0.55, 0.625, 0.65]).unwrap();
        assert_eq!([found[0], found[2], found[4]].map(f64::to_bits), [1.5004, 1.5003, 1.5].map(f64::to_bits));
        assert!((found[1] - 1.50035).abs() < 1e-15 && (found[3] - 1.500075).abs() < 1e-15, "{found:?}");
        assert!(said.is_empty(), "{said:?}");
        assert_eq!(at(&[0.55], &[1.5], &[0.55]), Ok((vec![1.5], Vec::new())));
    }

    #[test]
    fn a_table_is_refused_beyond_its_wavelengths_with_its_range() {
        for (listed, beyond) in [(vec![0.55], 0.56), (vec![0.6, 0.5], 0.4999), (vec![0.5, 0.6], 0.61)] {
            let said = at(&listed, &vec![1.5; listed.len()], &[beyond]).unwrap_err().to_string();
            assert!(said.contains(&format!("no value at {beyond} um")), "{said}");
            assert!(said.contains("the table is from 0.5"), "{said}");
        }
    }

    #[test]
    fn a_coarse_table_is_said_to_be_coarse() {
        let (_, said) = at(&[0.4861, 0.6563], &[1.5224, 1.5143], &[0.4861, 0.5876]).unwrap();
        assert_eq!(said.len(), 1);
        assert!(said[0].contains("n at 0.5876 um is interpolated between 0.4861 and 0.6563 um"), "{said:?}");
    }
}
