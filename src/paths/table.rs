//! The table of paths on the device: how large it is, how it is emptied, and how it is read.
//!
//! The table begins small. A key that finds no slot marks the table as full ([`crate::paths::drain`]).

use crate::engine::limits::counts_per_ray;
use crate::engine::plan::TracePlan;
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::model::SceneIr;
use crate::model::sequence::{Sequence, SequenceKey};
use crate::paths::layout::{self, PathTableLayout, PathTableSize, SLOT_WORDS, Slot, slots_for};
use crate::paths::replay::{Found, PathReplay};
use crate::paths::wgsl::PathShader;
use crate::program::Program;
use crate::program::layout::bindings;
use crate::result::PathSum;
use std::collections::HashMap;

/// Slots of a table that has just begun.
const FIRST_SLOTS: u32 = 1 << 10;

/// The table of paths of a trace.
pub(super) struct PathHashTable {
    layout: PathTableLayout,
    size: PathTableSize,
    /// The largest number of slots, for which the buffer has room.
    pub(super) most_slots: u32,
    buffer_words: u64,
    pub(super) most_rows: u32,
    num_rays: u64,
    pub(super) is_closed: bool,
    /// True if the device has seen a key without a slot.
    pub(super) is_full: bool,
    /// Sequences that were learnt before, also in earlier traces by this engine.
    pub(super) known: HashMap<SequenceKey, Found>,
    /// Compiled when it is first needed.
    replay: Option<PathReplay>,
    gpu: Gpu,
    words: wgpu::Buffer,
    head: wgpu::Buffer,
}

/// What was read from the table.
pub(super) struct Reading {
    pub(super) rows: Vec<(SequenceKey, Slot, PathSum)>,
    /// Sums of keys without a slot, by their ends.
    pub(super) other: Vec<PathSum>,
    pub(super) has_overflow: bool,
    pub(super) has_large_squares: bool,
}

impl PathHashTable {
    /// The table of a plan, of at most so many rows.
    pub(super) fn new(gpu: &Gpu, plan: &TracePlan, most_rows: u32) -> Result<Self> {
        let layout = PathShader::of(&plan.program)?.layout;
        let most_slots = most_slots(plan, most_rows);
        let buffer_words = layout.words(most_slots);
        let size = layout.size(FIRST_SLOTS.min(most_slots), buffer_words, plan.num_rays);
        Ok(PathHashTable {
            layout,
            size,
            most_slots,
            buffer_words,
            most_rows,
            num_rays: plan.num_rays,
            is_closed: false,
            is_full: false,
            known: HashMap::new(),
            replay: None,
            gpu: gpu.clone(),
            words: gpu.buffer("the table of paths", 4 * buffer_words)?,
            head: gpu.constant_buffer("the head of the table of paths", &[0; 16]),
        })
    }

    /// Its bindings.
    pub(super) fn bindings(&self) -> [(u32, wgpu::Buffer); 2] {
        [(bindings::PATHS, self.words.clone()), (bindings::PATHS_HEAD, self.head.clone())]
    }

    pub(super) fn num_slots(&self) -> u32 {
        self.size.slots
    }

    /// Empties the table on the device. A closed table keeps its keys.
    pub(super) fn clear(&mut self, chosen: Option<&[Sequence]>) -> Result<()> {
        self.is_closed = chosen.is_some();
        if let Some(chosen) = chosen {
            self.resize(slots_for(chosen.len()));
        }
        let head = layout::head(&self.layout, self.size, self.is_closed);
        let queue = &self.gpu.queue;
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        encoder.clear_buffer(&self.words, 0, Some(4 * self.layout.end(self.size).min(self.buffer_words)));
        queue.submit([encoder.finish()]);
        queue.write_buffer(&self.head, 0, bytemuck::cast_slice(&head));
        if let Some(chosen) = chosen {
            let mut slots = vec![0; (self.size.slots * SLOT_WORDS) as usize];
            for sequence in chosen {
                let contents = [sequence.end.code(), 0, 0, sequence.source, layout::NO_MAP];
                if layout::insert(&mut slots, self.size, sequence.key(), contents).is_none() {
                    return Err(Error::Internal("a chosen path has no slot".into()));
                }
            }
            queue.write_buffer(&self.words, 4 * u64::from(layout::MARK_WORDS), bytemuck::cast_slice(&slots));
        }
        self.is_full = false;
        Ok(())
    }

    pub(super) fn resize(&mut self, slots: u32) {
        self.size = self.layout.size(slots.min(self.most_slots), self.buffer_words, self.num_rays);
    }

    pub(super) fn read(&self, plan: &TracePlan) -> Result<Reading> {
        let counted = plan.counted();
        let square = plan.square_of_birth_weight();
        let bytes = self.gpu.read(&self.words, 4 * self.layout.end(self.size))?;
        let words: Vec<u32> = bytemuck::pod_collect_to_vec(&bytes);
        let first_row = self.layout.first_row(self.size) as usize;
        let (slots, rows) = (&words[layout::MARK_WORDS as usize..first_row], &words[first_row..]);
        let sum = |row: u32| {
            let mut sum = PathSum::default();
            for words in self.layout.row(rows, self.size, row) {
                let count = u64::from(words[0]);
                sum += match counted.quanta {
                    Some(quanta) => PathSum {
                        count,
                        quanta: u128::from(count) * quanta,
                        squares: u128::from(count) * square,
                    },
                    None => PathSum {
                        count,
                        quanta: layout::sum(&words[1..4]),
                        squares: layout::sum(&words[4..7]),
                    },
                };
            }
            sum
        };
        let slots = (0..self.size.slots).zip(slots.chunks_exact(SLOT_WORDS as usize));
        let rows = slots.filter_map(|(number, words)| {
            let (key, slot) = layout::read_slot(words)?;
            Some((key, slot, sum(number)))
        });
        Ok(Reading {
            rows: rows.filter(|(.., sum)| sum.count > 0).collect(),
            other: (0..self.layout.num_ends).map(|place| sum(self.size.slots + place)).collect(),
            has_overflow: !self.is_closed && words[layout::OVERFLOW] != 0,
            has_large_squares: words[layout::LARGE_SQUARE] != 0,
        })
    }

    /// Finds the sequences of keys that are not known yet.
    pub(super) fn learn(
        &mut self,
        gpu: &Gpu,
        ir: &SceneIr,
        plan: &TracePlan,
        slots: impl Iterator<Item = (SequenceKey, Slot)>,
    ) -> Result<()> {
        let unknown: Vec<(SequenceKey, Slot)> =
            slots.filter(|(key, _)| !self.known.contains_key(key)).collect();
        if unknown.is_empty() {
            return Ok(());
        }
        let replay = match &mut self.replay {
            Some(replay) => replay,
            none => none.insert(PathReplay::new(gpu, ir, plan)?),
        };
        self.known.extend(replay.find(&unknown)?);
        Ok(())
    }

    /// Empties the rows of the table, and an open one's slots.
    pub(super) fn empty(&mut self) -> Result<()> {
        if !self.is_closed {
            return self.clear(None);
        }
        let first = self.layout.first_row(self.size);
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        let bytes = 4 * (self.layout.end(self.size) - first);
        encoder.clear_buffer(&self.words, 4 * first, Some(bytes));
        encoder.clear_buffer(&self.words, 0, Some(4 * u64::from(layout::MARK_WORDS)));
        self.gpu.queue.submit([encoder.finish()]);
        Ok(())
    }

    /// Asks the device whether a key has found no slot.
    pub(super) fn has_overflow(&self) -> Result<bool> {
        let word = self.gpu.read_at(&self.words, 4 * layout::OVERFLOW as u64, 4)?;
        Ok(word.iter().any(|byte| *byte != 0))
    }

    /// Sets the seed of the program that learns sequences.
    pub(super) fn set_seed(&mut self, seed: u64) {
        self.replay.iter_mut().for_each(|replay| replay.set_seed(seed));
    }
}

/// Most deposits of one launched ray that a table of paths keeps apart. A ray that detectors let pass may make one at
/// each of its events.
fn deposits_per_ray(program: &Program) -> u64 {
    match program.features.transmissive || program.splitting.is_some() {
        true => counts_per_ray(program),
        false => 1,
    }
}

/// Slots of the largest table of paths: twice the number of rows, or of deposits if these are fewer.
fn most_slots(plan: &TracePlan, most_rows: u32) -> u32 {
    let deposits = plan.num_rays.saturating_mul(deposits_per_ray(&plan.program));
    // Few rows need many slots as well, until a pilot has chosen what has a row.
    let rows = u64::from(most_rows).max(1 << 15).min(deposits);
    slots_for(rows as usize)
}
