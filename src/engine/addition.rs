//! The one seam of the plain loop: what may be added to a trace.
//!
//! The loop holds a list of additions, asks each of them in the order of the methods below, and knows none by name. By
//! default each method leaves the trace as it is. So a capability is a type with the few methods that it needs, in a
//! room of its own. Its half in the program is [`ProgramAddition`]: slots, text, cells. The CPU backend saves time, and
//! changes no bit of a result. Another addition changes what a user asks for, such as a filter of light.

use crate::engine::Engine;
use crate::engine::limits::DispatchLimits;
use crate::engine::options::TraceOptions;
use crate::engine::plan::TracePlan;
use crate::engine::stages::ExtraBindings;
use crate::error::Result;
use crate::gpu::Gpu;
use crate::model::SceneIr;
use crate::program::addition::ProgramAddition;
use crate::program::{Program, ProgramOptions, RayRange};
use crate::result::Tally;
use std::any::Any;

/// An addition to the plain loop, with its methods in the order in which the engine calls them.
pub(crate) trait Addition: ProgramAddition + Any {
    /// Works on the host before the program is composed, such as a pilot trace, and changes how the program is composed.
    /// `is_alone` is true if the trace has no other addition.
    fn specialise(
        &mut self,
        _gpu: &Gpu,
        _ir: &SceneIr,
        _options: &TraceOptions,
        _program: &mut ProgramOptions,
        _is_alone: bool,
    ) -> Result<()> {
        Ok(())
    }

    /// Adds buffers, and uploads for each range, to the composed program. `all` are the additions of the trace.
    fn pack(
        &self,
        _ir: &SceneIr,
        _options: &TraceOptions,
        _program: &mut Program,
        _all: &[&dyn ProgramAddition],
    ) -> Result<()> {
        Ok(())
    }

    /// How large dispatches should be.
    fn limits(&self, _program: &Program, limits: DispatchLimits) -> DispatchLimits {
        limits
    }

    /// The buffers and stages that the program needs on a device, beside the engine's own.
    fn open(&mut self, _gpu: &Gpu, _plan: &TracePlan) -> Result<ExtraBindings> {
        Ok(ExtraBindings::default())
    }

    /// Sets the seed of the draws from now on.
    fn set_seed(&mut self, _seed: u64) {}

    /// Discards what an earlier trace left that failed half-way.
    fn discard(&mut self, _engine: &mut Engine) -> Result<()> {
        Ok(())
    }

    /// Begins a trace that goes on from a tally.
    fn begin(&mut self, _engine: &mut Engine, _tally: &mut Tally) -> Result<()> {
        Ok(())
    }

    /// The largest number of rays in a range of a pass, where the addition chooses it.
    fn range_rays(&self, _engine: &Engine) -> Option<u32> {
        None
    }

    /// Traces a range into the device's sums, in the place of the plain stages. False if the addition did not.
    fn trace(&mut self, _engine: &mut Engine, _range: &RayRange) -> Result<bool> {
        Ok(false)
    }

    /// True if the addition keeps the device busy from one pass to the next. The engine then waits for no pass.
    fn keeps_busy(&self) -> bool {
        false
    }

    /// Asks the device after a pass. Passes ask ever more rarely, because an answer waits for the device.
    fn after_pass(&mut self, _engine: &mut Engine) -> Result<()> {
        Ok(())
    }

    /// True if the sums must be drained now.
    fn is_full(&self) -> bool {
        false
    }

    /// Finishes the work that passes have left under way.
    fn finish_pending(&mut self, _engine: &mut Engine) -> Result<()> {
        Ok(())
    }

    /// Adds to a tally what lies outside the sums of the device.
    fn drain(&mut self, _engine: &mut Engine, _tally: &mut Tally) -> Result<()> {
        Ok(())
    }

    /// Ends a trace that came to its last ray.
    fn finish(&mut self, _engine: &mut Engine, _tally: &mut Tally) -> Result<()> {
        Ok(())
    }
}

/// The additions of a trace, in their order; none for the plain loop.
#[derive(Default)]
pub(crate) struct Additions(Vec<Box<dyn Addition>>);

impl Additions {
    /// These additions.
    pub(crate) fn new(additions: Vec<Box<dyn Addition>>) -> Self {
        Additions(additions)
    }

    /// One addition.
    pub(crate) fn one(addition: impl Addition) -> Self {
        Additions(vec![Box::new(addition)])
    }

    /// With one more.
    pub(crate) fn and(mut self, addition: impl Addition) -> Self {
        self.0.push(Box::new(addition));
        self
    }

    /// The addition of this type, if it is among them.
    pub(crate) fn get<T: Addition>(&self) -> Option<&T> {
        self.0.iter().find_map(|addition| (addition.as_ref() as &dyn Any).downcast_ref())
    }

    /// The halves of the program.
    pub(crate) fn of_program(&self) -> Vec<&dyn ProgramAddition> {
        self.0.iter().map(|addition| addition.as_ref() as &dyn ProgramAddition).collect()
    }

    /// As [`Addition::specialise`].
    pub(crate) fn specialise(
        &mut self,
        gpu: &Gpu,
        ir: &SceneIr,
        options: &TraceOptions,
        program: &mut ProgramOptions,
    ) -> Result<()> {
        let is_alone = self.0.len() == 1;
        self.0.iter_mut().try_for_each(|addition| addition.specialise(gpu, ir, options, program, is_alone))
    }

    /// As [`Addition::pack`].
    pub(crate) fn pack(&self, ir: &SceneIr, options: &TraceOptions, program: &mut Program) -> Result<()> {
        let all = self.of_program();
        self.0.iter().try_for_each(|addition| addition.pack(ir, options, program, &all))
    }

    /// As [`Addition::limits`].
    pub(crate) fn limits(&self, program: &Program) -> DispatchLimits {
        let plain = DispatchLimits::of(program);
        self.0.iter().fold(plain, |limits, addition| addition.limits(program, limits))
    }

    /// As [`Addition::open`].
    pub(crate) fn open(&mut self, gpu: &Gpu, plan: &TracePlan) -> Result<ExtraBindings> {
        let with =
            |all: ExtraBindings, addition: &mut Box<dyn Addition>| Ok(all.with(addition.open(gpu, plan)?));
        self.0.iter_mut().try_fold(ExtraBindings::default(), with)
    }

    /// Each of them, in their order.
    pub(crate) fn all_mut(&mut self) -> impl Iterator<Item = &mut dyn Addition> {
        self.0.iter_mut().map(|addition| addition.as_mut() as &mut dyn Addition)
    }

    /// Calls a method of each, in their order.
    pub(crate) fn each(&mut self, work: impl FnMut(&mut dyn Addition) -> Result<()>) -> Result<()> {
        self.all_mut().try_for_each(work)
    }

    /// True if one of them says so.
    pub(crate) fn any(&self, says: impl Fn(&dyn Addition) -> bool) -> bool {
        self.0.iter().any(|addition| says(addition.as_ref()))
    }

    /// As [`Addition::range_rays`].
    pub(crate) fn range_rays(&self, engine: &Engine) -> u32 {
        self.0.iter().find_map(|addition| addition.range_rays(engine)).unwrap_or_else(|| engine.size.rays())
    }

    /// Traces a range: in the plain way, unless an addition does.
    pub(crate) fn trace(&mut self, engine: &mut Engine, range: &RayRange) -> Result<()> {
        for addition in &mut self.0 {
            if addition.trace(engine, range)? {
                return Ok(());
            }
        }
        engine.submit(range)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::engine::pass_loop;
    use crate::engine::pipeline_cache::Shaders;
    use crate::engine::prepare::prepare;
    use crate::engine::test_scenes::TRAP;
    use crate::engine::undrained::empty_tally;
    use crate::gpu::AdapterChoice;
    use crate::program::addition::ShaderAddition;
    use crate::program::input::ProgramInput;
    use crate::shaders::ShaderFile;
    use std::sync::Arc;

    // An addition of ten lines: rays see no further than three events.
    #[derive(Debug)]
    struct ShortSight {
        slot: &'static str,
    }

    const SHORT_SIGHT: ShortSight = ShortSight { slot: "stages/hit" };

    impl ProgramAddition for ShortSight {
        fn shader(&self, _scene: &ProgramInput) -> Arc<dyn ShaderAddition> {
            Arc::new(ShortSight { slot: self.slot })
        }
    }

    impl ShaderAddition for ShortSight {
        fn replaces(&self) -> Vec<(&'static str, ShaderFile)> {
            let text = "fn intersect(ray: Ray) -> Hit {\n    if ray.bounce >= 3u { return Hit(MISS, NONE); }\n    \
                        return plain_intersect(ray);\n}\n";
            vec![(self.slot, ShaderFile { path: "of a test", text })]
        }
    }

    impl Addition for ShortSight {}

    #[test]
    fn an_addition_of_ten_lines_is_traced() {
        if crate::gpu::list_adapters().is_empty() {
            return;
        }
        let gpu = Gpu::open(&AdapterChoice::default()).unwrap();
        let ir = crate::Scene::from_json(TRAP).unwrap().lower().unwrap();
        let traced = |max_depth, mut additions: Additions| {
            let options = TraceOptions { num_rays: 5000, max_depth, ..Default::default() };
            let mut engine = prepare(&gpu, &ir, &options, &mut additions, Shaders::default()).unwrap();
            pass_loop::trace(&mut engine, &mut additions, empty_tally(&ir), |_| Ok(true)).unwrap()
        };
        let [plain, short] = [traced(3, Additions::default()), traced(64, Additions::one(SHORT_SIGHT))];
        // Whoever has had three events ends there, by the depth limit or by seeing nothing.
        assert!(plain.depth_killed.count > 1000 && plain.escaped.count == 0);
        assert_eq!((short.escaped, short.depth_killed.count), (plain.depth_killed, 0));
        assert_eq!(short.detectors, plain.detectors);
        assert_eq!(traced(64, Additions::default()).escaped.count, 0);
    }

    #[test]
    fn a_slot_that_does_not_exist_is_an_error() {
        if crate::gpu::list_adapters().is_empty() {
            return;
        }
        let gpu = Gpu::open(&AdapterChoice::default()).unwrap();
        let ir = crate::Scene::from_json(TRAP).unwrap().lower().unwrap();
        let mut additions = Additions::one(ShortSight { slot: "stages/hits" });
        let prepared = prepare(&gpu, &ir, &TraceOptions::default(), &mut additions, Shaders::default());
        let error = prepared.err().unwrap().to_string();
        assert!(error.contains("of a test is for the slot stages/hits, which does not exist"), "{error}");
    }
}
