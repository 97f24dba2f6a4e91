//! How many events a ray of a scene should be followed for.

use crate::model::{Interaction, SceneIr};

/// Optiland's largest number of events of a ray, where none is given.
pub const OPTILANDS: u32 = 16;

/// Most events that can be asked for.
pub const LIMIT: u32 = 1 << 20;

/// The largest number of events of a ray that commands take for a scene, where none is given. A ray may go through every
/// surface, and through half of them forth and back, before it comes to a detector.
pub fn of_scene(ir: &SceneIr) -> u32 {
    passing_all(ir, 2)
}

/// The same where rays are guided to ghosts. A ray that the last face reflects, and then the first, passes all faces
/// three times. Some rays go back once more.
pub fn of_ghosts(ir: &SceneIr) -> u32 {
    passing_all(ir, 4)
}

/// The events of a ray that passes all surfaces so many times.
fn passing_all(ir: &SceneIr, times: usize) -> u32 {
    let go_on = ir.surfaces.iter().filter(|surface| surface.interaction != Interaction::Absorbing);
    u32::try_from(times * go_on.count()).unwrap_or(LIMIT).clamp(OPTILANDS, LIMIT)
}

/// The number to give if the depth limit takes light: what the scene needs, or twice what was given.
pub fn deeper(ir: &SceneIr, max_depth: u32) -> u32 {
    match of_scene(ir) {
        depth if depth > max_depth => depth,
        _ => max_depth.saturating_mul(2).min(LIMIT),
    }
}
