//! One entry of the catalog: its description, and its numbers when they are asked for.

use std::sync::{Arc, OnceLock};

use crate::scene::materials::catalog_bytes::{self, AS_WRITTEN, Optics};
use crate::scene::materials::dispersion::{Dispersion, Table};

/// How many suggestions or alternatives a message lists.
pub(super) const MAX_LISTED: usize = 5;

/// One measurement or data sheet of one material.
#[derive(Debug)]
pub struct CatalogEntry {
    /// Its place in the catalog, such as `glass/schott/N-BK7`.
    pub path: String,
    /// The material, such as `Ag (Silver)`.
    pub title: String,
    /// Which data of the material, such as `Johnson and Christy 1972: n,k 0.188–1.94 µm`, or a glass's name.
    pub page: String,
    /// Where the data was published.
    pub reference: Arc<str>,
    /// Its numbers, which are unpacked when they are asked for: a scene needs few entries.
    pub(super) packed: &'static [u8],
    pub(super) optics: OnceLock<Optics>,
}

/// Entries are the same if their paths are.
impl PartialEq for CatalogEntry {
    fn eq(&self, other: &Self) -> bool {
        self.path == other.path
    }
}

impl CatalogEntry {
    /// The refractive index.
    pub fn dispersion(&self) -> &Dispersion {
        &self.optics().dispersion
    }

    /// The extinction coefficient, if it was measured.
    pub fn extinction(&self) -> Option<&Table> {
        self.optics().extinction.as_ref()
    }

    fn optics(&self) -> &Optics {
        self.optics.get_or_init(|| catalog_bytes::optics(self.packed).expect(AS_WRITTEN))
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

    pub(super) fn is_glass(&self) -> bool {
        self.path.starts_with("glass/")
    }
}

/// The first few, and how many more there are.
pub(in crate::scene) fn listed(items: &[impl AsRef<str>]) -> String {
    let shown: Vec<&str> = items.iter().take(MAX_LISTED).map(AsRef::as_ref).collect();
    match items.len() - shown.len() {
        0 => shown.join(", "),
        more => format!("{} and {more} more", shown.join(", ")),
    }
}
