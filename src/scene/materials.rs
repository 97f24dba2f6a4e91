//! The material catalog: names of glasses, crystals, metals, plastics and liquids, and their n and k.
//!
//! The data is that of [refractiveindex.info](https://refractiveindex.info) (public domain, CC0; M. N. Polyanskiy and
//! its contributors), in the version that Optiland ships. A name means the entry that Optiland takes it for: each was
//! resolved by Optiland itself when `python/tools/make_catalog.py` made the embedded `catalog.bin`. An entry's own
//! path, such as `glass/schott/SF6`, is accepted as well, because some entries have no name of their own.
//!
//! Case does not matter in names, as in Optiland. Wavelengths are in um.

mod dispersion;
mod packed;

use std::collections::HashMap;
use std::sync::{Arc, LazyLock, OnceLock};

pub use crate::scene::materials::dispersion::{Dispersion, Table};

/// The version of Optiland whose catalog is embedded.
pub const OPTILAND_VERSION: &str = "0.6.3";

/// The embedded catalog, compressed.
static PACKED: &[u8] = include_bytes!("catalog.bin");
const AS_WRITTEN: &str = "the embedded catalog is what its generator wrote";

/// How many suggestions or alternatives a message lists.
const MAX_LISTED: usize = 5;

/// One measurement or data sheet of one material.
#[derive(Debug)]
pub struct Entry {
    /// Its place in the catalog, such as `glass/schott/N-BK7`.
    pub path: String,
    /// The material, such as `Ag (Silver)`.
    pub title: String,
    /// Which data of the material, such as `Johnson and Christy 1972: n,k 0.188–1.94 µm`, or a glass's name.
    pub page: String,
    /// Where the data was published.
    pub reference: Arc<str>,
    /// Its numbers, which are unpacked when they are asked for: a scene needs those of a few entries.
    packed: &'static [u8],
    optics: OnceLock<Optics>,
}

/// The numbers of an entry.
#[derive(Debug)]
struct Optics {
    dispersion: Dispersion,
    extinction: Option<Table>,
}

/// Entries are the same if their paths are.
impl PartialEq for Entry {
    fn eq(&self, other: &Self) -> bool {
        self.path == other.path
    }
}

impl Entry {
    /// The refractive index.
    pub fn dispersion(&self) -> &Dispersion {
        &self.optics().dispersion
    }

    /// The extinction coefficient, if it was measured.
    pub fn extinction(&self) -> Option<&Table> {
        self.optics().extinction.as_ref()
    }

    fn optics(&self) -> &Optics {
        self.optics.get_or_init(|| packed::optics(self.packed).expect(AS_WRITTEN))
    }

    /// Refractive index at a wavelength \[um\]. A table is constant beyond its ends; a formula is extrapolated, and
    /// is NaN where it has no real value.
    pub fn n(&self, wavelength_um: f64) -> f64 {
        self.dispersion().n(wavelength_um)
    }

    /// Extinction coefficient at a wavelength \[um\]: constant beyond the ends of its table, 0 if there is none.
    pub fn k(&self, wavelength_um: f64) -> f64 {
        self.extinction().map_or(0.0, |table| table.at(wavelength_um))
    }

    /// Says for which of these wavelengths \[um\] n or k goes beyond the data.
    pub fn range_warnings(&self, wavelengths_um: &[f64]) -> Vec<String> {
        let beyond = match self.dispersion() {
            Dispersion::Table(_) => "the nearest sample is used",
            Dispersion::Formula { .. } => "the formula is extrapolated",
        };
        let n = self.range_warning("n", self.dispersion().range(), beyond, wavelengths_um);
        let k = self.extinction().and_then(|table| {
            self.range_warning("k", table.range(), "the nearest sample is used", wavelengths_um)
        });
        n.into_iter().chain(k).collect()
    }

    /// What no tracer should accept: n that is not a positive number, and negative k, which would amplify light.
    /// A few measurements have either, and a formula far from its range may. Empty if all is well at these
    /// wavelengths \[um\].
    pub fn defects(&self, wavelengths_um: &[f64]) -> Vec<String> {
        let absurd_n = |n: f64| !(n > 0.0 && n.is_finite());
        let faults: [(&str, &dyn Fn(f64) -> bool); 2] = [
            ("n is not a positive number", &|wavelength| absurd_n(self.n(wavelength))),
            ("k is negative", &|wavelength| self.k(wavelength) < 0.0),
        ];
        let mut found = Vec::new();
        for (what, fault) in faults {
            let at = wavelengths_um.iter().copied().filter(|&wavelength| fault(wavelength));
            let at: Vec<String> = at.map(|wavelength| wavelength.to_string()).collect();
            if !at.is_empty() {
                found.push(format!("{}: {what} at {} um", self.path, listed(&at)));
            }
        }
        found
    }

    fn range_warning(
        &self,
        what: &str,
        range: (f64, f64),
        beyond: &str,
        wavelengths: &[f64],
    ) -> Option<String> {
        let (low, high) = range;
        let is_known = |wavelength: f64| (low..=high).contains(&wavelength);
        let outside: Vec<f64> =
            wavelengths.iter().copied().filter(|&wavelength| !is_known(wavelength)).collect();
        let in_nm = outside.iter().find(|&&wavelength| is_known(wavelength / 1e3));
        let hint = in_nm.map_or(String::new(), |nm| format!("; are these nm? {nm} nm are {} um", nm / 1e3));
        let places: Vec<String> = outside.iter().map(f64::to_string).collect();
        (!outside.is_empty()).then(|| {
            let path = &self.path;
            format!(
                "{path}: {what} is known from {low} to {high} um, and {beyond} at {} um{hint}",
                listed(&places)
            )
        })
    }

    fn is_glass(&self) -> bool {
        self.path.starts_with("glass/")
    }
}

/// What a name stands for.
#[derive(Debug, Clone, PartialEq)]
pub struct Resolved {
    /// The entry that Optiland takes.
    pub entry: &'static Entry,
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

/// The unpacked catalog. A target is an index into the entries, and beyond them into the omitted ones.
#[derive(Debug)]
struct Catalog {
    entries: Vec<Entry>,
    omitted: Vec<Omitted>,
    names: Vec<Name>,
    by_name: HashMap<String, usize>,
    by_path: HashMap<String, usize>,
}

/// A name and what Optiland's search makes of it.
#[derive(Debug)]
struct Name {
    spelling: String,
    target: usize,
    /// True if it is an entry's own name, false if the search found something near.
    exact: bool,
    /// The other targets that match as well.
    others: Vec<usize>,
}

/// An entry of Optiland's catalog that is not embedded.
#[derive(Debug)]
struct Omitted {
    path: String,
    reason: Omission,
}

#[derive(Debug, Clone, Copy)]
enum Omission {
    TooLarge,
    NoIndex,
    Refused,
}

impl Omission {
    fn explain(self) -> &'static str {
        match self {
            Omission::TooLarge => "a table too large for the embedded catalog",
            Omission::NoIndex => "data of k without n",
            Omission::Refused => "data that Optiland refuses, such as a table out of order",
        }
    }
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
pub fn search(text: &str) -> Vec<&'static Entry> {
    let text = text.to_lowercase();
    let matches = |entry: &&Entry| {
        let description = format!("{} {} {}", entry.path, entry.title, entry.page).to_lowercase();
        text.split_whitespace().all(|word| description.contains(word))
    };
    catalog().entries.iter().filter(matches).collect()
}

/// Every embedded entry, in order of their paths.
pub fn entries() -> &'static [Entry] {
    &catalog().entries
}

/// Every name that Optiland resolves to an embedded entry.
pub fn names() -> impl Iterator<Item = &'static str> {
    let catalog = catalog();
    let embedded = |name: &&Name| name.target < catalog.entries.len();
    catalog.names.iter().filter(embedded).map(|name| name.spelling.as_str())
}

fn catalog() -> &'static Catalog {
    static INFLATED: LazyLock<Vec<u8>> = LazyLock::new(|| packed::inflate(PACKED).expect(AS_WRITTEN));
    static CATALOG: LazyLock<Catalog> = LazyLock::new(|| packed::unpack(&INFLATED).expect(AS_WRITTEN));
    &CATALOG
}

impl Catalog {
    fn target(&self, target: usize) -> Result<&Entry, &Omitted> {
        self.entries.get(target).ok_or_else(|| &self.omitted[target - self.entries.len()])
    }

    fn path(&self, target: usize) -> &str {
        self.target(target).map_or_else(|omitted| &omitted.path, |entry| &entry.path)
    }

    /// What is doubtful about taking `entry` for the name as it was given.
    fn choice_warning(&self, given: &str, name: &Name, entry: &Entry) -> Option<String> {
        let used = format!("{} ({}) is used, as in Optiland", entry.path, entry.title);
        let others: Vec<&str> = name.others.iter().map(|&target| self.path(target)).collect();
        let problem = match (name.exact, others.len()) {
            (true, 0) => return None,
            (true, count) => format!("\"{given}\" names {} entries: {used}", count + 1),
            (false, _) => format!("\"{given}\" is no entry's name, and Optiland's search guesses: {used}"),
        };
        let alternatives = match others.is_empty() {
            true => String::new(),
            false => format!("; {} would match as well", listed(&others)),
        };
        Some(format!("{problem}{alternatives}{}", self.glass_hint(name, entry)))
    }

    /// Says how to get the glass where another material took its name, as the gas does with SF6.
    fn glass_hint(&self, name: &Name, entry: &Entry) -> String {
        let glasses = || {
            let entries = name.others.iter().filter_map(|&target| self.target(target).ok());
            entries.filter(|other| !entry.is_glass() && other.is_glass())
        };
        // Makers copied names that were Schott's first.
        let schott = glasses().find(|glass| glass.path.starts_with("glass/schott/"));
        match schott.or_else(|| glasses().next()) {
            Some(glass) => format!("; if the glass is meant, write \"{}\"", glass.path),
            None if name.others.is_empty() => String::new(),
            None => "; to choose, write a path".to_string(),
        }
    }

    /// Names like `key` (lower case) in spelling, or of a material whose title speaks of it, the nearest first.
    fn suggestions(&self, key: &str) -> Vec<String> {
        /// Twice the longest name; comparing takes time in proportion to the length \[bytes\].
        const MAX_COMPARED: usize = 250;
        if key.len() > MAX_COMPARED {
            return Vec::new();
        }
        let mut ranked: Vec<(usize, usize, &str)> = self
            .names
            .iter()
            .filter_map(|name| {
                let entry = self.entries.get(name.target)?;
                let distance = distance(key, &name.spelling.to_lowercase(), &entry.title.to_lowercase())?;
                Some((distance, name.spelling.len(), name.spelling.as_str()))
            })
            .collect();
        ranked.sort_unstable();
        ranked.into_iter().take(MAX_LISTED).map(|(_, _, spelling)| spelling.to_string()).collect()
    }
}

/// How far `key` is from a name or from what its entry's title says; `None` if too far to be meant.
fn distance(key: &str, spelling: &str, title: &str) -> Option<usize> {
    /// Shorter texts are parts of nearly everything.
    const MIN_PART: usize = 3;
    let edits = strsim::osa_distance(key, spelling);
    if edits <= key.chars().count() / 3 {
        return Some(edits);
    }
    let part = |whole: &str, part: &str| part.len() >= MIN_PART && whole.contains(part);
    // A title begins with the name of its material: `MgF2 (Magnesium fluoride)`.
    let title_says = title.starts_with(spelling) && part(title, key);
    (title_says || part(key, spelling)).then_some(MIN_PART)
}

/// The first few, and how many more there are.
pub(super) fn listed(items: &[impl AsRef<str>]) -> String {
    let shown: Vec<&str> = items.iter().take(MAX_LISTED).map(AsRef::as_ref).collect();
    match items.len() - shown.len() {
        0 => shown.join(", "),
        more => format!("{} and {more} more", shown.join(", ")),
    }
}
