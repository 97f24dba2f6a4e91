//! Walks the rays of a trace back, from adjoints of the detectors' cells to adjoints of the scene's numbers
//! ([`crate::program::rewrite::transpose`]).

use crate::derivatives::Derivatives;
use crate::derivatives::jacobian::{ComposedInF64, ProgramNumbers, composed_in_f64, parameter_jacobian};
use crate::engine::options::{Collect, TraceOptions};
use crate::engine::pipeline_cache::Shaders;
use crate::engine::retrace::{After, Batch, Retrace, Retracing, trace_again};
use crate::engine::stages::ExtraBindings;
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::model::{Precision, SceneIr};
use crate::paths::followed::FollowedPaths;
use crate::program::RayRange;
use crate::program::addition::ProgramAddition;
use crate::program::layout::bindings;
use crate::program::layout::reals::put_real;
use crate::program::rewrite::jvp::Parameter;
use crate::program::rewrite::transpose::{Layout, NUM_OTHER_SUMS};
use crate::result::RaySpan;
use naga::Scalar;
use std::time::{Duration, Instant};

/// Rays of the first dispatch; most rays of one, and most bytes of its sums.
const FIRST_RAYS: u64 = 1 << 15;
const MOST_RAYS: u64 = 1 << 19;
const MOST_BYTES: u64 = 1 << 24;
/// Dispatches that take less are doubled: a driver may give up on a long one.
const SHORT: Duration = Duration::from_millis(100);

/// Numbers have adjoints in registers of an invocation. Compilers take ten seconds and more for more of them.
const MOST_NUMBERS: usize = 512;

/// A scene whose rays can be walked back.
pub(crate) struct Walker<'a> {
    gpu: &'a Gpu,
    pub(crate) again: Retrace,
    /// The text in f64: where its numbers lie.
    base: ComposedInF64,
    /// The numbers that have adjoints.
    pub(crate) layout: Layout,
}

/// What the rays of one source have given.
pub(crate) struct Walked {
    /// What the loss gains by a unit of each number, in the order of the [`Layout`].
    pub(crate) numbers: Vec<f64>,
    /// The sum of all deposits, each times the adjoint of its cell.
    pub(crate) noted: f64,
    /// Rays whose adjoints are not finite. These rays are missing in the sums.
    pub(crate) num_lost: u64,
}

impl<'a> Walker<'a> {
    /// Composes and compiles a scene.
    ///
    /// # Errors
    /// [`Error::NoWayBack`] if the scene has something through which there is no reverse pass.
    pub(crate) fn new(gpu: &'a Gpu, ir: &SceneIr, options: &TraceOptions, shaders: Shaders) -> Result<Self> {
        let options = TraceOptions { collect: Collect::Adjoints, ..options.clone() };
        let additions = FollowedPaths::additions(&options).and(Derivatives::Adjoints);
        let again = Retrace::new(gpu, ir, &options, additions, shaders)?;
        let base = composed_in_f64(ir, &options, &again.plan.program, &again.additions.of_program())?;
        let layout = Layout::of(&base.parsed.module, Scalar::F64);
        if layout.num_numbers() > MOST_NUMBERS {
            return Err(Error::NoWayBack(format!("{} numbers at once", layout.num_numbers())));
        }
        Ok(Walker { gpu, again, base, layout })
    }

    /// The derivatives of the program's numbers by each parameter.
    ///
    /// # Errors
    /// [`Error::Usage`] if a small change of a parameter changes what the scene is made of.
    pub(crate) fn jacobian(
        &self,
        options: &TraceOptions,
        parameters: &[Parameter],
    ) -> Result<Vec<ProgramNumbers>> {
        let all: Vec<&dyn ProgramAddition> = self.again.additions.of_program();
        parameter_jacobian(options, &self.again.plan.program, &self.base, parameters, &all)
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
        let Walker { gpu, again, layout, .. } = self;
        let plan = &again.plan;
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
        let most = most.min(program.most_uploaded().into());
        // Sums of whole invocations: the same rays share one, whatever the batch.
        let most = (most / rays_per_invocation).max(1) * rays_per_invocation;
        let room = bytes_of(most.min(plan.num_rays));
        let rows = gpu.buffer("sums of adjoints", room)?;
        let added =
            vec![(bindings::ADJOINTS, gpu.scene_buffer(&cells)?), (bindings::ADJOINT_SUMS, rows.clone())];
        let device = again.open(gpu, ExtraBindings::of(added))?;
        let in_dispatch = FIRST_RAYS.next_multiple_of(rays_per_invocation).min(most);
        let spans: Vec<RaySpan> = (0..)
            .zip(&plan.rays)
            .map(|(source, rays)| RaySpan { first: rays.first, count: rays.count, source })
            .collect();
        let mut walking = Walking {
            gpu,
            rows: &rows,
            precision: program.options.precision,
            real_size: size,
            num_sums,
            rays_per_invocation,
            in_dispatch,
            most,
            sums: vec![vec![0.0; num_sums]; spans.len()],
            done: 0,
            keep_going: &mut keep_going,
        };
        // All events of a ray are in one dispatch.
        let first = Batch { rays: in_dispatch, submissions: 1 };
        if !trace_again(&device, plan, &spans, first, &mut walking)? {
            return Err(Error::Interrupted);
        }
        let mut found = Vec::new();
        for mut sums in walking.sums {
            let others = sums.split_off(num_sums - NUM_OTHER_SUMS);
            if others[2] > 0.0 {
                return Err(Error::NoWayBack("loops of more iterations than the driver makes".into()));
            }
            found.push(Walked { numbers: sums, noted: others[0], num_lost: others[1] as u64 });
        }
        Ok(found)
    }
}

/// Rays that are walked back.
struct Walking<'a> {
    gpu: &'a Gpu,
    rows: &'a wgpu::Buffer,
    precision: Precision,
    real_size: usize,
    num_sums: usize,
    rays_per_invocation: u64,
    in_dispatch: u64,
    most: u64,
    /// By source.
    sums: Vec<Vec<f64>>,
    done: u64,
    keep_going: &'a mut dyn FnMut(u64) -> bool,
}

impl Retracing for Walking<'_> {
    fn after(&mut self, range: &RayRange, start: Instant) -> Result<After> {
        let row_bytes = self.num_sums * self.real_size;
        let num_rows = u64::from(range.count).div_ceil(self.rays_per_invocation);
        let bytes = self.gpu.read(self.rows, num_rows * row_bytes as u64)?;
        for invocation in bytes.chunks_exact(row_bytes) {
            for (sum, bytes) in
                self.sums[range.source].iter_mut().zip(invocation.chunks_exact(self.real_size))
            {
                *sum += real_of(bytes, self.precision);
            }
        }
        if start.elapsed() < SHORT {
            self.in_dispatch = self.most.min(2 * self.in_dispatch);
        }
        self.done += u64::from(range.count);
        let next = Batch { rays: self.in_dispatch, submissions: 1 };
        Ok(if (self.keep_going)(self.done) { After::Next(next) } else { After::Stop })
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
