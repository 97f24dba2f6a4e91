//! `nsq-gpu materials`: shows what the catalog holds, and what a name stands for.

use crate::scene::materials::{self, CatalogEntry, Dispersion, OPTILAND_VERSION, Resolved};
use crate::{Error, Result};

/// The F, d and C lines \[um\].
const VISIBLE_LINES: [f64; 3] = [0.4861327, 0.5875618, 0.6562725];

/// Show what a material name stands for, its source, and its n and k
#[derive(Debug, Clone, clap::Args)]
pub struct Args {
    /// Name as in a scene, such as N-BK7, or an entry's path, such as glass/schott/N-BK7
    #[arg(conflicts_with = "search")]
    pub name: Option<String>,
    /// Wavelengths to list n and k at, in um; the F, d and C lines if the data covers the d line
    #[arg(long, value_delimiter = ',', value_name = "UM", requires = "name")]
    pub wavelengths: Vec<f64>,
    /// List the entries whose path or title contains these words
    #[arg(long, value_name = "TEXT")]
    pub search: Option<String>,
}

/// Returns the text for stdout.
///
/// # Errors
/// [`Error::Usage`] if the name is unknown, nothing matches the search, or a wavelength is not a positive number.
pub fn run(args: &Args) -> Result<String> {
    match (&args.name, &args.search) {
        (Some(name), _) => {
            let resolved = materials::resolve(name).map_err(|unknown| Error::Usage(unknown.to_string()))?;
            describe(name, &resolved, &args.wavelengths)
        }
        (None, Some(text)) => list(text),
        (None, None) => Ok(overview()),
    }
}

fn overview() -> String {
    format!(
        "{} names of {} entries: refractiveindex.info (CC0), as in Optiland {OPTILAND_VERSION}\n\
         one of them:   nsq-gpu materials N-BK7\n\
         find some:     nsq-gpu materials --search \"calcium fluoride\"\n",
        materials::names().count(),
        materials::entries().len()
    )
}

fn list(text: &str) -> Result<String> {
    let entries = materials::search(text);
    if entries.is_empty() {
        return Err(Error::Usage(format!("no entry's path or title contains \"{text}\"; try a part of it")));
    }
    let width = entries.iter().map(|entry| entry.path.chars().count()).max().unwrap_or(0);
    Ok(entries
        .iter()
        .map(|entry| format!("{:width$}  {} | {}\n", entry.path, entry.title, entry.page))
        .collect())
}

fn describe(name: &str, resolved: &Resolved, wavelengths: &[f64]) -> Result<String> {
    if let Some(bad) = wavelengths.iter().find(|&&wavelength| !(wavelength.is_finite() && wavelength > 0.0)) {
        return Err(Error::Usage(format!("a wavelength of {bad} um; give positive numbers, such as 0.5876")));
    }
    let entry = resolved.entry;
    let defaults = default_wavelengths(entry);
    let wavelengths = if wavelengths.is_empty() { &defaults } else { wavelengths };
    let fields = [
        ("entry", entry.path.clone()),
        ("title", format!("{} | {}", entry.title, entry.page)),
        ("source", entry.reference.to_string()),
        ("catalog", format!("refractiveindex.info (CC0), as in Optiland {OPTILAND_VERSION}")),
        ("n", dispersion(entry)),
        ("k", extinction(entry)),
    ];
    let mut text = format!("{name}\n");
    for (label, value) in fields {
        text += &format!("  {label:<8} {value}\n");
    }
    text += &table(entry, wavelengths);
    let data = [entry.range_warnings(wavelengths), entry.defects(wavelengths)];
    for warning in resolved.warnings.iter().chain(data.iter().flatten()) {
        text += &format!("warning: {warning}\n");
    }
    Ok(text)
}

/// The default wavelengths \[um\]: the visible lines where the data covers them, else the ends and the middle of the
/// data.
fn default_wavelengths(entry: &CatalogEntry) -> [f64; 3] {
    let (low, high) = entry.dispersion().range();
    if (low..=high).contains(&VISIBLE_LINES[1]) { VISIBLE_LINES } else { [low, (low + high) / 2.0, high] }
}

fn dispersion(entry: &CatalogEntry) -> String {
    let (low, high) = entry.dispersion().range();
    let kind = match entry.dispersion() {
        Dispersion::Table(table) => format!("table of {} samples", table.wavelengths().len()),
        Dispersion::Formula { number, .. } => format!("formula {number} of refractiveindex.info"),
    };
    format!("{kind}, {low} to {high} um")
}

fn extinction(entry: &CatalogEntry) -> String {
    entry.extinction().map_or("no data: 0".to_string(), |table| {
        let (low, high) = table.range();
        format!("table of {} samples, {low} to {high} um", table.wavelengths().len())
    })
}

fn table(entry: &CatalogEntry, wavelengths: &[f64]) -> String {
    let mut text = format!("  {:>15}  {:>12}  {:>12}\n", "wavelength [um]", "n", "k");
    for &wavelength in wavelengths {
        let (n, k) = (entry.n(wavelength), entry.k(wavelength));
        text += &format!("  {wavelength:>15}  {n:>12.8}  {k:>12.4e}\n");
    }
    text
}
