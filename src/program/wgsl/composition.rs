//! What the text of a module is composed from.

use crate::error::Result;
use crate::model::SceneIr;
use crate::program::features::{Features, Precision};
use crate::program::geometry::bvh::Forest;
use crate::program::geometry::contact::Contacts;
use crate::program::geometry::mesh::Triangles;
use crate::program::geometry::tree::PrimitiveTree;
use crate::program::layout::records::literal;
use crate::program::layout::sums::SumBuffers;
use crate::program::layout::tables::{Cells, FacetTable};
use crate::program::options::ProgramOptions;
use crate::program::prepared::Prepared;
use glam::DVec3;

/// What a composition is made from.
pub struct Composition<'a> {
    /// The scene.
    pub ir: &'a SceneIr,
    /// Its features.
    pub features: &'a Features,
    /// The centre of the scene \[mm\].
    pub centre: DVec3,
    /// Its cells.
    pub cells: &'a Cells,
    /// The buffers that they lie in.
    pub sums: &'a SumBuffers,
    /// The trees over its meshes and its primitives.
    pub forest: &'a Forest,
    /// The triangles of its meshes.
    pub triangles: &'a Triangles,
    /// Which of its faces are in contact.
    pub contacts: &'a Contacts,
    /// The contacts of facets.
    pub facets: &'a FacetTable,
    /// The tree over its primitives, if they are searched by one.
    pub tree: Option<&'a PrimitiveTree>,
    /// Every ray has at all times the weight that all are born with.
    pub constant_weights: bool,
    /// How to specialise.
    pub options: &'a ProgramOptions,
}

impl<'a> Composition<'a> {
    /// The composition of a scene whose sums lie in these buffers.
    pub fn of(scene: &'a Prepared<'a>, sums: &'a SumBuffers) -> Self {
        Composition {
            ir: scene.ir,
            features: &scene.features,
            centre: scene.centre,
            cells: &scene.cells,
            sums,
            forest: &scene.forest,
            triangles: &scene.triangles,
            contacts: &scene.contacts,
            facets: &scene.facets,
            tree: scene.tree.as_ref(),
            constant_weights: scene.constant_weights,
            options: &scene.options,
        }
    }

    /// That of the physics.
    pub fn precision(&self) -> Precision {
        self.options.precision
    }

    /// A number as WGSL has it.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] if the precision cannot hold it.
    pub fn real(&self, value: f64) -> Result<String> {
        literal(value, self.precision())
    }

    /// A vector as WGSL has it.
    pub(super) fn vector(&self, v: DVec3) -> Result<String> {
        let [x, y, z] = [self.real(v.x)?, self.real(v.y)?, self.real(v.z)?];
        Ok(format!("vec3<real>({x}, {y}, {z})"))
    }

    /// All primitives: surfaces, then detectors.
    pub(super) fn num_primitives(&self) -> usize {
        self.ir.surfaces.len() + self.ir.sensors.len()
    }
}
