//! Coordinate systems -> frames.

use glam::{DMat3, DVec3};

use crate::model::Frame;
use crate::scene::json::CoordinateSystem;

/// The frame of a coordinate system in global coordinates: `R = Rz Ry Rx`, chained through `reference_cs`.
pub(crate) fn frame_of(cs: &CoordinateSystem) -> Frame {
    // The chain is short: validation bounds it.
    let mut chain = vec![cs];
    while let Some(outer) = chain.last().and_then(|cs| cs.reference_cs.as_deref()) {
        chain.push(outer);
    }
    let global = Frame { origin: DVec3::ZERO, rotation: DMat3::IDENTITY };
    chain.iter().rev().fold(global, |outer, cs| within(&outer, local_of(cs)))
}

/// The frame moved along its own z axis \[mm\].
pub(super) fn shifted(frame: &Frame, dz: f64) -> Frame {
    moved(frame, DVec3::new(0.0, 0.0, dz))
}

/// The frame moved within itself \[mm\].
pub(super) fn moved(frame: &Frame, by: DVec3) -> Frame {
    Frame { origin: frame.origin + frame.rotation * by, rotation: frame.rotation }
}

fn local_of(cs: &CoordinateSystem) -> Frame {
    let rotation =
        DMat3::from_rotation_z(cs.rz) * DMat3::from_rotation_y(cs.ry) * DMat3::from_rotation_x(cs.rx);
    Frame { origin: DVec3::new(cs.x, cs.y, cs.z), rotation }
}

fn within(outer: &Frame, inner: Frame) -> Frame {
    Frame { origin: outer.origin + outer.rotation * inner.origin, rotation: outer.rotation * inner.rotation }
}
