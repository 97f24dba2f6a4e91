//! How a scene becomes what its program is made from.

use crate::error::Result;
use crate::model::{SceneIr, ray_id};
use crate::program::addition::ProgramAddition;
use crate::program::features::Features;
use crate::program::geometry::contact::Contacts;
use crate::program::geometry::{bvh, mesh, tree};
use crate::program::input::{ProgramInput, centre_of};
use crate::program::layout::kind_tables::KindTables;
use crate::program::layout::splitting::Splitting;
use crate::program::layout::tables::{Cells, FacetTable};
use crate::program::options::{ProgramOptions, SecondMoments};

impl<'a> ProgramInput<'a> {
    /// Prepares a scene, as its additions ask for.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] if there are too many cells to number, or the precision cannot hold one of the scene's numbers.
    pub fn of(
        ir: &'a SceneIr,
        mut options: ProgramOptions,
        additions: &[&dyn ProgramAddition],
    ) -> Result<Self> {
        let draws_branches = additions.iter().any(|addition| addition.draws_branches());
        let features = Features::of(ir, &options.weights, options.roulette_threshold, options.max_depth)
            .with_branches_drawn(draws_branches);
        let splitting = features.splits.then(|| Splitting::of(&ir.sampling));
        if splitting.is_some() {
            // A family waits in registers, and so stays with its invocation to its end.
            options.events_per_dispatch = options.max_depth;
        }
        additions.iter().for_each(|addition| addition.adapt_options(&features, &mut options));
        let centre = centre_of(ir);
        let cells = additions.iter().try_fold(Cells::of(ir), |cells, addition| addition.cells(cells))?;
        let cells = match options.moments {
            SecondMoments::None => cells,
            SecondMoments::Squares => cells.with_moments(ir)?,
            SecondMoments::Replicates => cells.with_replicates(ray_id::NUM_REPLICATES)?,
        };
        let has_tree = !options.tree_primitives(ir).is_empty();
        // Only meshes of a surface are searched.
        let meshes = if features.has_meshes() { &ir.meshes[..] } else { &[] };
        let mut forest = bvh::Forest::of_roots(meshes.len() + usize::from(has_tree));
        let triangles = mesh::Triangles::of(meshes, &mut forest);
        let contacts = Contacts::of(ir, centre, options.precision)?;
        let facets = FacetTable::of(ir, &contacts, &triangles);
        let places = KindTables::of(ir);
        let tree = has_tree.then(|| {
            let boxes = tree::boxes(ir, centre, &contacts);
            let in_tree = options.tree_primitives(ir);
            let mut tree = tree::PrimitiveTree::of(&boxes[in_tree], &mut forest, meshes.len());
            let num_others = forest.num_rows() + triangles.num_rows();
            tree.records = options.records_in_texels(ir, centre, tree.primitives(), &places, num_others);
            tree
        });
        // Squares are sums that do not follow from counts.
        let constant_weights = !additions.iter().any(|addition| addition.sums_weights())
            && features.whole_weights
            && options.moments != SecondMoments::Squares
            && options.weights.iter().all(|weight| *weight == options.weights[0]);
        Ok(ProgramInput {
            ir,
            places,
            options,
            features,
            splitting,
            centre,
            cells,
            forest,
            triangles,
            contacts,
            facets,
            tree,
            constant_weights,
        })
    }
}
