//! Traces rays a second time, now that it is known which paths matter: a map for each of some rows, and where the light
//! of each sequence lies (shaders/paths/sums.maps.wgsl).

use crate::engine::device::DeviceState;
use crate::engine::dispatch::submit_alone;
use crate::engine::dispatch_size::PASS_TIME;
use crate::engine::intake::Intake;
use crate::engine::limits::{DispatchLimits, MAX_COUNTS_UNDRAINED, counts_unasked};
use crate::engine::options::TraceOptions;
use crate::engine::plan::{Draft, Plan};
use crate::engine::stages::{Additions, Stages};
use crate::engine::undrained::empty_tally;
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::model::{SceneIr, Sequence};
use crate::program::layout::paths::{self, PathTableSize};
use crate::program::parsed::Parsed;
use crate::program::wgsl::extension::NoExtension;
use crate::program::{PathSums, Program, RayRange, SecondMoments};
use crate::result::paths::Places;
use crate::result::{RaySet, Tally};
use std::sync::Arc;
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
    pub rays: &'a RaySet,
    /// The sequences.
    pub watched: &'a [Watched<'a>],
    /// The number of maps.
    pub num_maps: u32,
}

/// What the second trace found.
#[derive(Debug)]
pub struct PathMaps {
    /// The detectors' sums: those of map i are the i-th part of each detector's [`crate::result::DetectorTally::replicates`].
    pub tally: Tally,
    /// Per watched sequence, where its light lies; none of any if that is not known.
    pub places: Vec<Places>,
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
    edit: impl FnOnce(String) -> String,
    mut keep_going: impl FnMut() -> bool,
) -> Result<PathMaps> {
    let WantedMaps { rays, watched, num_maps } = *wanted;
    let is_strict = options.is_strict(&gpu.info);
    let options = TraceOptions { path_table: false, ..options.clone() };
    let mut draft = Draft::new(gpu, ir, &options)?;
    if draft.program.moments == SecondMoments::Replicates {
        return Err(Error::Usage(
            "standard errors of Sobol points need scrambles, for which paths have no maps; use --standard-error off".into(),
        ));
    }
    draft.program.path_sums = PathSums::Maps(num_maps.max(1));
    let parse = |wgsl, precision| Parsed::of(edit(wgsl), precision).map(Arc::new);
    let plan =
        draft.compose(gpu, ir, &NoExtension, parse, |program: &Program| DispatchLimits::of(program))?;
    let stages = Stages::new(gpu, &plan.program, is_strict, &Additions::default())?;
    let table = Table::of(&plan, watched)?;
    let device = DeviceState::new(
        gpu,
        &plan.program,
        plan.batch,
        Arc::new(stages),
        &Additions::default(),
        Some(table.words.len() as u64),
    )?;
    let Some(buffer) = &device.paths else {
        return Err(Error::Internal("maps of paths have no table".into()));
    };
    gpu.queue.write_buffer(buffer, 0, bytemuck::cast_slice(&table.words));
    gpu.queue.write_buffer(&device.paths_head, 0, bytemuck::cast_slice(&table.head));
    let mut tally = empty_tally(ir);
    let mut size = plan.dispatch_size();
    let (mut undrained, mut is_whole) = (0, true);
    let drain = |tally: &mut Tally| -> Result<()> {
        let mut intake = Intake::new(&plan.program.cells, plan.counted(), plan.rays.len(), tally);
        device.drain(&mut intake)?;
        intake.finish(plan.reached_marks());
        Ok(())
    };
    'spans: for span in rays.spans() {
        let (mut next, end) = (span.first, span.end());
        while next < end {
            let count = (end - next).min(size.rays().into()) as u32;
            let range = RayRange::of(next, count, span.source as usize);
            let start = Instant::now();
            undrained += u64::from(count) * counts_unasked(&plan.program);
            submit_alone(&device, &plan, &range, size.submissions(), |counts| {
                undrained += counts;
                if undrained > MAX_COUNTS_UNDRAINED {
                    drain(&mut tally)?;
                    undrained = counts;
                }
                Ok(())
            })?;
            device.forget_rows();
            device.gpu.wait()?;
            size.note(count, start.elapsed(), PASS_TIME);
            next += u64::from(count);
            if undrained > MAX_COUNTS_UNDRAINED / 2 {
                drain(&mut tally)?;
                undrained = 0;
            }
            if !keep_going() {
                is_whole = false;
                break 'spans;
            }
        }
    }
    device.check_loops_of_second_trace(&plan.program)?;
    drain(&mut tally)?;
    let places = table.read(&device, ir, &plan, watched)?;
    Ok(PathMaps { tally, places, is_whole })
}

/// The table of the watched sequences.
struct Table {
    head: [u32; 4],
    size: PathTableSize,
    words: Vec<u32>,
    /// Per watched sequence, its slot.
    slots: Vec<u32>,
}

impl Table {
    fn of(plan: &Plan, watched: &[Watched]) -> Result<Self> {
        let no_table = || Error::Internal("maps of paths have no table".into());
        let layout = plan.program.path_table.ok_or_else(no_table)?;
        let size = PathTableSize { slots: paths::slots_for(watched.len()), shards: 1 };
        let mut words = vec![0; layout.end(size) as usize];
        let rest = &mut words[paths::MARK_WORDS as usize..];
        let insert = |path: &Watched| {
            let [x, y] = path.about.map(|coordinate| (coordinate as f32).to_bits());
            let sequence = path.sequence;
            let contents = [sequence.end.code(), x, y, sequence.source, path.map.unwrap_or(paths::NO_MAP)];
            paths::insert(rest, size, sequence.key(), contents)
        };
        let slots: Option<Vec<u32>> = watched.iter().map(insert).collect();
        let slots = slots.ok_or_else(|| Error::Internal("a path has no slot".into()))?;
        Ok(Table { head: paths::head(&layout, size, true), size, words, slots })
    }

    fn read(
        &self,
        device: &DeviceState,
        ir: &SceneIr,
        plan: &Plan,
        watched: &[Watched],
    ) -> Result<Vec<Places>> {
        let (Some(layout), Some(buffer)) = (plan.program.path_table, &device.paths) else {
            return Ok(Vec::new());
        };
        let bytes = device.gpu.read(buffer, 4 * self.words.len() as u64)?;
        let words: Vec<u32> = bytemuck::pod_collect_to_vec(&bytes);
        let rows = &words[layout.first_row(self.size) as usize..];
        if words[paths::LARGE_SQUARE] != 0 {
            // Some distance was no number, or beyond all sums: nothing is known of places.
            return Ok(Vec::new());
        }
        let places = watched.iter().zip(&self.slots).map(|(path, slot)| {
            let size = path.sequence.end.detector().map_or(1.0, |number| {
                let row = ir.detectors[number].kind.grid_row();
                row.half_width + row.half_height
            });
            let about = path.about.map(|coordinate| f64::from(coordinate as f32));
            let mut places = Places { about, size, ..Places::default() };
            for row in layout.row(rows, self.size, *slot) {
                places.first[0] += paths::signed_sum(&row[..3]);
                places.first[1] += paths::signed_sum(&row[3..6]);
                places.second += paths::signed_sum(&row[6..9]);
            }
            places
        });
        Ok(places.collect())
    }
}
