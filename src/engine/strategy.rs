//! What of a trace may be done otherwise on some adapters: the seam between the engine and its fast paths.
//!
//! [`Plain`] is the complete way, and right everywhere. Another strategy overrides some of these methods; what it does not
//! override is done in the plain way. No strategy changes a bit of a result.

use crate::engine::Engine;
use crate::engine::device::{Additions, DeviceState};
use crate::engine::limits::DispatchLimits;
use crate::engine::options::TraceOptions;
use crate::engine::plan::Plan;
use crate::error::Result;
use crate::gpu::Gpu;
use crate::model::SceneIr;
use crate::program::wgsl::extension::{Extend, NoExtension};
use crate::program::{Program, ProgramOptions, RayRange};
use crate::result::Tally;

/// How a trace is done, in the order in which the engine asks.
pub(crate) trait Strategy {
    /// Whether it can trace a scene with all that these options ask for. Where it cannot, the plain strategy traces: so that
    /// no feature has to be written twice.
    fn takes(&self, _ir: &SceneIr, _options: &TraceOptions) -> bool {
        true
    }

    /// Changes how the program is to be composed, before it is, and gives what is to be added to it.
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

    /// What the program needs of a device beside what the engine gives it.
    fn open(&mut self, _gpu: &Gpu, _plan: &Plan) -> Result<Additions> {
        Ok(Additions::default())
    }

    /// Begins a trace: forgets what one before it has left that failed half-way.
    fn begin(&mut self) {}

    /// Most rays of the ranges of a pass.
    fn range_rays(&self, engine: &Engine) -> u32 {
        engine.size.rays()
    }

    /// Traces a range into the device's sums.
    fn trace(&mut self, engine: &mut Engine, range: &RayRange) -> Result<()>;

    /// True if it keeps the device busy from one pass to the next, so that no pass is waited for.
    fn keeps_busy(&self) -> bool {
        false
    }

    /// Prepares for the rays that are left, which will take so long, if that can be told yet \[s\].
    fn look_ahead(
        &mut self,
        _engine: &mut Engine,
        _rays_left: u64,
        _seconds_left: Option<f64>,
    ) -> Result<()> {
        Ok(())
    }

    /// Ends what passes have left under way.
    fn settle(&mut self, _engine: &mut Engine) -> Result<()> {
        Ok(())
    }

    /// Adds what lies outside the sums of the devices.
    fn drain(&mut self, _engine: &Engine, _tally: &mut Tally) -> Result<()> {
        Ok(())
    }

    /// Devices that it has opened beside the engine's. They are drained alike.
    fn devices(&self) -> &[DeviceState] {
        &[]
    }

    /// Traces on the engine's device alone from now on.
    fn keep_one_device(&mut self) {}

    /// Of each stage of a path, how many rays of this trace were to keep to the path, and how many of these did not.
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
