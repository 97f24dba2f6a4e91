//! BSDFs for the shaders: where the numbers of all of them lie, as columns of the surfaces' records and in one buffer of
//! tables. What the numbers are, each file of [`crate::model::bsdfs`] says.

use crate::model::{Bsdf, BsdfKind, Scatter, ScatterSampling, SceneIr, Surface};
use crate::program::layout::kind_tables::KindTables;
use crate::program::layout::row_table::RowTable;

/// The kinds that occur, without repetition.
pub fn kinds(ir: &SceneIr) -> Vec<BsdfKind> {
    BsdfKind::distinct(scatters(ir).map(|scatter| scatter.bsdf.kind()))
}

/// Every scattering of the scene.
pub fn scatters(ir: &SceneIr) -> impl Iterator<Item = &Scatter> {
    ir.surfaces.iter().filter_map(|surface| surface.scatter.as_ref())
}

/// How the branch of scattering is drawn: with Optiland's clipped fraction or a probability of the user's, and weights that undo
/// either.
struct Branch {
    fraction: f64,
    scatter_weight: f64,
    pass_weight: f64,
}

impl Branch {
    fn of(surface: &Surface, sampling: Option<&ScatterSampling>) -> Self {
        const LEAST: f64 = 1e-6;
        let wanted = surface.scatter.as_ref().map_or(0.0, |scatter| scatter.fraction);
        let chosen = sampling.and_then(|sampling| sampling.prob);
        let fraction = chosen.unwrap_or(wanted).clamp(LEAST, 1.0 - LEAST);
        Branch { fraction, scatter_weight: wanted / fraction, pass_weight: (1.0 - wanted) / (1.0 - fraction) }
    }
}

/// Adds what shaders/stages/scatter.on.wgsl, shaders/bsdfs/ and shaders/scatter_to/ read of a surface.
pub fn put_columns(records: &mut RowTable, ir: &SceneIr, kinds: &[BsdfKind], places: &KindTables) {
    if kinds.is_empty() {
        return;
    }
    let bsdfs = || ir.surfaces.iter().map(|surface| surface.scatter.as_ref().map(|scatter| &scatter.bsdf));
    let samplings = || ir.scatter_sampling.iter().map(Some).chain(std::iter::repeat(None));
    let rows = || ir.surfaces.iter().zip(samplings());
    let branches: Vec<Branch> = rows().map(|(surface, sampling)| Branch::of(surface, sampling)).collect();
    records.uint("bsdf", bsdfs().map(|bsdf| bsdf.map_or(0, |bsdf| bsdf.kind().code())));
    records.real("scatter_fraction", branches.iter().map(|branch| branch.fraction));
    records.real("scatter_weight", branches.iter().map(|branch| branch.scatter_weight));
    records.real("pass_weight", branches.iter().map(|branch| branch.pass_weight));
    records.real(
        "transmissive_fraction",
        bsdfs().map(|bsdf| bsdf.map_or(0.0, |bsdf| bsdf.transmissive_fraction())),
    );
    for (name, values) in columns(ir, kinds, |bsdf| bsdf.reals()) {
        records.real(name, values);
    }
    if kinds.iter().any(|kind| kind.has_table()) {
        let start_of = |bsdf: &Bsdf| places.start_of(&bsdf.table()).unwrap_or(0) as u32;
        records.uint("bsdf_table", bsdfs().map(|bsdf| bsdf.map_or(0, start_of)));
    }
    for (name, values) in columns(ir, kinds, |bsdf| bsdf.counts()) {
        records.uint(name, values);
    }
    if ir.scatter_sampling.iter().any(|sampling| !sampling.targets.is_empty()) {
        let start_of = |(surface, sampling): (&Surface, Option<&ScatterSampling>)| {
            sampling.and_then(|sampling| places.start_of(&sampling.table(surface.frame.origin))).unwrap_or(0)
                as u32
        };
        records.uint("targets", rows().map(start_of));
        let num_targets = |sampling: &ScatterSampling| sampling.targets.len() as u32;
        records.uint("num_targets", rows().map(|(_, sampling)| sampling.map_or(0, num_targets)));
    }
}

/// Columns that BSDFs ask for, kind by kind, with a value for each surface: 0 where its BSDF asks for no such column.
fn columns<T: Copy + Default>(
    ir: &SceneIr,
    kinds: &[BsdfKind],
    of: impl Fn(&Bsdf) -> Vec<(&'static str, T)>,
) -> Vec<(&'static str, Vec<T>)> {
    let mut names: Vec<&'static str> = Vec::new();
    for kind in kinds {
        let example = scatters(ir).map(|scatter| &scatter.bsdf).find(|bsdf| bsdf.kind() == *kind);
        for (name, _) in example.map(&of).unwrap_or_default() {
            if !names.contains(&name) {
                names.push(name);
            }
        }
    }
    let value = |surface: &Surface, name: &str| {
        let columns = surface.scatter.as_ref().map(|scatter| of(&scatter.bsdf)).unwrap_or_default();
        columns.into_iter().find(|(known, _)| *known == name).map_or(T::default(), |(_, value)| value)
    };
    let column = |name| (name, ir.surfaces.iter().map(|surface| value(surface, name)).collect());
    names.into_iter().map(column).collect()
}
