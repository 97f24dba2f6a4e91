//! The unpacked catalog: entries, names, and what Optiland's search makes of a name.

use std::collections::HashMap;

use crate::scene::materials::catalog_entry::{CatalogEntry, MAX_LISTED, listed};

/// The unpacked catalog. A target is an index into the entries, and beyond them into the omitted ones.
#[derive(Debug)]
pub(super) struct Catalog {
    pub(super) entries: Vec<CatalogEntry>,
    pub(super) omitted: Vec<Omitted>,
    pub(super) names: Vec<Name>,
    pub(super) by_name: HashMap<String, usize>,
    pub(super) by_path: HashMap<String, usize>,
}

/// A name and what Optiland's search makes of it.
#[derive(Debug)]
pub(super) struct Name {
    pub(super) spelling: String,
    pub(super) target: usize,
    /// True if it is an entry's own name, false if the search found something near.
    pub(super) exact: bool,
    /// The other targets that match as well.
    pub(super) others: Vec<usize>,
}

/// An entry of Optiland's catalog that is not embedded.
#[derive(Debug)]
pub(super) struct Omitted {
    pub(super) path: String,
    pub(super) reason: Omission,
}

#[derive(Debug, Clone, Copy)]
pub(super) enum Omission {
    TooLarge,
    NoIndex,
    Refused,
}

impl Omission {
    pub(super) fn explain(self) -> &'static str {
        match self {
            Omission::TooLarge => "a table too large for the embedded catalog",
            Omission::NoIndex => "data of k without n",
            Omission::Refused => "data that Optiland refuses, such as a table out of order",
        }
    }
}

impl Catalog {
    pub(super) fn target(&self, target: usize) -> Result<&CatalogEntry, &Omitted> {
        self.entries.get(target).ok_or_else(|| &self.omitted[target - self.entries.len()])
    }

    pub(super) fn path(&self, target: usize) -> &str {
        self.target(target).map_or_else(|omitted| &omitted.path, |entry| &entry.path)
    }

    /// What is doubtful about taking `entry` for the name as it was given.
    pub(super) fn choice_warning(&self, given: &str, name: &Name, entry: &CatalogEntry) -> Option<String> {
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
    fn glass_hint(&self, name: &Name, entry: &CatalogEntry) -> String {
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
    pub(super) fn suggestions(&self, key: &str) -> Vec<String> {
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
