//! A scene as its program has it, before any WGSL is composed: features, cells, trees and contacts.

use crate::model::SceneIr;
use crate::model::primitives::primitives;
use crate::program::features::Features;
use crate::program::geometry::contact::Contacts;
use crate::program::geometry::{bvh, mesh, tree};
use crate::program::layout::kind_tables::KindTables;
use crate::program::layout::splitting::Splitting;
use crate::program::layout::tables::{Cells, FacetTable};
use crate::program::options::ProgramOptions;
use glam::DVec3;

/// What compositions and additions are made from.
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
    pub places: KindTables,
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
