//! Paths that are followed, whatever becomes of them: for a filter, or for a second trace.

use crate::engine::addition::{Addition, Additions};
use crate::engine::options::{Collect, TraceOptions};
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::guide::Guided;
use crate::model::{PathFilter, SceneIr};
use crate::paths::sums::PathSums;
use crate::paths::wgsl::PathShader;
use crate::program::addition::{ProgramAddition, ShaderAddition};
use crate::program::input::ProgramInput;
use crate::program::layout::tables::Cells;
use crate::program::{Features, ProgramOptions, SecondMoments};
use std::sync::Arc;

/// Paths that are followed.
#[derive(Debug, Clone, Default)]
pub struct FollowedPaths {
    sums: PathSums,
    filter: Option<Arc<PathFilter>>,
    /// A guide follows where rays have been.
    is_guided: bool,
}

impl FollowedPaths {
    /// Paths that are followed for these sums, or for a filter.
    pub fn new(sums: PathSums, filter: Option<Arc<PathFilter>>) -> Self {
        FollowedPaths { sums, filter, is_guided: false }
    }

    /// The same for rays that are guided, if they are.
    #[must_use]
    pub fn guided(self, is_guided: bool) -> Self {
        FollowedPaths { is_guided, ..self }
    }

    /// What a trace with these options follows; `None` if it follows no paths.
    pub fn of(options: &TraceOptions) -> Option<Self> {
        let sums = match options.collect {
            Collect::Light | Collect::Tangents(_) | Collect::Adjoints => PathSums::None,
            Collect::Paths { rows, ends } => PathSums::Totals { rows, ends },
            Collect::PathMaps(num) => PathSums::Maps(num),
            Collect::Events { ends } => PathSums::Events { ends },
        };
        let (filter, is_guided) = (options.path_filter.clone(), options.guide.is_some());
        let is_followed = sums != PathSums::None || filter.is_some() || is_guided;
        is_followed.then(|| FollowedPaths::new(sums, filter).guided(is_guided))
    }

    /// The same as the additions of a second trace, with the guide of the first. Empty if paths are not followed.
    pub(crate) fn additions(options: &TraceOptions) -> Additions {
        let followed = FollowedPaths::of(options).map(Additions::one).unwrap_or_default();
        match Guided::of(options) {
            Some(guided) => followed.and(guided),
            None => followed,
        }
    }
}

impl ProgramAddition for FollowedPaths {
    fn adapt_options(&self, _features: &Features, options: &mut ProgramOptions) {
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
        Arc::new(PathShader::new(self.sums, self.filter.clone(), self.is_guided, scene))
    }
}

impl Addition for FollowedPaths {
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
}
