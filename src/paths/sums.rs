//! What becomes of the paths of all rays.

/// What becomes of the paths of all rays.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum PathSums {
    /// Nothing: a filter follows them.
    #[default]
    None,
    /// Light is summed up by its path (shaders/paths/sums.totals.wgsl).
    Totals {
        /// Most rows of the table.
        rows: u32,
        /// The ends of rays that no detector records have rows, too.
        ends: bool,
    },
    /// Light of some paths is summed up in so many maps, and the places of all that has a slot
    /// (shaders/paths/sums.maps.wgsl).
    Maps(u32),
    /// The host learns what happened to each ray (shaders/paths/sums.events.wgsl).
    Events {
        /// The ends of rays that no detector records, too.
        ends: bool,
    },
}

impl PathSums {
    /// True if there is a table of paths.
    pub(super) fn has_table(self) -> bool {
        matches!(self, PathSums::Totals { .. } | PathSums::Maps(_))
    }

    /// True if rays that no detector records have ends, too.
    pub(super) fn has_ends(self) -> bool {
        match self {
            PathSums::Totals { ends, .. } | PathSums::Events { ends } => ends,
            PathSums::None | PathSums::Maps(_) => false,
        }
    }
}
