//! Refuses what no trace could mean: absurd numbers, clashing names, contradictions. The first problem is reported,
//! with its place.

use std::collections::{HashMap, HashSet};

use crate::Result;
use crate::model::Sampling;
use crate::model::checks::{between, conic_constant, fraction, position, radius, refuse, size};
use crate::model::key_path::{did_you_mean, key_of, quoted};
use crate::scene::elements;
use crate::scene::json::{
    Block, Component, CoordinateSystem, Detector, Doublet, Lens, Medium, Mirror, Override, RawSurface,
    ReflectProb, Reflectance, SamplingPolicy, ScatterFraction, SceneFile, Source, Spectrum,
};
use crate::scene::named_entries::placed;

/// Wavelengths above are nanometres by mistake \[um\]; Optiland's limit.
const MAX_WAVELENGTH: f64 = 20.0;
/// Wavelengths below are metres by mistake \[um\].
const MIN_WAVELENGTH: f64 = 1e-4;
/// Least flux of a source that emits any \[W\]. A quantum (2^-52) of one ray of the most (2^63), on the largest pixel
/// (1e24 mm^2), is then a normal number. With less, fluxes of a result would be rounded away.
const MIN_FLUX: f64 = 1e-249;
/// Longest chain of coordinate systems.
const MAX_CHAIN: usize = 64;
/// Most sums that all detectors keep together.
const MAX_CELLS: u64 = 1 << 31;
/// Most components, surfaces, sources or detectors.
const MAX_ITEMS: usize = 100_000;
/// Most distinct wavelengths of all sources, times the items that may have a table over them.
const MAX_TABLES: usize = 1 << 25;
/// Longest name \[bytes\]: tables of rows repeat the longest in every row.
const MAX_NAME: usize = 1 << 16;

/// Checks everything that can be checked without building surfaces or looking up materials.
pub(super) fn check(file: &SceneFile, warnings: &mut Vec<String>) -> Result<()> {
    check_counts(file)?;
    each("components", &file.components, check_component)?;
    each("sources", &file.sources, check_source)?;
    each("detectors", &file.detectors, check_detector)?;
    check_cells(file)?;
    check_wavelength_count(file)?;
    check_total_flux(file)?;
    check_names(file)?;
    elements::check(file)?;
    if let Some(block) = &file.nsq_gpu {
        check_block(block, file)?;
    }
    warn_of_degrees(file, warnings);
    Ok(())
}

fn each<T>(list: &str, items: &[T], check: impl Fn(&str, &T) -> Result<()>) -> Result<()> {
    items.iter().enumerate().try_for_each(|(index, item)| check(&format!("{list}[{index}]"), item))
}

// Numbers

fn wavelength(place: String, value: f64) -> Result<()> {
    match value {
        v if (MIN_WAVELENGTH..=MAX_WAVELENGTH).contains(&v) => Ok(()),
        v if v > MAX_WAVELENGTH && v.is_finite() => refuse(
            place,
            format!("a wavelength of {v} um is above {MAX_WAVELENGTH} um"),
            format!(
                "wavelengths are in micrometres; if these are nanometres, divide by 1000: {}",
                v / 1000.0
            ),
        ),
        v if v > 0.0 && v.is_finite() => refuse(
            place,
            format!("a wavelength of {v} um is below {MIN_WAVELENGTH} um"),
            "wavelengths are in micrometres; if these are metres, multiply by 1e6",
        ),
        v => refuse(place, format!("{v} is no wavelength"), "give micrometres above 0, such as 0.55"),
    }
}

fn coordinate_system(place: &str, cs: &CoordinateSystem) -> Result<()> {
    let mut place = place.to_owned();
    let mut next = Some(cs);
    for _ in 0..MAX_CHAIN {
        let Some(cs) = next else { return Ok(()) };
        for (key, value) in [("x", cs.x), ("y", cs.y), ("z", cs.z)] {
            position(key_of(&place, key), value)?;
        }
        for (key, value) in [("rx", cs.rx), ("ry", cs.ry), ("rz", cs.rz)] {
            between(key_of(&place, key), value, -1e6, 1e6)?;
        }
        place = key_of(&place, "reference_cs");
        next = cs.reference_cs.as_deref();
    }
    match next {
        None => Ok(()),
        Some(_) => refuse(
            place,
            format!("the chain of reference_cs is longer than {MAX_CHAIN}"),
            "combine coordinate systems",
        ),
    }
}

// Components

fn check_component(place: &str, component: &Component) -> Result<()> {
    let config = key_of(place, "config");
    match component {
        Component::Lens(lens) => {
            coordinate_system(&key_of(place, "cs"), &lens.cs)?;
            check_lens(&config, &lens.config)
        }
        Component::Mirror(mirror) => {
            coordinate_system(&key_of(place, "cs"), &mirror.cs)?;
            check_mirror(&config, &mirror.config)
        }
        Component::Doublet(doublet) => {
            coordinate_system(&key_of(place, "cs"), &doublet.cs)?;
            check_doublet(&config, &doublet.config)
        }
    }
}

fn check_lens(place: &str, lens: &Lens) -> Result<()> {
    let at = |key| key_of(place, key);
    radius(at("r1"), lens.r1)?;
    radius(at("r2"), lens.r2)?;
    position(at("thickness"), lens.thickness)?;
    size(at("front_aperture_radius"), lens.front_aperture_radius)?;
    lens.back_aperture_radius.map_or(Ok(()), |r| size(at("back_aperture_radius"), r))?;
    conic_constant(at("conic1"), lens.conic1)?;
    conic_constant(at("conic2"), lens.conic2)
}

fn check_mirror(place: &str, mirror: &Mirror) -> Result<()> {
    let at = |key| key_of(place, key);
    radius(at("radius"), mirror.radius)?;
    fraction(at("reflectance"), mirror.reflectance)?;
    conic_constant(at("conic"), mirror.conic)?;
    size(at("aperture_radius"), mirror.aperture_radius)
}

fn check_doublet(place: &str, doublet: &Doublet) -> Result<()> {
    let at = |key| key_of(place, key);
    radius(at("r1"), doublet.r1)?;
    radius(at("r2"), doublet.r2)?;
    radius(at("r3"), doublet.r3)?;
    position(at("thickness1"), doublet.thickness1)?;
    position(at("thickness2"), doublet.thickness2)?;
    size(at("aperture_radius"), doublet.aperture_radius)?;
    conic_constant(at("conic1"), doublet.conic1)?;
    conic_constant(at("conic2"), doublet.conic2)?;
    conic_constant(at("conic3"), doublet.conic3)
}

// Sources

fn check_source(place: &str, source: &Source) -> Result<()> {
    coordinate_system(&key_of(place, "cs"), source.cs())?;
    check_spectrum(&key_of(place, "spectrum"), source.spectrum())?;
    source.check(&|key| key_of(place, key))?;
    let key = if source.total_flux_lumens().is_some() { "total_flux_lumens" } else { "total_flux" };
    total_flux(key_of(place, key), source.total_flux())
}

fn total_flux(place: String, flux: f64) -> Result<()> {
    if flux > 0.0 && flux < MIN_FLUX {
        let remedy = format!("give 0, or at least {MIN_FLUX:e} W");
        return refuse(place, format!("{flux:e} W is too little: results would be rounded to 0"), remedy);
    }
    between(place, flux, 0.0, 1e100)
}

fn check_spectrum(place: &str, spectrum: &Spectrum) -> Result<()> {
    let Spectrum { wavelengths, weights } = spectrum;
    check_table(place, wavelengths, "weights", weights)?;
    for (i, weight) in weights.iter().enumerate() {
        between(format!("{place}.weights[{i}]"), *weight, 0.0, 1e30)?;
    }
    if weights.iter().all(|weight| *weight == 0.0) {
        return refuse(key_of(place, "weights"), "all weights are 0", "give at least one weight above 0");
    }
    Ok(())
}

/// A table over wavelengths: not empty, as many values as wavelengths, each wavelength sensible.
fn check_table(place: &str, wavelengths: &[f64], key: &str, values: &[f64]) -> Result<()> {
    if wavelengths.is_empty() {
        return refuse(
            key_of(place, "wavelengths"),
            "the list is empty",
            "give at least one wavelength [um]",
        );
    }
    if wavelengths.len() != values.len() {
        let problem = format!("{} values for {} wavelengths", values.len(), wavelengths.len());
        return refuse(key_of(place, key), problem, "give one value per wavelength");
    }
    let mut each = wavelengths.iter().enumerate();
    each.try_for_each(|(i, value)| wavelength(format!("{place}.wavelengths[{i}]"), *value))
}

// Detectors

fn check_detector(place: &str, detector: &Detector) -> Result<()> {
    coordinate_system(&key_of(place, "cs"), detector.cs())?;
    detector.check(&|key| key_of(place, key))
}

// The whole

fn check_counts(file: &SceneFile) -> Result<()> {
    let lists = [
        ("components", file.components.len()),
        ("sources", file.sources.len()),
        ("detectors", file.detectors.len()),
        ("nsq_gpu.surfaces", file.nsq_gpu.as_ref().map_or(0, |block| block.surfaces.len())),
    ];
    if let Some((list, count)) = lists.into_iter().find(|(_, count)| *count > MAX_ITEMS) {
        return refuse(list, format!("{count} items are too many"), format!("give at most {MAX_ITEMS}"));
    }
    if file.sources.is_empty() {
        return refuse("sources", "the scene has no source", "add at least one source");
    }
    if file.detectors.is_empty() {
        return refuse("detectors", "the scene has no detector", "add at least one detector");
    }
    Ok(())
}

fn check_cells(file: &SceneFile) -> Result<()> {
    let mut total = 0u64;
    for (index, detector) in file.detectors.iter().enumerate() {
        let cells = detector.num_cells().unwrap_or(u64::MAX);
        total = total.saturating_add(cells);
        if total > MAX_CELLS {
            return refuse(
                format!("detectors[{index}]"),
                format!("its {cells} pixels or bins exceed what all detectors may have together"),
                format!("reduce the pixels or bins; {MAX_CELLS} in all are the limit"),
            );
        }
    }
    Ok(())
}

/// Media and reflectances are tables over all wavelengths, so their product is what takes memory.
fn check_wavelength_count(file: &SceneFile) -> Result<()> {
    let all = file.sources.iter().flat_map(|source| &source.spectrum().wavelengths);
    let distinct: HashSet<u64> = all.map(|x| x.to_bits()).collect();
    let surfaces = file.nsq_gpu.as_ref().map_or(0, |block| block.surfaces.len());
    let items = file.components.len() + file.sources.len() + surfaces;
    if distinct.len().saturating_mul(items) <= MAX_TABLES {
        return Ok(());
    }
    refuse(
        "sources",
        format!("{} distinct wavelengths are too many for {items} components and sources", distinct.len()),
        "use coarser spectra",
    )
}

fn check_total_flux(file: &SceneFile) -> Result<()> {
    if file.sources.iter().any(|source| source.total_flux() > 0.0) {
        return Ok(());
    }
    refuse("sources[0].total_flux", "no source emits any flux", "give at least one source a flux above 0 W")
}

/// Angles that are likely degrees by mistake. Such an angle is more than a full turn in radians, or a round number from
/// 2 on, such as 5 or 2.5. Round numbers are no round parts of a turn.
fn is_like_degrees(angle: f64) -> bool {
    const ROUND: f64 = 1e-9;
    let tenths = 10.0 * angle.abs();
    angle.abs() > std::f64::consts::TAU || (tenths >= 20.0 && (tenths - tenths.round()).abs() < ROUND)
}

/// Says where a rotation looks like degrees: of a frame, or of one that it is chained to.
fn warn_of_degrees(file: &SceneFile, warnings: &mut Vec<String>) {
    for (name, cs) in placed(file) {
        let chain = std::iter::successors(Some(cs), |cs| cs.reference_cs.as_deref());
        let mut angles =
            chain.enumerate().flat_map(|(links, cs)| [cs.rx, cs.ry, cs.rz].map(|angle| (links, angle)));
        if let Some((links, angle)) = angles.find(|(_, angle)| is_like_degrees(*angle)) {
            let turned =
                if links == 0 { quoted(name) } else { format!("a reference_cs of {}", quoted(name)) };
            warnings.push(format!(
                "{turned} is rotated by {angle} rad; rotations are in radians, so check that degrees were not meant"
            ));
        }
    }
}

// Names

fn check_names(file: &SceneFile) -> Result<()> {
    let raw = file.nsq_gpu.iter().flat_map(|block| &block.surfaces).enumerate();
    let raw = raw.map(|(i, surface)| (format!("nsq_gpu.surfaces[{i}].name"), surface.name.as_str()));
    let components =
        file.components.iter().enumerate().map(|(i, c)| (format!("components[{i}].name"), c.name()));
    check_distinct(components.chain(raw))?;
    check_distinct(file.sources.iter().enumerate().map(|(i, s)| (format!("sources[{i}].name"), s.name())))?;
    check_distinct(file.detectors.iter().enumerate().map(|(i, d)| (format!("detectors[{i}].name"), d.name())))
}

fn check_distinct<'a>(names: impl Iterator<Item = (String, &'a str)>) -> Result<()> {
    let mut seen = HashSet::new();
    for (place, name) in names {
        check_name(&place, name)?;
        if !seen.insert(name) {
            return refuse(place, format!("the name {} is taken", quoted(name)), "give each its own name");
        }
    }
    Ok(())
}

/// Any text is a name, as in Optiland: files get names of their own ([`crate::result::output`]).
fn check_name(place: &str, name: &str) -> Result<()> {
    if name.len() <= MAX_NAME {
        return Ok(());
    }
    let problem = format!("the name is {} bytes long: {}", name.len(), quoted(name));
    refuse(place, problem, format!("give at most {MAX_NAME}"))
}

// The block

fn check_block(block: &Block, file: &SceneFile) -> Result<()> {
    for (name, medium) in &block.media {
        let place = key_of("nsq_gpu.media", name);
        check_name(&place, name)?;
        check_medium(&place, medium)?;
    }
    each("nsq_gpu.surfaces", &block.surfaces, check_raw_surface)?;
    for (name, change) in &block.overrides {
        check_override(&key_of("nsq_gpu.overrides", name), change)?;
    }
    check_detector_extras(block, file)?;
    check_sampling("nsq_gpu.sampling", &block.sampling)
}

fn check_medium(place: &str, medium: &Medium) -> Result<()> {
    let index = |place: String, n: f64| between(place, n, 1e-6, 1e3);
    let extinction = |place: String, k: f64| between(place, k, 0.0, 1e6);
    match medium {
        Medium::Constant { n, k } => {
            index(key_of(place, "n"), *n)?;
            extinction(key_of(place, "k"), *k)
        }
        Medium::Table { wavelengths, n, k } => {
            check_table(place, wavelengths, "n", n)?;
            n.iter().enumerate().try_for_each(|(i, n)| index(format!("{place}.n[{i}]"), *n))?;
            let Some(k) = k else { return check_no_repeats(place, wavelengths) };
            check_table(place, wavelengths, "k", k)?;
            k.iter().enumerate().try_for_each(|(i, k)| extinction(format!("{place}.k[{i}]"), *k))?;
            check_no_repeats(place, wavelengths)
        }
        Medium::Catalog { .. } => Ok(()),
    }
}

pub(super) fn check_no_repeats(place: &str, wavelengths: &[f64]) -> Result<()> {
    let mut seen = HashSet::new();
    match wavelengths.iter().position(|x| !seen.insert(x.to_bits())) {
        None => Ok(()),
        Some(i) => refuse(
            format!("{place}.wavelengths[{i}]"),
            format!("{} um is listed twice", wavelengths[i]),
            "give each wavelength one value",
        ),
    }
}

pub(super) fn check_reflectance(place: &str, reflectance: &Reflectance) -> Result<()> {
    match reflectance {
        Reflectance::Constant(value) => fraction(place.to_owned(), *value),
        Reflectance::Table { wavelengths, values } => {
            check_table(place, wavelengths, "values", values)?;
            values
                .iter()
                .enumerate()
                .try_for_each(|(i, value)| fraction(format!("{place}.values[{i}]"), *value))?;
            check_no_repeats(place, wavelengths)
        }
    }
}

fn check_raw_surface(place: &str, surface: &RawSurface) -> Result<()> {
    let at = |key| key_of(place, key);
    coordinate_system(&at("cs"), &surface.cs)?;
    surface.shape.check(&|key| key_of(&at("shape"), key))?;
    surface.reflectance.as_ref().map_or(Ok(()), |r| check_reflectance(&at("reflectance"), r))?;
    surface.bsdf.as_ref().map_or(Ok(()), |bsdf| bsdf.check(&|key| key_of(&at("bsdf"), key)))?;
    check_scatter_fraction(at("scatter_fraction"), surface.scatter_fraction)?;
    surface.coating.as_ref().map_or(Ok(()), |coating| coating.check(&at("coating")))
}

fn check_override(place: &str, change: &Override) -> Result<()> {
    let at = |key| key_of(place, key);
    change.aperture_radius.map_or(Ok(()), |r| size(at("aperture_radius"), r))?;
    change.reflectance.as_ref().map_or(Ok(()), |r| check_reflectance(&at("reflectance"), r))?;
    change.bsdf.as_ref().map_or(Ok(()), |bsdf| bsdf.check(&|key| key_of(&at("bsdf"), key)))?;
    change.scatter_fraction.map_or(Ok(()), |f| check_scatter_fraction(at("scatter_fraction"), f))?;
    change.coating.as_ref().map_or(Ok(()), |coating| coating.check(&at("coating")))
}

fn check_scatter_fraction(place: String, value: ScatterFraction) -> Result<()> {
    match value {
        ScatterFraction::Constant(value) => fraction(place, value),
        // What it amounts to is known where the scatter model is made.
        ScatterFraction::Tis => Ok(()),
    }
}

fn check_detector_extras(block: &Block, file: &SceneFile) -> Result<()> {
    let by_name: HashMap<&str, &Detector> = file.detectors.iter().map(|d| (d.name(), d)).collect();
    for (name, extra) in &block.detectors {
        let place = key_of("nsq_gpu.detectors", name);
        let Some(detector) = by_name.get(name.as_str()) else {
            let advice = did_you_mean(name, file.detectors.iter().map(Detector::name));
            return refuse(place, "no detector has this name", advice);
        };
        if extra.max_rays.is_some() && !detector.stores_rays() {
            return refuse(
                key_of(&place, "max_rays"),
                "the detector stores no rays",
                "remove it, or use a ray_database",
            );
        }
    }
    Ok(())
}

fn check_sampling(place: &str, sampling: &SamplingPolicy) -> Result<()> {
    if let ReflectProb::Constant(p) = sampling.reflect_prob {
        fraction(key_of(place, "reflect_prob"), p)?;
    }
    between(key_of(place, "rr_start_flux"), sampling.rr_start_flux, 0.0, 1e30)?;
    between(key_of(place, "split_budget"), sampling.split_budget, 1e-3, 1e6)?;
    between(
        key_of(place, "split_depth"),
        f64::from(sampling.split_depth),
        0.0,
        f64::from(Sampling::MAX_SPLIT_DEPTH),
    )
}
