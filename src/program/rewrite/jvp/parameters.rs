//! The parameters by which a trace is differentiated.

use crate::model::SceneIr;

/// Parameters by which a trace is differentiated.
#[derive(Debug, Clone, PartialEq)]
pub struct Tangents {
    /// In the order of the sums.
    pub parameters: Vec<Parameter>,
}

/// One parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameter {
    /// What users call it.
    pub name: String,
    /// Scenes about the one that is traced, each with its factor. Take one number of each scene, times that scene's
    /// factor: the sum is the number's derivative.
    pub stencil: Vec<(f64, SceneIr)>,
}

impl Tangents {
    /// The number of parameters.
    pub fn num(&self) -> u32 {
        self.parameters.len() as u32
    }
}
