//! Detectors of scene files -> detectors of the model.

use crate::model::Detector;
use crate::scene::frame::frame_of;
use crate::scene::json::{self, DetectorExtra};

/// The detector, with what the block says of it.
pub(crate) fn lowered(written: &json::Detector, extra: Option<&DetectorExtra>) -> Detector {
    Detector {
        name: written.name().to_owned(),
        frame: frame_of(written.cs()),
        kind: written.kind(extra),
        absorb: written.absorb(),
    }
}
