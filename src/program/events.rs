//! Codes of the rows for the host, as shaders/rows/events.wgsl and shaders/stages/state.wgsl have them.

/// A ray on a ray database.
pub const RECORDED: u32 = 0;
/// A path begins, at a source.
pub const BIRTH: u32 = 1;
/// It meets a surface.
pub const SURFACE: u32 = 2;
/// It meets a detector.
pub const DETECTOR: u32 = 3;
/// It ends, by one of the fates below.
pub const DEATH: u32 = 4;

/// A part of a path, reported for the table of paths (shaders/paths/sums.events.wgsl).
pub const PATH_STEP: u32 = 5;
/// The end of such a path.
pub const PATH_END: u32 = 6;

/// Nothing was met any more.
pub const ESCAPED: u32 = 3;
/// The ray had as many events as it may have.
pub const DEPTH_KILLED: u32 = 4;
/// Roulette.
pub const ROULETTE_KILLED: u32 = 5;
