//! The data from which the text of a module is composed.

use crate::error::Result;
use crate::model::Precision;
use crate::program::input::ProgramInput;
use crate::program::layout::numbers::Numbers;
use crate::program::layout::sums::SumBuffers;
use glam::DVec3;
use std::ops::Deref;

/// The data of a composition: a prepared scene, to which it dereferences, and the buffers of its cells.
pub struct Composition<'a> {
    scene: &'a ProgramInput<'a>,
    /// The buffers that the cells lie in.
    pub sums: &'a SumBuffers,
    /// The numbers of the scene that the text has so far.
    pub numbers: Numbers,
}

impl<'a> Deref for Composition<'a> {
    type Target = ProgramInput<'a>;

    fn deref(&self) -> &Self::Target {
        self.scene
    }
}

impl<'a> Composition<'a> {
    /// The composition of a scene whose sums lie in these buffers.
    pub fn of(scene: &'a ProgramInput<'a>, sums: &'a SumBuffers) -> Self {
        let numbers = {
            let options = &scene.options;
            Numbers::new(options.precision, options.live, options.copies_numbers)
        };
        Composition { scene, sums, numbers }
    }

    /// The precision of the physics.
    pub fn precision(&self) -> Precision {
        self.options.precision
    }

    /// A number of the scene as WGSL has it.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] if the precision cannot hold it.
    pub fn real(&self, value: f64) -> Result<String> {
        self.numbers.expression(value)
    }

    /// A vector as WGSL has it.
    pub(super) fn vector(&self, v: DVec3) -> Result<String> {
        let [x, y, z] = [self.real(v.x)?, self.real(v.y)?, self.real(v.z)?];
        Ok(format!("vec3<real>({x}, {y}, {z})"))
    }

    /// All primitives: surfaces, then detectors.
    pub(super) fn num_primitives(&self) -> usize {
        self.ir.surfaces.len() + self.ir.detectors.len()
    }
}
