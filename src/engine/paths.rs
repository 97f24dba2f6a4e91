//! Sums of light by path, from the device's table to a tally, and what happens where the table is full.
//!
//! A full table is made larger, and the rays since its last reading are traced once more. Their other sums are right,
//! and stay.
//!
//! Where a trace has more sequences than its table may have rows, a pilot of the first 2^20 rays decides which of them
//! have rows: those of most flux. The table is then closed, so that it takes no other keys.

use crate::engine::Engine;
use crate::engine::budget::distribute;
use crate::engine::dispatch::submit_alone;
use crate::engine::path_table::{PathTable, Reading};
use crate::engine::plan::Plan;
use crate::error::{Error, Result};
use crate::model::SceneIr;
use crate::model::sequence::{End, Sequence, SequenceKey};
use crate::program::RayRange;
use crate::program::layout::paths::{OVERFLOW, Slot};
use crate::result::{PathSum, PathTally, RaySpan, Tally};
use glam::DVec3;
use std::collections::HashMap;

/// How much larger the table becomes where it is full.
const GROWTH: u32 = 8;
/// Rays of the pilot.
const PILOT_RAYS: u64 = 1 << 20;

impl Engine<'_> {
    /// Prepares the table for a trace that goes on from a tally.
    pub(crate) fn begin_paths(&mut self, tally: &mut Tally) -> Result<()> {
        let Some(table) = &mut self.path_table else { return Ok(()) };
        let begun = tally.path_sums.get_or_insert_with(|| PathTally::new(table.most_rows));
        table.clear(&self.device, begun.chosen.as_deref().filter(|_| begun.is_closed))
    }

    /// Asks the device whether the table is full.
    pub(crate) fn check_paths(&mut self) -> Result<()> {
        let (Some(table), Some(buffer)) = (&mut self.path_table, &self.device.paths) else { return Ok(()) };
        if !table.is_closed {
            let word = self.device.gpu.read_at(buffer, 4 * OVERFLOW as u64, 4)?;
            table.is_full = word.iter().any(|byte| *byte != 0);
        }
        Ok(())
    }

    /// True if the table is known to be full.
    pub(crate) fn path_table_is_full(&self) -> bool {
        self.path_table.as_ref().is_some_and(|table| table.is_full)
    }

    /// Adds the sums of all rays since the last time to a tally, and empties the table.
    pub(crate) fn drain_paths(&mut self, tally: &mut Tally) -> Result<()> {
        self.with_table(|engine, table| engine.drain_table(table, tally))
    }

    /// Finishes the table of a trace. Where parts of the trace together may have too many sequences, it is found out which
    /// of them then have rows.
    pub(crate) fn finish_paths(&mut self, tally: &mut Tally) -> Result<()> {
        self.with_table(|engine, table| match &mut tally.path_sums {
            Some(sums) if sums.chosen.is_none() && sums.may_grow_too_large(engine.plan.is_part()) => {
                sums.chosen = Some(engine.choose(table)?);
                Ok(())
            }
            _ => Ok(()),
        })
    }

    /// Where some ray came to the end of each path that this engine found, in the scene's frame \[mm\].
    pub(crate) fn found_paths(&self) -> HashMap<&Sequence, DVec3> {
        let known = self.path_table.iter().flat_map(|table| table.known.values());
        known.map(|found| (&found.sequence, found.position)).collect()
    }

    fn with_table(&mut self, work: impl FnOnce(&mut Self, &mut PathTable) -> Result<()>) -> Result<()> {
        let Some(mut table) = self.path_table.take() else { return Ok(()) };
        let done = work(self, &mut table);
        self.path_table = Some(table);
        done
    }

    fn drain_table(&mut self, table: &mut PathTable, tally: &mut Tally) -> Result<()> {
        let sums = tally.path_sums.get_or_insert_with(|| PathTally::new(table.most_rows));
        let reading = table.read(&self.device, &self.plan)?;
        if !reading.has_overflow {
            self.add_reading(table, reading, sums)?;
        } else {
            let spans = self.undrained.rays.spans().to_vec();
            table.resize(table.num_slots().saturating_mul(GROWTH));
            table.clear(&self.device, None)?;
            self.trace_again(table, &spans, |engine, table, reading| {
                engine.add_reading(table, reading, sums)?;
                engine.ready_table(table, sums)
            })?;
        }
        self.ready_table(table, sums)
    }

    /// Empties the table, and closes it where the tally is closed.
    fn ready_table(&self, table: &mut PathTable, sums: &PathTally) -> Result<()> {
        match &sums.chosen {
            Some(chosen) if sums.is_closed && !table.is_closed => table.clear(&self.device, Some(chosen)),
            _ => table.empty(&self.device),
        }
    }

    /// Adds what was read to a tally. Where that has too many rows, it is closed before.
    fn add_reading(&mut self, table: &mut PathTable, reading: Reading, sums: &mut PathTally) -> Result<()> {
        sums.squares_overflowed |= reading.has_large_squares;
        let is_new = |key: &SequenceKey| {
            table.known.get(key).is_none_or(|found| !sums.rows.contains_key(&found.sequence))
        };
        let num_new = || reading.rows.iter().filter(|(key, ..)| is_new(key)).count();
        if !sums.is_closed && sums.rows.len() + num_new() > sums.most_rows as usize {
            let chosen = match &sums.chosen {
                Some(chosen) => chosen.clone(),
                None => self.choose(table)?,
            };
            sums.close(chosen);
        }
        let mut added = PathTally::new(sums.most_rows);
        if sums.is_closed {
            let chosen: HashMap<SequenceKey, &Sequence> =
                sums.chosen.iter().flatten().map(|sequence| (sequence.key(), sequence)).collect();
            for (key, slot, sum) in reading.rows {
                match chosen.get(&key) {
                    Some(sequence) => *added.rows.entry((*sequence).clone()).or_default() += sum,
                    None => *added.other.entry(slot.end).or_default() += sum,
                }
            }
        } else {
            let slots = reading.rows.iter().map(|(key, slot, _)| (*key, *slot));
            table.learn(self.gpu, self.ir, &self.plan, slots)?;
            for (key, slot, sum) in reading.rows {
                match table.known.get(&key) {
                    Some(found) => *added.rows.entry(found.sequence.clone()).or_default() += sum,
                    None => *added.other.entry(slot.end).or_default() += sum,
                }
            }
        }
        for (end, sum) in End::all(self.ir).into_iter().zip(reading.other).filter(|(_, sum)| sum.count > 0) {
            *added.other.entry(end).or_default() += sum;
        }
        *sums += &added;
        Ok(())
    }

    /// Traces rays once more, for the table alone. `add` takes what was read after each range, and readies the table for
    /// the next.
    fn trace_again(
        &mut self,
        table: &mut PathTable,
        spans: &[RaySpan],
        mut add: impl FnMut(&mut Self, &mut PathTable, Reading) -> Result<()>,
    ) -> Result<()> {
        // So few rays that an open table hardly becomes full; where it does, fewer.
        let batch = u64::from(self.size.rays());
        let mut most = (u64::from(table.num_slots()) / 4).clamp(1, batch);
        for span in spans {
            let (mut next, end) = (span.first, span.end());
            while next < end {
                let count = (end - next).min(if table.is_closed { batch } else { most });
                let range = RayRange::of(next, count as u32, span.source as usize);
                // The sums of this trace are not read.
                submit_alone(&self.device, &self.plan, &range, self.size.submissions(), |_| Ok(()))?;
                self.device.forget_rows();
                let reading = table.read(&self.device, &self.plan)?;
                if reading.has_overflow {
                    if table.num_slots() < table.most_slots {
                        table.resize(table.num_slots().saturating_mul(GROWTH));
                        table.clear(&self.device, None)?;
                        continue;
                    }
                    if count == 1 {
                        return Err(Error::Usage(format!(
                            "ray {next} takes more paths than a table of {} rows holds; give a larger --path-rows, or a \
                             smaller split_depth",
                            table.most_rows
                        )));
                    }
                    most = (count / 4).max(1);
                    table.clear(&self.device, None)?;
                    continue;
                }
                // Twice as many where the table stays nearly empty.
                if reading.rows.len() < table.num_slots() as usize / 8 {
                    most = (2 * most).min(batch);
                }
                add(self, table, reading)?;
                next += count;
            }
        }
        self.device.check_loops_of_second_trace(&self.plan.program)?;
        self.device.clear_sums();
        Ok(())
    }

    /// The sequences that have rows where there are more of them: those of most flux among the first rays of the whole
    /// trace. The choice depends on the scene and the draws alone. The table is used for it, and must have been read.
    fn choose(&mut self, table: &mut PathTable) -> Result<Vec<Sequence>> {
        table.resize(table.most_slots);
        table.clear(&self.device, None)?;
        let mut sums: HashMap<SequenceKey, (Slot, PathSum)> = HashMap::new();
        let spans = pilot_rays(self.ir, &self.plan)?;
        self.trace_again(table, &spans, |engine, table, reading| {
            for (key, slot, sum) in reading.rows {
                sums.entry(key).or_insert((slot, PathSum::default())).1 += sum;
            }
            table.empty(&engine.device)
        })?;
        let mut ranked: Vec<(SequenceKey, Slot, u128)> =
            sums.into_iter().map(|(key, (slot, sum))| (key, slot, sum.quanta)).collect();
        ranked.sort_unstable_by_key(|(key, _, quanta)| (std::cmp::Reverse(*quanta), *key));
        ranked.truncate(table.most_rows as usize);
        table.learn(self.gpu, self.ir, &self.plan, ranked.iter().map(|(key, slot, _)| (*key, *slot)))?;
        let mut chosen: Vec<Sequence> =
            ranked.iter().filter_map(|(key, ..)| Some(table.known.get(key)?.sequence.clone())).collect();
        chosen.sort_unstable();
        Ok(chosen)
    }
}

/// The first rays of the whole trace: of each source its share. Those of a single source do not depend on how many rays
/// are traced.
fn pilot_rays(ir: &SceneIr, plan: &Plan) -> Result<Vec<RaySpan>> {
    if plan.rays.len() == 1 {
        return Ok(vec![RaySpan { first: 0, count: PILOT_RAYS, source: 0 }]);
    }
    let budget = plan.options.budget();
    let rays = distribute(ir, budget, plan.options.shares.as_deref())?;
    let spans = (0..).zip(&rays).map(|(source, rays)| RaySpan {
        first: rays.first,
        count: rays.done(PILOT_RAYS.min(budget), budget),
        source,
    });
    Ok(spans.collect())
}
