//! What a ray can meet: surfaces and detectors in one list.

use crate::model::{Frame, SceneIr, Shape};

/// Every primitive: surfaces, then detectors.
pub fn primitives(ir: &SceneIr) -> Vec<(Frame, Shape)> {
    let surfaces = ir.surfaces.iter().map(|s| (s.frame, s.shape.clone()));
    surfaces.chain(ir.detectors.iter().map(|s| (s.frame, Shape::Plane(s.outline())))).collect()
}
