//! An addition to the plain loop: light by its path.
//!
//! A ray carries a few words that say which path it takes ([`wgsl`]). Its deposits go to a row of a table on the device
//! ([`table`]), which the host reads, empties and makes larger ([`drain`]). One ray of each row is traced again to learn
//! the sequence of its surfaces ([`replay`]), and all rays for maps of the strongest paths ([`maps`], [`rows`]). A filter
//! keeps light from maps, with or without a table. docs/methods/paths.md says why.

mod drain;
pub mod layout;
pub mod maps;
pub(crate) mod replay;
pub mod rows;
mod table;
mod wgsl;

use crate::engine::Engine;
use crate::engine::addition::Addition;
use crate::engine::options::{Collect, TraceOptions};
use crate::engine::plan::TracePlan;
use crate::engine::stages::ExtraBindings;
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::model::sequence::Sequence;
use crate::model::{PathFilter, SceneIr};
use crate::paths::table::PathHashTable;
use crate::paths::wgsl::PathShader;
use crate::program::addition::{ProgramAddition, ShaderAddition};
use crate::program::input::ProgramInput;
use crate::program::layout::tables::Cells;
use crate::program::{Features, ProgramOptions, SecondMoments};
use crate::result::Tally;
use glam::DVec3;
use std::collections::HashMap;
use std::sync::Arc;

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

/// The addition.
#[derive(Default)]
pub struct Paths {
    sums: PathSums,
    filter: Option<Arc<PathFilter>>,
    /// The table, on the device on which it was opened.
    table: Option<PathHashTable>,
}

impl PathSums {
    /// True if there is a table of paths.
    fn has_table(self) -> bool {
        matches!(self, PathSums::Totals { .. } | PathSums::Maps(_))
    }

    /// True if rays that no detector records have ends, too.
    fn has_ends(self) -> bool {
        match self {
            PathSums::Totals { ends, .. } | PathSums::Events { ends } => ends,
            PathSums::None | PathSums::Maps(_) => false,
        }
    }
}

impl Paths {
    /// Paths that are followed for these sums, or for a filter.
    pub fn new(sums: PathSums, filter: Option<Arc<PathFilter>>) -> Self {
        Paths { sums, filter, table: None }
    }

    /// What a trace with these options follows; `None` if it follows no paths.
    pub fn of(options: &TraceOptions) -> Option<Self> {
        let sums = match options.collect {
            Collect::Light | Collect::Tangents(_) | Collect::Adjoints => PathSums::None,
            Collect::Paths { rows, ends } => PathSums::Totals { rows, ends },
            Collect::PathMaps(num) => PathSums::Maps(num),
            Collect::Events { ends } => PathSums::Events { ends },
        };
        let filter = options.path_filter.clone();
        (sums != PathSums::None || filter.is_some()).then(|| Paths::new(sums, filter))
    }

    /// Where some ray came to the end of each path that was found, in the scene's frame \[mm\].
    pub(crate) fn found(&self) -> HashMap<&Sequence, DVec3> {
        let known = self.table.iter().flat_map(|table| table.known.values());
        known.map(|found| (&found.sequence, found.position)).collect()
    }
}

impl ProgramAddition for Paths {
    fn prepare(&self, _features: &Features, options: &mut ProgramOptions) {
        // Such traces give maps without errors, or none. Scrambles belong to the draws, and stay.
        let is_second = matches!(self.sums, PathSums::Maps(_) | PathSums::Events { .. });
        if is_second && options.moments == SecondMoments::Squares {
            options.moments = SecondMoments::None;
        }
    }

    fn cells(&self, cells: Cells) -> Result<Cells> {
        let cells = if self.filter.is_some() { cells.with_filtered() } else { cells };
        match self.sums {
            PathSums::Maps(num) => cells.with_replicates(num),
            PathSums::None | PathSums::Totals { .. } | PathSums::Events { .. } => Ok(cells),
        }
    }

    fn shader(&self, scene: &ProgramInput) -> Arc<dyn ShaderAddition> {
        Arc::new(PathShader::new(self.sums, self.filter.clone(), scene))
    }
}

impl Addition for Paths {
    fn specialise(
        &mut self,
        _gpu: &Gpu,
        _ir: &SceneIr,
        _options: &TraceOptions,
        program: &mut ProgramOptions,
        _is_alone: bool,
    ) -> Result<()> {
        if matches!(self.sums, PathSums::Maps(_)) && program.moments == SecondMoments::Replicates {
            return Err(Error::Usage(
                "standard errors of Sobol points need scrambles, for which paths have no maps; use --standard-error off".into(),
            ));
        }
        Ok(())
    }

    fn open(&mut self, gpu: &Gpu, plan: &TracePlan) -> Result<ExtraBindings> {
        let PathSums::Totals { rows, .. } = self.sums else { return Ok(ExtraBindings::default()) };
        let table = self.table.insert(PathHashTable::new(gpu, plan, rows)?);
        Ok(ExtraBindings::of(table.bindings()))
    }

    fn set_seed(&mut self, seed: u64) {
        self.table.iter_mut().for_each(|table| table.set_seed(seed));
    }

    fn begin(&mut self, engine: &mut Engine, tally: &mut Tally) -> Result<()> {
        self.table.as_mut().map_or(Ok(()), |table| table.begin(engine, tally))
    }

    fn after_pass(&mut self, engine: &mut Engine) -> Result<()> {
        self.table.as_mut().map_or(Ok(()), |table| table.check(engine))
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
