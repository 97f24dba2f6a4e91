//! A scene as its program has it, before any WGSL is composed: features, cells, trees and contacts.

use crate::error::Result;
use crate::model::primitives::primitives;
use crate::model::{SceneIr, ray_id};
use crate::program::features::Features;
use crate::program::geometry::contact::Contacts;
use crate::program::geometry::{bvh, mesh, tree};
use crate::program::layout::kind_tables::Places;
use crate::program::layout::splitting::Splitting;
use crate::program::layout::tables::{Cells, FacetTable};
use crate::program::options::{ProgramOptions, SecondMoments};
use glam::DVec3;

/// What compositions and their extensions are made from.
#[derive(Debug)]
pub struct ProgramInput<'a> {
    /// The scene.
    pub ir: &'a SceneIr,
    /// How to specialise.
    pub options: ProgramOptions,
    /// Its features.
    pub features: Features,
    /// Limits of splitting, where rays are split.
    pub splitting: Option<Splitting>,
    /// The centre of the scene \[mm\].
    pub centre: DVec3,
    /// Its cells.
    pub cells: Cells,
    /// Where tables of shapes and sources begin.
    pub places: Places,
    /// The trees over its meshes and its primitives.
    pub forest: bvh::Forest,
    /// The triangles of its meshes.
    pub triangles: mesh::Triangles,
    /// Which of its faces are in contact.
    pub contacts: Contacts,
    /// The contacts of facets.
    pub facets: FacetTable,
    /// The tree over its primitives, if they are searched by one.
    pub tree: Option<tree::PrimitiveTree>,
    /// Every ray has at all times the weight that all are born with.
    pub constant_weights: bool,
}

/// What additions change.
pub struct Changes<'c> {
    /// Changes how the program is specialised, now that the features of the scene are known.
    pub prepare: &'c dyn Fn(&Features, &mut ProgramOptions),
    /// Adds cells.
    pub cells: &'c dyn Fn(Cells) -> Result<Cells>,
    /// Weights are summed even where a count of rays would give their sum.
    pub sums_weights: bool,
}

impl<'a> ProgramInput<'a> {
    /// Prepares a scene.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] if there are too many cells to number, or the precision cannot hold one of the scene's numbers.
    pub fn of(ir: &'a SceneIr, mut options: ProgramOptions, changes: &Changes) -> Result<Self> {
        let features = Features::of(ir, &options.weights, options.roulette_threshold, options.max_depth);
        let splitting = features.splits.then(|| Splitting::of(&ir.sampling));
        if splitting.is_some() {
            // A family waits in registers, and so stays with its invocation to its end.
            options.events_per_dispatch = options.max_depth;
        }
        (changes.prepare)(&features, &mut options);
        let centre = centre_of(ir);
        let cells = (changes.cells)(Cells::of(ir))?;
        let cells = match options.moments {
            SecondMoments::None => cells,
            SecondMoments::Squares => cells.with_moments(ir)?,
            SecondMoments::Replicates => cells.with_replicates(ray_id::NUM_REPLICATES)?,
        };
        let has_tree = !options.tree_primitives(ir).is_empty();
        // Of meshes that no surface has nothing is searched.
        let meshes = if features.has_meshes() { &ir.meshes[..] } else { &[] };
        let mut forest = bvh::Forest::of_roots(meshes.len() + usize::from(has_tree));
        let triangles = mesh::Triangles::of(meshes, &mut forest);
        let contacts = Contacts::of(ir, centre, options.precision)?;
        let facets = FacetTable::of(ir, &contacts, &triangles);
        let tree = has_tree.then(|| {
            let boxes = tree::boxes(ir, centre, &contacts);
            let in_tree = options.tree_primitives(ir);
            let mut tree = tree::PrimitiveTree::of(&boxes[in_tree], &mut forest, meshes.len());
            let num_others = forest.num_rows() + triangles.num_rows();
            tree.records = options.records_in_texels(ir, centre, tree.primitives(), num_others);
            tree
        });
        // Squares are sums that no count tells.
        let constant_weights = !changes.sums_weights
            && features.whole_weights
            && options.moments != SecondMoments::Squares
            && options.weights.iter().all(|weight| *weight == options.weights[0]);
        Ok(ProgramInput {
            ir,
            places: Places::of(ir),
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

/// The middle of all origins, so that coordinates on the device are of the scene's size, not of its distance.
pub fn centre_of(ir: &SceneIr) -> DVec3 {
    let frames = primitives(ir).into_iter().map(|(frame, _)| frame);
    let origins = frames.chain(ir.sources.iter().map(|e| e.frame)).map(|frame| frame.origin);
    let bounds = origins.fold(None, |bounds: Option<(DVec3, DVec3)>, origin| match bounds {
        None => Some((origin, origin)),
        Some((low, high)) => Some((low.min(origin), high.max(origin))),
    });
    bounds.map_or(DVec3::ZERO, |(low, high)| 0.5 * (low + high))
}
