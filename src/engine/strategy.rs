//! The seam between the engine and its fast paths: what may be done otherwise on some adapters.
//!
//! [`Plain`] is the complete way, and right everywhere. Another strategy overrides some of these methods. A method that
//! is not overridden works in the plain way. No strategy changes a bit of a result.

use crate::engine::Engine;
use crate::engine::device::DeviceState;
use crate::engine::limits::DispatchLimits;
use crate::engine::options::TraceOptions;
use crate::engine::plan::Plan;
use crate::engine::stages::Additions;
use crate::error::Result;
use crate::gpu::Gpu;
use crate::model::SceneIr;
use crate::program::wgsl::extension::{Extend, NoExtension};
use crate::program::{Program, ProgramOptions, RayRange};
use crate::result::Tally;

/// How a trace is done, in the order in which the engine asks.
pub(crate) trait Strategy {
    /// True if the strategy can trace a scene with all that these options ask for. If not, the plain strategy traces
    /// the scene. So no feature has to be written twice.
    fn takes(&self, _ir: &SceneIr, _options: &TraceOptions) -> bool {
        true
    }

    /// Changes the options of the program before it is composed, and returns what is to be added to the program.
    fn specialise(
        &mut self,
        _gpu: &Gpu,
        _ir: &SceneIr,
        _options: &TraceOptions,
        _program: &mut ProgramOptions,
    ) -> Result<Box<dyn Extend>> {
        Ok(Box::new(NoExtension))
    }

    /// How large dispatches should be.
    fn limits(&self, program: &Program) -> DispatchLimits {
        DispatchLimits::of(program)
    }

    /// The buffers and stages that the program needs on a device, beside the engine's own.
    fn open(&mut self, _gpu: &Gpu, _plan: &Plan) -> Result<Additions> {
        Ok(Additions::default())
    }

    /// Begins a trace: discards what an earlier trace left that failed half-way.
    fn begin(&mut self) {}

    /// The largest number of rays in a range of a pass.
    fn range_rays(&self, engine: &Engine) -> u32 {
        engine.size.rays()
    }

    /// Traces a range into the device's sums.
    fn trace(&mut self, engine: &mut Engine, range: &RayRange) -> Result<()>;

    /// True if the strategy keeps the device busy from one pass to the next. The engine then waits for no pass.
    fn keeps_busy(&self) -> bool {
        false
    }

    /// Prepares for the rays that are left. `seconds_left` is the time they will take \[s\], if it can be estimated
    /// yet.
    fn look_ahead(
        &mut self,
        _engine: &mut Engine,
        _rays_left: u64,
        _seconds_left: Option<f64>,
    ) -> Result<()> {
        Ok(())
    }

    /// Finishes the work that passes have left under way.
    fn settle(&mut self, _engine: &mut Engine) -> Result<()> {
        Ok(())
    }

    /// Adds to a tally what lies outside the sums of the devices.
    fn drain(&mut self, _engine: &Engine, _tally: &mut Tally) -> Result<()> {
        Ok(())
    }

    /// The devices that the strategy has opened beside the engine's. All are drained in the same way.
    fn devices(&self) -> &[DeviceState] {
        &[]
    }

    /// From now on, traces on the engine's device alone.
    fn keep_one_device(&mut self) {}

    /// For each stage of a path: how many rays of this trace were traced along the path, and how many of them were
    /// rejected.
    fn num_along_paths(&self) -> Vec<[u64; 2]> {
        Vec::new()
    }
}

/// The plain way: each range goes through the engine's stages, and all sums are the device's.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Plain;

impl Strategy for Plain {
    fn trace(&mut self, engine: &mut Engine, range: &RayRange) -> Result<()> {
        engine.submit(range)
    }
}
