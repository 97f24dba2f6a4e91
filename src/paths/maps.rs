//! Traces rays a second time, when it is known which paths matter (shaders/paths/sums.maps.wgsl). Some rows of the
//! table get a map each. Where the light of each sequence lies is summed, too.

use crate::engine::device::DeviceState;
use crate::engine::dispatch_size::{DispatchSize, PASS_TIME};
use crate::engine::limits::{MAX_COUNTS_UNDRAINED, counts_unasked};
use crate::engine::options::{Collect, TraceOptions};
use crate::engine::pipeline_cache::Shaders;
use crate::engine::plan::TracePlan;
use crate::engine::readback::Readback;
use crate::engine::retrace::{After, Batch, Retrace, Retracing, trace_again};
use crate::engine::stages::ExtraBindings;
use crate::engine::undrained::empty_tally;
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::model::{SceneIr, Sequence};
use crate::paths::followed::FollowedPaths;
use crate::paths::layout::{self, PathTableSize};
use crate::paths::wgsl::PathShader;
use crate::program::RayRange;
use crate::program::layout::bindings;
use crate::result::light_paths::PlaceMoments;
use crate::result::{RaySpans, Tally};
use std::time::Instant;

/// A sequence whose light is looked at.
#[derive(Debug, Clone, Copy)]
pub struct Watched<'a> {
    /// The sequence.
    pub sequence: &'a Sequence,
    /// A point on the detector where some ray of the sequence arrived, in the detector's frame \[mm\].
    pub about: [f64; 2],
    /// The number of the map that has the light.
    pub map: Option<u32>,
}

/// What a second trace is to look at.
#[derive(Debug, Clone, Copy)]
pub struct WantedMaps<'a> {
    /// The rays of the first trace.
    pub rays: &'a RaySpans,
    /// The sequences.
    pub watched: &'a [Watched<'a>],
    /// The number of maps.
    pub num_maps: u32,
}

/// What the second trace found.
#[derive(Debug)]
pub struct PathMaps {
    /// The detectors' sums. The sums of map i are the i-th part of each detector's
    /// [`crate::result::DetectorTally::replicates`].
    pub tally: Tally,
    /// Per watched sequence, where its light lies. Empty if that is not known.
    pub places: Vec<PlaceMoments>,
    /// False if the caller ended the trace before its last ray.
    pub is_whole: bool,
}

/// Traces rays into maps. `edit` changes the composed text: for tests that must notice a wrong shader.
/// `keep_going` is asked after each dispatch.
///
/// # Errors
/// [`Error::Usage`] if so many maps are too many cells; [`Error::Device`] if the device fails.
pub fn trace_maps(
    gpu: &Gpu,
    ir: &SceneIr,
    options: &TraceOptions,
    wanted: &WantedMaps,
    edit: Option<&dyn Fn(String) -> String>,
    mut keep_going: impl FnMut() -> bool,
) -> Result<PathMaps> {
    let WantedMaps { rays, watched, num_maps } = *wanted;
    let options = TraceOptions { collect: Collect::PathMaps(num_maps.max(1)), ..options.clone() };
    let additions = FollowedPaths::additions(&options);
    let again = Retrace::new(gpu, ir, &options, additions, Shaders { cache: None, edit })?;
    let table = Watch::of(gpu, &again.plan, watched)?;
    let device = again.open(gpu, ExtraBindings::of(table.bindings()))?;
    let plan = &again.plan;
    let size = plan.dispatch_size();
    let (tally, undrained) = (empty_tally(ir), 0);
    let mut maps = Maps { device: &device, plan, size, tally, undrained, keep_going: &mut keep_going };
    let first = maps.next();
    let is_whole = trace_again(&device, plan, rays.spans(), first, &mut maps)?;
    maps.drain()?;
    let tally = maps.tally;
    let places = table.read(ir, watched)?;
    Ok(PathMaps { tally, places, is_whole })
}

/// Rays that are traced into maps.
struct Maps<'a> {
    device: &'a DeviceState,
    plan: &'a TracePlan,
    size: DispatchSize,
    tally: Tally,
    /// What counters may count since they were drained.
    undrained: u64,
    keep_going: &'a mut dyn FnMut() -> bool,
}

impl Maps<'_> {
    fn next(&self) -> Batch {
        Batch { rays: self.size.rays().into(), submissions: self.size.submissions() }
    }

    fn drain(&mut self) -> Result<()> {
        let Maps { device, plan, tally, .. } = self;
        let mut readback = Readback::new(&plan.program.cells, plan.counted(), plan.rays.len(), tally);
        device.drain(&mut readback)?;
        readback.finish(plan.reached_marks());
        self.undrained = 0;
        Ok(())
    }
}

impl Retracing for Maps<'_> {
    fn before(&mut self, range: &RayRange) {
        self.undrained += u64::from(range.count) * counts_unasked(&self.plan.program);
    }

    fn rounds(&mut self, counts: u64) -> Result<()> {
        self.undrained += counts;
        if self.undrained > MAX_COUNTS_UNDRAINED {
            self.drain()?;
            self.undrained = counts;
        }
        Ok(())
    }

    fn after(&mut self, range: &RayRange, start: Instant) -> Result<After> {
        self.device.forget_rows();
        self.device.gpu.wait()?;
        self.size.note(range.count, start.elapsed(), PASS_TIME);
        if self.undrained > MAX_COUNTS_UNDRAINED / 2 {
            self.drain()?;
        }
        Ok(if (self.keep_going)() { After::Next(self.next()) } else { After::Stop })
    }
}

/// The table of the watched sequences.
struct Watch {
    gpu: Gpu,
    layout: layout::PathTableLayout,
    size: PathTableSize,
    num_words: u64,
    words: wgpu::Buffer,
    head: wgpu::Buffer,
    /// Per watched sequence, its slot.
    slots: Vec<u32>,
}

impl Watch {
    fn of(gpu: &Gpu, plan: &TracePlan, watched: &[Watched]) -> Result<Self> {
        let layout = PathShader::of(&plan.program)?.layout;
        let size = PathTableSize { slots: layout::slots_for(watched.len()), shards: 1 };
        let mut words = vec![0; layout.end(size) as usize];
        let rest = &mut words[layout::MARK_WORDS as usize..];
        let insert = |path: &Watched| {
            let [x, y] = path.about.map(|coordinate| (coordinate as f32).to_bits());
            let sequence = path.sequence;
            let contents = [sequence.end.code(), x, y, sequence.source, path.map.unwrap_or(layout::NO_MAP)];
            layout::insert(rest, size, sequence.key(), contents)
        };
        let slots: Option<Vec<u32>> = watched.iter().map(insert).collect();
        let slots = slots.ok_or_else(|| Error::Internal("a path has no slot".into()))?;
        let num_words = words.len() as u64;
        let buffer = gpu.buffer("the table of paths", 4 * num_words)?;
        gpu.queue.write_buffer(&buffer, 0, bytemuck::cast_slice(&words));
        let head = bytemuck::cast_slice::<u32, u8>(&layout::head(&layout, size, true)).to_vec();
        let head = gpu.constant_buffer("the head of the table of paths", &head);
        Ok(Watch { gpu: gpu.clone(), layout, size, num_words, words: buffer, head, slots })
    }

    fn bindings(&self) -> [(u32, wgpu::Buffer); 2] {
        [(bindings::PATHS, self.words.clone()), (bindings::PATHS_HEAD, self.head.clone())]
    }

    fn read(&self, ir: &SceneIr, watched: &[Watched]) -> Result<Vec<PlaceMoments>> {
        let bytes = self.gpu.read(&self.words, 4 * self.num_words)?;
        let words: Vec<u32> = bytemuck::pod_collect_to_vec(&bytes);
        let rows = &words[self.layout.first_row(self.size) as usize..];
        if words[layout::LARGE_SQUARE] != 0 {
            // Some distance was no number, or beyond all sums: nothing is known of places.
            return Ok(Vec::new());
        }
        let places = watched.iter().zip(&self.slots).map(|(path, slot)| {
            let size = path.sequence.end.detector().map_or(1.0, |number| {
                let row = ir.detectors[number].kind.grid_row();
                row.half_width + row.half_height
            });
            let about = path.about.map(|coordinate| f64::from(coordinate as f32));
            let mut places = PlaceMoments { about, size, ..PlaceMoments::default() };
            for row in self.layout.row(rows, self.size, *slot) {
                places.first[0] += layout::signed_sum(&row[..3]);
                places.first[1] += layout::signed_sum(&row[3..6]);
                places.second += layout::signed_sum(&row[6..9]);
            }
            places
        });
        Ok(places.collect())
    }
}
