//! The table of paths in a trace.

use crate::engine::Engine;
use crate::engine::addition::Addition;
use crate::engine::plan::TracePlan;
use crate::engine::stages::ExtraBindings;
use crate::error::Result;
use crate::gpu::Gpu;
use crate::model::Sequence;
use crate::paths::followed::FollowedPaths;
use crate::paths::table::PathHashTable;
use crate::program::addition::{ProgramAddition, ShaderAddition};
use crate::program::input::ProgramInput;
use crate::program::layout::tables::Cells;
use crate::program::{Features, ProgramOptions};
use crate::result::Tally;
use glam::DVec3;
use std::collections::HashMap;
use std::sync::Arc;

/// Light that is summed up by its path, in a table on the device.
pub struct PathTotals {
    followed: FollowedPaths,
    most_rows: u32,
    /// The table, on the device on which it was opened.
    table: Option<PathHashTable>,
}

impl PathTotals {
    /// The totals of paths that are followed, in a table of at most so many rows.
    pub fn new(followed: FollowedPaths, most_rows: u32) -> Self {
        PathTotals { followed, most_rows, table: None }
    }

    /// Where some ray came to the end of each path that was found, in the scene's frame \[mm\].
    pub(crate) fn found(&self) -> HashMap<&Sequence, DVec3> {
        let known = self.table.iter().flat_map(|table| table.known.values());
        known.map(|found| (&found.sequence, found.position)).collect()
    }
}

impl ProgramAddition for PathTotals {
    fn adapt_options(&self, features: &Features, options: &mut ProgramOptions) {
        self.followed.adapt_options(features, options);
    }

    fn cells(&self, cells: Cells) -> Result<Cells> {
        self.followed.cells(cells)
    }

    fn shader(&self, scene: &ProgramInput) -> Arc<dyn ShaderAddition> {
        self.followed.shader(scene)
    }
}

impl Addition for PathTotals {
    fn open(&mut self, gpu: &Gpu, plan: &TracePlan) -> Result<ExtraBindings> {
        let table = self.table.insert(PathHashTable::new(gpu, plan, self.most_rows)?);
        Ok(ExtraBindings::of(table.bindings()))
    }

    fn set_seed(&mut self, seed: u64) {
        self.table.iter_mut().for_each(|table| table.set_seed(seed));
    }

    fn begin(&mut self, _engine: &mut Engine, tally: &mut Tally) -> Result<()> {
        self.table.as_mut().map_or(Ok(()), |table| table.begin(tally))
    }

    fn after_pass(&mut self, _engine: &mut Engine) -> Result<()> {
        self.table.as_mut().map_or(Ok(()), PathHashTable::check)
    }

    fn is_full(&self) -> bool {
        self.table.as_ref().is_some_and(|table| table.is_full)
    }

    fn drain(&mut self, engine: &mut Engine, tally: &mut Tally) -> Result<()> {
        self.table.as_mut().map_or(Ok(()), |table| table.drain(engine, tally))
    }

    fn finish(&mut self, engine: &mut Engine, tally: &mut Tally) -> Result<()> {
        self.table.as_mut().map_or(Ok(()), |table| table.finish(engine, tally))
    }
}
