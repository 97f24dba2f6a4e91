//! The material catalog: names of glasses, crystals, metals, plastics and liquids, and their n and k.
//!
//! The data comes from [refractiveindex.info](https://refractiveindex.info) (public domain, CC0; M. N. Polyanskiy and
//! its contributors), in the version that Optiland ships. A name means the entry that Optiland takes it for: each was
//! resolved by Optiland itself when `python/tools/make_catalog.py` made the embedded `catalog.bin`. An entry's own
//! path, such as `glass/schott/SF6`, is accepted as well, because some entries have no name of their own.
//!
//! Case does not matter in names, as in Optiland. Wavelengths are in um.

mod catalog;
mod catalog_bytes;
mod catalog_entry;
mod dispersion;
mod packed;

use std::sync::LazyLock;

use crate::scene::materials::catalog::{Catalog, Name};
use crate::scene::materials::catalog_bytes::AS_WRITTEN;

pub use crate::scene::materials::catalog_entry::CatalogEntry;
pub(super) use crate::scene::materials::catalog_entry::listed;
pub use crate::scene::materials::dispersion::{Dispersion, Table};

/// The version of Optiland whose catalog is embedded.
pub const OPTILAND_VERSION: &str = "0.6.3";

/// The embedded catalog, compressed.
static PACKED: &[u8] = include_bytes!("../catalog.bin");

/// What a name stands for.
#[derive(Debug, Clone, PartialEq)]
pub struct Resolved {
    /// The entry that Optiland takes.
    pub entry: &'static CatalogEntry,
    /// What the user should know about the choice: empty where the name is an entry's own and no other's.
    pub warnings: Vec<String>,
}

/// A name that the catalog cannot serve.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("no material \"{name}\"{}{}", explained(reason), suggested(suggestions))]
pub struct Unknown {
    /// The name as it was given.
    pub name: String,
    /// Why, if Optiland knows the name.
    pub reason: Option<String>,
    /// Names that the catalog has and that look or mean alike, the nearest first.
    pub suggestions: Vec<String>,
}

fn explained(reason: &Option<String>) -> String {
    reason.as_ref().map_or_else(|| " in the catalog".to_string(), |reason| format!(": {reason}"))
}

fn suggested(suggestions: &[String]) -> String {
    if suggestions.is_empty() { String::new() } else { format!("; near it: {}", suggestions.join(", ")) }
}

/// Finds the entry that Optiland takes for `name`, or the entry whose path it is.
///
/// # Errors
/// [`Unknown`] if Optiland does not know the name, or if its entry is not embedded.
pub fn resolve(name: &str) -> Result<Resolved, Unknown> {
    let catalog = catalog();
    let key = name.to_lowercase();
    let found = catalog.by_name.get(&key).and_then(|&index| catalog.names.get(index));
    let target = found.map(|name| name.target).or_else(|| catalog.by_path.get(&key).copied());
    let reason = match target.map(|target| catalog.target(target)) {
        Some(Ok(entry)) => {
            let warning = found.and_then(|found| catalog.choice_warning(name, found, entry));
            return Ok(Resolved { entry, warnings: warning.into_iter().collect() });
        }
        Some(Err(omitted)) => {
            Some(format!("Optiland takes {} for it, which has {}", omitted.path, omitted.reason.explain()))
        }
        None => None,
    };
    Err(Unknown { name: name.to_string(), reason, suggestions: catalog.suggestions(&key) })
}

/// Entries whose path, title or page contains every word of `text`, whatever the case, in order of their paths.
pub fn search(text: &str) -> Vec<&'static CatalogEntry> {
    let text = text.to_lowercase();
    let matches = |entry: &&CatalogEntry| {
        let description = format!("{} {} {}", entry.path, entry.title, entry.page).to_lowercase();
        text.split_whitespace().all(|word| description.contains(word))
    };
    catalog().entries.iter().filter(matches).collect()
}

/// Every embedded entry, in order of their paths.
pub fn entries() -> &'static [CatalogEntry] {
    &catalog().entries
}

/// Every name that Optiland resolves to an embedded entry.
pub fn names() -> impl Iterator<Item = &'static str> {
    let catalog = catalog();
    let embedded = |name: &&Name| name.target < catalog.entries.len();
    catalog.names.iter().filter(embedded).map(|name| name.spelling.as_str())
}

fn catalog() -> &'static Catalog {
    static INFLATED: LazyLock<Vec<u8>> = LazyLock::new(|| catalog_bytes::inflate(PACKED).expect(AS_WRITTEN));
    static CATALOG: LazyLock<Catalog> = LazyLock::new(|| packed::unpack(&INFLATED).expect(AS_WRITTEN));
    &CATALOG
}
