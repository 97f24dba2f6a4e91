//! Walks the rays of a trace back, from adjoints of the detectors' cells to those of the scene's numbers
//! ([`crate::program::rewrite::transpose`]).

use crate::engine::device::DeviceState;
use crate::engine::dispatch::submit_alone;
use crate::engine::limits::DispatchLimits;
use crate::engine::options::TraceOptions;
use crate::engine::plan::{Draft, Plan};
use crate::engine::shelf::Shelf;
use crate::engine::stages::{Additions, Stages};
use crate::engine::tangents::{AsComposed, as_composed};
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::model::{Precision, SceneIr};
use crate::program::RayRange;
use crate::program::layout::bindings;
use crate::program::layout::reals::put_real;
use crate::program::parsed::Parsed;
use crate::program::rewrite::transpose::{Layout, NUM_OTHER_SUMS};
use crate::program::wgsl::extension::NoExtension;
use naga::Scalar;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Rays of the first dispatch; most rays of one, and most bytes of its sums.
const FIRST_RAYS: u64 = 1 << 15;
const MOST_RAYS: u64 = 1 << 19;
const MOST_BYTES: u64 = 1 << 24;
/// Dispatches that take less are doubled: a driver may give up on a long one.
const SHORT: Duration = Duration::from_millis(100);

/// More numbers than that do not fit the registers of an invocation.
const MOST_NUMBERS: usize = 512;

/// A scene whose rays can be walked back.
pub(crate) struct Walker<'a> {
    gpu: &'a Gpu,
    pub(crate) plan: Plan,
    /// The text in f64: where its numbers lie.
    pub(crate) first: AsComposed,
    /// The numbers that have adjoints.
    pub(crate) layout: Layout,
    stages: Arc<Stages>,
}

/// What the rays of one source have given.
pub(crate) struct Walked {
    /// What the loss gains by a unit of each number, in the order of the [`Layout`].
    pub(crate) numbers: Vec<f64>,
    /// The sum of all deposits, each times the adjoint of its cell.
    pub(crate) noted: f64,
    /// Rays whose adjoints are no numbers: they are missing.
    pub(crate) num_lost: u64,
}

impl<'a> Walker<'a> {
    /// Composes and compiles a scene.
    ///
    /// # Errors
    /// [`Error::NoWayBack`] if the scene has something through which there is no reverse pass.
    pub(crate) fn new(
        gpu: &'a Gpu,
        ir: &SceneIr,
        options: &TraceOptions,
        shelf: Option<&Shelf>,
        edit: Option<&dyn Fn(String) -> String>,
    ) -> Result<Self> {
        let options = TraceOptions { adjoints: true, ..options.clone() };
        let draft = Draft::new(gpu, ir, &options)?;
        // The path of a ray is known at its end alone, and not where the ray passes a detector.
        let passes = ir.detectors.iter().any(|detector| !detector.absorb);
        if options.path_filter.is_some() && passes {
            return Err(Error::NoWayBack("a filter of paths and detectors that light passes".into()));
        }
        if !draft.program.bakes_records() {
            return Err(Error::NoWayBack("a table of many surfaces".into()));
        }
        let parse = |wgsl: String, precision| match (shelf, edit) {
            (_, Some(edit)) => Parsed::of(edit(wgsl), precision).map(Arc::new),
            (Some(shelf), None) => shelf.parsed(wgsl, precision),
            (None, None) => Parsed::of(wgsl, precision).map(Arc::new),
        };
        let plan = draft.compose(gpu, ir, &NoExtension, parse, DispatchLimits::of)?;
        let first = as_composed(ir, &options, &plan.program)?;
        let layout = Layout::of(&first.parsed.module, Scalar::F64);
        if layout.num_numbers() > MOST_NUMBERS {
            return Err(Error::NoWayBack(format!("{} numbers at once", layout.num_numbers())));
        }
        let strict = options.is_strict(&gpu.info);
        let stages = match shelf.filter(|_| edit.is_none()) {
            Some(shelf) => shelf.stages(gpu, &plan.program, strict)?,
            None => Stages::new(gpu, &plan.program, strict, &Additions::default()).map(Arc::new)?,
        };
        Ok(Walker { gpu, plan, first, layout, stages })
    }

    /// Walks all rays back, from the adjoints of the detectors' cells, in units of the loss per unit of weight. Gives sums by
    /// source. `keep_going` gets the rays done, and ends the walk by returning false.
    ///
    /// # Errors
    /// [`Error::NoWayBack`] if the driver cut loops short, or there are too many cells. [`Error::Interrupted`] if the walk was
    /// ended. [`Error::Device`] if the device fails.
    pub(crate) fn walk(
        &self,
        cell_adjoints: &[f64],
        mut keep_going: impl FnMut(u64) -> bool,
    ) -> Result<Vec<Walked>> {
        let Walker { gpu, plan, layout, stages, .. } = self;
        let program = &plan.program;
        let (size, num_sums) = (program.real_size(), layout.num_sums());
        let mut cells = vec![0; cell_adjoints.len().max(1) * size];
        for (place, value) in cells.chunks_exact_mut(size).zip(cell_adjoints) {
            put_real(place, *value, program.options.precision)?;
        }
        if cells.len() as u64 > gpu.largest_binding() {
            return Err(Error::NoWayBack(format!("{} cells at once", cell_adjoints.len())));
        }
        let rays_per_invocation = u64::from(program.options.rays_per_invocation(&program.features));
        let bytes_of = |rays: u64| rays.div_ceil(rays_per_invocation) * (num_sums * size) as u64;
        let most = MOST_RAYS.min(MOST_BYTES / bytes_of(1) * rays_per_invocation);
        let most = most.min(u64::from(plan.options.batch_size.unwrap_or(u32::MAX)));
        // Sums of whole invocations: the same rays share one, whatever the batch.
        let most = (most / rays_per_invocation).max(1) * rays_per_invocation;
        let room = bytes_of(most.min(plan.num_rays));
        let rows = gpu.buffer("sums of adjoints", room)?;
        let added =
            vec![(bindings::ADJOINTS, gpu.scene_buffer(&cells)?), (bindings::ADJOINT_SUMS, rows.clone())];
        let additions = Additions { groups: vec![added], stages: Vec::new() };
        let device = DeviceState::new(gpu, program, plan.batch, stages.clone(), &additions, None)?;
        let (mut found, mut done) = (Vec::new(), 0);
        let mut in_dispatch = FIRST_RAYS.next_multiple_of(rays_per_invocation).min(most);
        for (source, rays) in plan.rays.iter().enumerate() {
            let mut sums = vec![0.0; num_sums];
            let mut first = 0;
            while first < rays.count {
                let count = in_dispatch.min(rays.count - first);
                let start = Instant::now();
                let range = RayRange::of(rays.first + first, count as u32, source);
                // All events of a ray are in one dispatch.
                submit_alone(&device, plan, &range, 1, |_| Ok(()))?;
                let bytes = gpu.read(&rows, bytes_of(count))?;
                for invocation in bytes.chunks_exact(num_sums * size) {
                    for (sum, bytes) in sums.iter_mut().zip(invocation.chunks_exact(size)) {
                        *sum += real_of(bytes, program.options.precision);
                    }
                }
                if start.elapsed() < SHORT {
                    in_dispatch = most.min(2 * in_dispatch);
                }
                first += count;
                done += count;
                if !keep_going(done) {
                    return Err(Error::Interrupted);
                }
            }
            let others = sums.split_off(num_sums - NUM_OTHER_SUMS);
            if others[2] > 0.0 {
                return Err(Error::NoWayBack("loops of more rounds than the driver makes".into()));
            }
            found.push(Walked { numbers: sums, noted: others[0], num_lost: others[1] as u64 });
        }
        Ok(found)
    }
}

/// A real as a device writes it.
fn real_of(bytes: &[u8], precision: Precision) -> f64 {
    let single =
        |at: usize| f64::from(f32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]));
    match precision {
        Precision::F32 => single(0),
        Precision::Df64 => single(0) + single(4),
        Precision::F64 => f64::from_le_bytes(bytes.try_into().unwrap_or_default()),
    }
}
