//! BSDFs for the shaders: columns of the surfaces' records, and tables. The formulas stand in shaders/bsdfs/; here are the
//! numbers that depend on the scene alone.

use crate::model::{Bsdf, BsdfTable, Scatter, SceneIr, Surface, harvey_shack_table};
use crate::program::layout::records::Records;
use std::f64::consts::PI;

/// Functions of the shaders; the discriminants are their codes, 0 being none.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum BsdfKind {
    /// shaders/bsdfs/specular.wgsl
    Specular = 1,
    /// shaders/bsdfs/lambertian.wgsl
    Lambertian = 2,
    /// shaders/bsdfs/harvey_shack.wgsl
    HarveyShack = 3,
    /// shaders/bsdfs/tabulated.wgsl
    Tabulated = 4,
}

impl BsdfKind {
    /// The function that samples a BSDF.
    pub fn of(bsdf: &Bsdf) -> Self {
        match bsdf {
            Bsdf::Specular => BsdfKind::Specular,
            Bsdf::Lambertian { .. } => BsdfKind::Lambertian,
            Bsdf::HarveyShack { .. } => BsdfKind::HarveyShack,
            Bsdf::Tabulated { .. } => BsdfKind::Tabulated,
        }
    }

    /// The name in the shaders.
    pub fn name(self) -> &'static str {
        match self {
            BsdfKind::Specular => "specular",
            BsdfKind::Lambertian => "lambertian",
            BsdfKind::HarveyShack => "harvey_shack",
            BsdfKind::Tabulated => "tabulated",
        }
    }

    /// True if it reads the tables.
    pub fn has_table(self) -> bool {
        matches!(self, BsdfKind::HarveyShack | BsdfKind::Tabulated)
    }
}

/// The kinds that occur, without repetition.
pub fn kinds(ir: &SceneIr) -> Vec<BsdfKind> {
    let mut kinds: Vec<BsdfKind> = scatters(ir).map(|scatter| BsdfKind::of(&scatter.bsdf)).collect();
    kinds.sort();
    kinds.dedup();
    kinds
}

/// Every scattering of the scene.
pub fn scatters(ir: &SceneIr) -> impl Iterator<Item = &Scatter> {
    ir.surfaces.iter().filter_map(|surface| surface.scatter.as_ref())
}

/// How the branch of scattering is drawn: with Optiland's clipped fraction, and weights that undo the clipping.
struct Branch {
    fraction: f64,
    scatter_weight: f64,
    pass_weight: f64,
}

impl Branch {
    fn of(surface: &Surface) -> Self {
        const LEAST: f64 = 1e-6;
        let wanted = surface.scatter.as_ref().map_or(0.0, |scatter| scatter.fraction);
        let fraction = wanted.clamp(LEAST, 1.0 - LEAST);
        Branch { fraction, scatter_weight: wanted / fraction, pass_weight: (1.0 - wanted) / (1.0 - fraction) }
    }
}

/// Adds what shaders/stages/scatter.on.wgsl and shaders/bsdfs/ read of a surface.
pub fn put_columns(records: &mut Records, ir: &SceneIr, kinds: &[BsdfKind]) {
    if kinds.is_empty() {
        return;
    }
    let bsdfs = || ir.surfaces.iter().map(|surface| surface.scatter.as_ref().map(|scatter| &scatter.bsdf));
    let branches: Vec<Branch> = ir.surfaces.iter().map(Branch::of).collect();
    records.uint("bsdf", bsdfs().map(|bsdf| bsdf.map_or(0, |bsdf| BsdfKind::of(bsdf) as u32)));
    records.real("scatter_fraction", branches.iter().map(|branch| branch.fraction));
    records.real("scatter_weight", branches.iter().map(|branch| branch.scatter_weight));
    records.real("pass_weight", branches.iter().map(|branch| branch.pass_weight));
    records.real("transmissive_fraction", bsdfs().map(|bsdf| bsdf.map_or(0.0, Bsdf::transmissive_fraction)));
    if kinds.contains(&BsdfKind::Lambertian) {
        records.real("lambertian", bsdfs().map(reflectance_value));
    }
    if kinds.iter().any(|kind| kind.has_table()) {
        records.uint("bsdf_table", table_starts(ir));
    }
    if kinds.contains(&BsdfKind::Tabulated) {
        records.uint(
            "num_theta_i",
            bsdfs().map(|bsdf| table_of(bsdf).map_or(0, |table| table.theta_i.len() as u32)),
        );
        records.uint(
            "num_theta_s",
            bsdfs().map(|bsdf| table_of(bsdf).map_or(0, |table| table.theta_s.len() as u32)),
        );
    }
}

fn reflectance_value(bsdf: Option<&Bsdf>) -> f64 {
    match bsdf {
        Some(Bsdf::Lambertian { reflectance_value, .. }) => *reflectance_value,
        Some(Bsdf::Specular | Bsdf::HarveyShack { .. } | Bsdf::Tabulated { .. }) | None => 0.0,
    }
}

fn table_of(bsdf: Option<&Bsdf>) -> Option<&BsdfTable> {
    match bsdf {
        Some(Bsdf::Tabulated { table, .. }) => Some(table),
        Some(Bsdf::Specular | Bsdf::Lambertian { .. } | Bsdf::HarveyShack { .. }) | None => None,
    }
}

/// Surfaces of equal BSDFs share a table: lenses by the dozen have the same polish.
fn distinct(ir: &SceneIr) -> Vec<&Bsdf> {
    let mut distinct: Vec<&Bsdf> = Vec::new();
    for Scatter { bsdf, .. } in scatters(ir).filter(|scatter| BsdfKind::of(&scatter.bsdf).has_table()) {
        if !distinct.contains(&bsdf) {
            distinct.push(bsdf);
        }
    }
    distinct
}

/// Where each surface's table begins.
fn table_starts(ir: &SceneIr) -> Vec<u32> {
    let distinct = distinct(ir);
    let mut next = 0;
    let starts: Vec<u32> = distinct
        .iter()
        .map(|bsdf| {
            let start = next;
            next += table(bsdf).len() as u32;
            start
        })
        .collect();
    let start_of = |surface: &Surface| {
        let bsdf = &surface.scatter.as_ref()?.bsdf;
        distinct.iter().position(|other| *other == bsdf).map(|i| starts[i])
    };
    ir.surfaces.iter().map(|surface| start_of(surface).unwrap_or(0)).collect()
}

/// All tables, one after the other: the buffer of shaders/optics/bsdf_table.wgsl.
pub fn tables(ir: &SceneIr) -> Vec<f64> {
    distinct(ir).into_iter().flat_map(table).collect()
}

fn table(bsdf: &Bsdf) -> Vec<f64> {
    match bsdf {
        Bsdf::Specular | Bsdf::Lambertian { .. } => Vec::new(),
        Bsdf::HarveyShack { b0, l0, s, .. } => harvey_shack_table(*b0, *l0, *s).0,
        Bsdf::Tabulated { table, .. } => tabulated_table(table),
    }
}

/// See shaders/bsdfs/tabulated.wgsl.
fn tabulated_table(table: &BsdfTable) -> Vec<f64> {
    let weights = table.values.iter().map(|value| PI * value);
    table.theta_i.iter().chain(&table.theta_s).copied().chain(weights).collect()
}
