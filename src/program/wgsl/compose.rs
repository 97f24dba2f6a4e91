//! Composition of the WGSL for one scene: files of shaders/ as they are, and around them only constants, records and
//! calls. No formula is written here.

use crate::error::Result;
use crate::model::SceneIr;
use crate::program::ProgramOptions;
use crate::program::features::{Features, Precision};
use crate::program::geometry::bvh::Forest;
use crate::program::geometry::contact::Contacts;
use crate::program::geometry::mesh::Triangles;
use crate::program::geometry::tree::PrimitiveTree;
use crate::program::layout::records::literal;
use crate::program::layout::sums::SumBuffers;
use crate::program::layout::tables::{Cells, FacetTable};
use crate::program::wgsl::extension::Extension;
use crate::program::wgsl::library::{self, Integers, Real};
use crate::program::wgsl::text::{Text, shader};
use glam::DVec3;

/// The shader that prepares the next dispatch of a pass.
pub const ADVANCE: &str = shader!("stages/advance.wgsl").text;

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
    /// What is added to the plain module.
    pub extension: &'a dyn Extension,
    /// How to specialise.
    pub options: &'a ProgramOptions,
}

impl Composition<'_> {
    /// The whole module: the library, the constants, the files that the scene needs (`variants`), and then what is written
    /// for the scene itself. Each part stands below a comment that names the file, or the module that composes it.
    pub fn compose(&self) -> Result<String> {
        let mut text = Text::default();
        library::add(&mut text, self.real_type(), self.integers(), self.options.sampler);
        text.composed("program::wgsl::constants", &self.constants()?);
        text.files(self.files());
        text.composed("program::wgsl::variants", &self.drawn_branch());
        text.composed("program::wgsl::rows", &self.rows()?);
        text.composed("program::wgsl::search", &self.nearest_primitive()?);
        text.composed("program::wgsl::trees", &self.waiting());
        self.extension.add(self, &mut text)?;
        text.composed("program::wgsl::bins", &self.bins());
        text.composed("program::wgsl::dispatch", &self.dispatch()?);
        self.sums.cut(text.into_string())
    }

    fn real_type(&self) -> Real {
        match self.precision() {
            Precision::F32 => Real::F32,
            Precision::Df64 => Real::Df64,
            Precision::F64 => Real::F64,
        }
    }

    fn integers(&self) -> Integers {
        if self.options.native { Integers::Native } else { Integers::Portable }
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
