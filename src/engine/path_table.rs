//! The table of paths on the device: how large it is, how it is emptied, and how it is read.
//!
//! The table begins small. A key that finds no slot marks the table as full ([`crate::engine::paths`]).

use crate::engine::device::DeviceState;
use crate::engine::plan::Plan;
use crate::engine::sequences::{Found, Teller};
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::model::SceneIr;
use crate::model::sequence::{Sequence, SequenceKey};
use crate::program::layout::paths::{self, PathTableLayout, PathTableSize, SLOT_WORDS, Slot};
use crate::result::PathSum;
use std::collections::HashMap;

/// Slots of a table that has just begun.
const FIRST_SLOTS: u32 = 1 << 10;

/// The table of paths of an engine.
pub(crate) struct PathTable {
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
    /// Sequences that were told before, also in earlier traces by this engine.
    pub(super) known: HashMap<SequenceKey, Found>,
    /// Compiled when it is first needed.
    teller: Option<Teller>,
}

/// What was read from the table.
pub(super) struct Reading {
    pub(super) rows: Vec<(SequenceKey, Slot, PathSum)>,
    /// Sums of keys without a slot, by their ends.
    pub(super) other: Vec<PathSum>,
    pub(super) has_overflow: bool,
    pub(super) has_large_squares: bool,
}

impl PathTable {
    /// The table of a plan, if there is one.
    pub(crate) fn of(plan: &Plan) -> Option<Self> {
        let layout = plan.program.path_table?;
        let (most_slots, buffer_words) = (plan.most_path_slots(), plan.path_table_words()?);
        let size = layout.size(FIRST_SLOTS.min(most_slots), buffer_words, plan.num_rays);
        Some(PathTable {
            layout,
            size,
            most_slots,
            buffer_words,
            most_rows: plan.options.path_rows,
            num_rays: plan.num_rays,
            is_closed: false,
            is_full: false,
            known: HashMap::new(),
            teller: None,
        })
    }

    pub(super) fn num_slots(&self) -> u32 {
        self.size.slots
    }

    /// Empties the table on the device. A closed table keeps its keys.
    pub(super) fn clear(&mut self, device: &DeviceState, chosen: Option<&[Sequence]>) -> Result<()> {
        let buffer = buffer_of(device)?;
        self.is_closed = chosen.is_some();
        if let Some(chosen) = chosen {
            self.resize(paths::slots_for(chosen.len()));
        }
        let head = paths::head(&self.layout, self.size, self.is_closed);
        let queue = &device.gpu.queue;
        let mut encoder = device.gpu.device.create_command_encoder(&Default::default());
        encoder.clear_buffer(buffer, 0, Some(4 * self.layout.end(self.size).min(self.buffer_words)));
        queue.submit([encoder.finish()]);
        queue.write_buffer(&device.paths_head, 0, bytemuck::cast_slice(&head));
        if let Some(chosen) = chosen {
            let mut slots = vec![0; (self.size.slots * SLOT_WORDS) as usize];
            for sequence in chosen {
                let contents = [sequence.end.code(), 0, 0, sequence.source, paths::NO_MAP];
                if paths::insert(&mut slots, self.size, sequence.key(), contents).is_none() {
                    return Err(Error::Internal("a chosen path has no slot".into()));
                }
            }
            queue.write_buffer(buffer, 4 * u64::from(paths::MARK_WORDS), bytemuck::cast_slice(&slots));
        }
        self.is_full = false;
        Ok(())
    }

    pub(super) fn resize(&mut self, slots: u32) {
        self.size = self.layout.size(slots.min(self.most_slots), self.buffer_words, self.num_rays);
    }

    pub(super) fn read(&self, device: &DeviceState, plan: &Plan) -> Result<Reading> {
        let (gpu, buffer) = (&device.gpu, buffer_of(device)?);
        let counted = plan.counted();
        let square = plan.square_of_birth_weight();
        let bytes = gpu.read(buffer, 4 * self.layout.end(self.size))?;
        let words: Vec<u32> = bytemuck::pod_collect_to_vec(&bytes);
        let first_row = self.layout.first_row(self.size) as usize;
        let (slots, rows) = (&words[paths::MARK_WORDS as usize..first_row], &words[first_row..]);
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
                    None => {
                        PathSum { count, quanta: paths::sum(&words[1..4]), squares: paths::sum(&words[4..7]) }
                    }
                };
            }
            sum
        };
        let slots = (0..self.size.slots).zip(slots.chunks_exact(SLOT_WORDS as usize));
        let rows = slots.filter_map(|(number, words)| {
            let (key, slot) = paths::read_slot(words)?;
            Some((key, slot, sum(number)))
        });
        Ok(Reading {
            rows: rows.filter(|(.., sum)| sum.count > 0).collect(),
            other: (0..self.layout.num_ends).map(|place| sum(self.size.slots + place)).collect(),
            has_overflow: !self.is_closed && words[paths::OVERFLOW] != 0,
            has_large_squares: words[paths::LARGE_SQUARE] != 0,
        })
    }

    /// Finds the sequences of keys that are not known yet.
    pub(super) fn learn(
        &mut self,
        gpu: &Gpu,
        ir: &SceneIr,
        plan: &Plan,
        slots: impl Iterator<Item = (SequenceKey, Slot)>,
    ) -> Result<()> {
        let unknown: Vec<(SequenceKey, Slot)> =
            slots.filter(|(key, _)| !self.known.contains_key(key)).collect();
        if unknown.is_empty() {
            return Ok(());
        }
        let teller = match &mut self.teller {
            Some(teller) => teller,
            none => none.insert(Teller::new(gpu, ir, &plan.options)?),
        };
        self.known.extend(teller.tell(&unknown)?);
        Ok(())
    }

    /// Empties the rows of the table, and an open one's slots.
    pub(super) fn empty(&mut self, device: &DeviceState) -> Result<()> {
        if !self.is_closed {
            return self.clear(device, None);
        }
        let (buffer, first) = (buffer_of(device)?, self.layout.first_row(self.size));
        let mut encoder = device.gpu.device.create_command_encoder(&Default::default());
        let bytes = 4 * (self.layout.end(self.size) - first);
        encoder.clear_buffer(buffer, 4 * first, Some(bytes));
        encoder.clear_buffer(buffer, 0, Some(4 * u64::from(paths::MARK_WORDS)));
        device.gpu.queue.submit([encoder.finish()]);
        Ok(())
    }

    /// Sets the seed of the program that tells paths.
    pub(super) fn set_seed(&mut self, seed: u64) {
        self.teller.iter_mut().for_each(|teller| teller.set_seed(seed));
    }
}

fn buffer_of(device: &DeviceState) -> Result<&wgpu::Buffer> {
    device.paths.as_ref().ok_or_else(|| Error::Internal("there is no table of paths".into()))
}
