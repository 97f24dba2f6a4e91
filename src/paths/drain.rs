//! Sums of light by path, from the device's table to a tally, and what happens where the table is full.
//!
//! A full table is made larger, and the rays since its last reading are traced once more. Their other sums are right,
//! and stay.
//!
//! A trace may have more sequences than its table may have rows. A pilot of the first 2^20 rays then decides which
//! sequences have rows: the ones of most flux. The table is then closed, so that it takes no other keys.

use crate::engine::Engine;
use crate::engine::budget::distribute;
use crate::engine::plan::TracePlan;
use crate::engine::retrace::{After, Batch, Retracing, trace_again};
use crate::error::{Error, Result};
use crate::model::SceneIr;
use crate::model::sequence::{End, Sequence, SequenceKey};
use crate::paths::layout::Slot;
use crate::paths::table::{PathHashTable, Reading};
use crate::program::RayRange;
use crate::result::{PathSum, PathTally, RaySpan, Tally};
use std::collections::HashMap;
use std::time::Instant;

/// How much larger the table becomes where it is full.
const GROWTH: u32 = 8;
/// Rays of the pilot.
const PILOT_RAYS: u64 = 1 << 20;

impl PathHashTable {
    /// Prepares the table for a trace that goes on from a tally.
    pub(super) fn begin(&mut self, tally: &mut Tally) -> Result<()> {
        let begun = tally.path_sums.get_or_insert_with(|| PathTally::new(self.most_rows));
        self.clear(begun.chosen.as_deref().filter(|_| begun.is_closed))
    }

    /// Asks the device whether the table is full.
    pub(super) fn check(&mut self) -> Result<()> {
        if !self.is_closed {
            self.is_full = self.has_overflow()?;
        }
        Ok(())
    }

    /// Finishes the table of a trace. Where parts of the trace together may have too many sequences, it is found out which
    /// of them then have rows.
    pub(super) fn finish(&mut self, engine: &Engine, tally: &mut Tally) -> Result<()> {
        match &mut tally.path_sums {
            Some(sums) if sums.chosen.is_none() && sums.may_grow_too_large(engine.plan.is_part()) => {
                sums.chosen = Some(self.choose(engine)?);
                Ok(())
            }
            _ => Ok(()),
        }
    }

    /// Adds the sums of all rays since the last time to a tally, and empties the table.
    pub(super) fn drain(&mut self, engine: &Engine, tally: &mut Tally) -> Result<()> {
        let sums = tally.path_sums.get_or_insert_with(|| PathTally::new(self.most_rows));
        let reading = self.read(&engine.plan)?;
        if !reading.has_overflow {
            self.add_reading(engine, reading, sums)?;
        } else {
            let spans = engine.undrained.rays.spans().to_vec();
            self.resize(self.num_slots().saturating_mul(GROWTH));
            self.clear(None)?;
            self.trace_again(engine, &spans, |table, reading| {
                table.add_reading(engine, reading, sums)?;
                table.ready(sums)
            })?;
        }
        self.ready(sums)
    }

    /// Empties the table, and closes it where the tally is closed.
    fn ready(&mut self, sums: &PathTally) -> Result<()> {
        match &sums.chosen {
            Some(chosen) if sums.is_closed && !self.is_closed => self.clear(Some(chosen)),
            _ => self.empty(),
        }
    }

    /// Adds what was read to a tally. Where that has too many rows, it is closed before.
    fn add_reading(&mut self, engine: &Engine, reading: Reading, sums: &mut PathTally) -> Result<()> {
        sums.squares_overflowed |= reading.has_large_squares;
        let is_new = |key: &SequenceKey| {
            self.known.get(key).is_none_or(|found| !sums.rows.contains_key(&found.sequence))
        };
        let num_new = || reading.rows.iter().filter(|(key, ..)| is_new(key)).count();
        if !sums.is_closed && sums.rows.len() + num_new() > sums.most_rows as usize {
            let chosen = match &sums.chosen {
                Some(chosen) => chosen.clone(),
                None => self.choose(engine)?,
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
            self.learn(engine.gpu, engine.ir, &engine.plan, slots)?;
            for (key, slot, sum) in reading.rows {
                match self.known.get(&key) {
                    Some(found) => *added.rows.entry(found.sequence.clone()).or_default() += sum,
                    None => *added.other.entry(slot.end).or_default() += sum,
                }
            }
        }
        for (end, sum) in End::all(engine.ir).into_iter().zip(reading.other).filter(|(_, sum)| sum.count > 0)
        {
            *added.other.entry(end).or_default() += sum;
        }
        *sums += &added;
        Ok(())
    }

    /// Traces rays once more, for the table alone. `add` takes what was read after each range, and readies the table for
    /// the next.
    fn trace_again(
        &mut self,
        engine: &Engine,
        spans: &[RaySpan],
        add: impl FnMut(&mut Self, Reading) -> Result<()>,
    ) -> Result<()> {
        // So few rays that an open table hardly becomes full; where it does, fewer.
        let batch = u64::from(engine.size.rays());
        let most = (u64::from(self.num_slots()) / 4).clamp(1, batch);
        let mut again = Again { engine, table: self, add, batch, most };
        let first = again.next();
        trace_again(&engine.device, &engine.plan, spans, first, &mut again)?;
        // The sums of this trace are not read.
        engine.device.clear_sums();
        Ok(())
    }

    /// The sequences that have rows, where a trace has more sequences than rows. The sequences of most flux among the
    /// first rays of the whole trace have rows. The choice depends on the scene and the draws alone. The table is used
    /// for it, and must have been read.
    fn choose(&mut self, engine: &Engine) -> Result<Vec<Sequence>> {
        self.resize(self.most_slots);
        self.clear(None)?;
        let mut sums: HashMap<SequenceKey, (Slot, PathSum)> = HashMap::new();
        let spans = pilot_rays(engine.ir, &engine.plan)?;
        self.trace_again(engine, &spans, |table, reading| {
            for (key, slot, sum) in reading.rows {
                sums.entry(key).or_insert((slot, PathSum::default())).1 += sum;
            }
            table.empty()
        })?;
        let mut ranked: Vec<(SequenceKey, Slot, u128)> =
            sums.into_iter().map(|(key, (slot, sum))| (key, slot, sum.quanta)).collect();
        ranked.sort_unstable_by_key(|(key, _, quanta)| (std::cmp::Reverse(*quanta), *key));
        ranked.truncate(self.most_rows as usize);
        self.learn(engine.gpu, engine.ir, &engine.plan, ranked.iter().map(|(key, slot, _)| (*key, *slot)))?;
        let mut chosen: Vec<Sequence> =
            ranked.iter().filter_map(|(key, ..)| Some(self.known.get(key)?.sequence.clone())).collect();
        chosen.sort_unstable();
        Ok(chosen)
    }
}

/// Rays that are traced again for the table.
struct Again<'a, F> {
    engine: &'a Engine<'a>,
    table: &'a mut PathHashTable,
    add: F,
    batch: u64,
    most: u64,
}

impl<F> Again<'_, F> {
    fn next(&self) -> Batch {
        let rays = if self.table.is_closed { self.batch } else { self.most };
        Batch { rays, submissions: self.engine.size.submissions() }
    }
}

impl<F: FnMut(&mut PathHashTable, Reading) -> Result<()>> Retracing for Again<'_, F> {
    fn after(&mut self, range: &RayRange, _start: Instant) -> Result<After> {
        let Again { engine, table, .. } = self;
        engine.device.forget_rows();
        let reading = table.read(&engine.plan)?;
        if reading.has_overflow {
            if table.num_slots() < table.most_slots {
                table.resize(table.num_slots().saturating_mul(GROWTH));
            } else if range.count == 1 {
                return Err(Error::Usage(format!(
                    "ray {} takes more paths than a table of {} rows holds; give a larger --path-rows, or a smaller \
                     split_depth",
                    range.first, table.most_rows
                )));
            } else {
                self.most = u64::from(range.count / 4).max(1);
            }
            table.clear(None)?;
            return Ok(After::Again(self.next()));
        }
        // Twice as many where the table stays nearly empty.
        if reading.rows.len() < table.num_slots() as usize / 8 {
            self.most = (2 * self.most).min(self.batch);
        }
        (self.add)(table, reading)?;
        Ok(After::Next(self.next()))
    }
}

/// The first rays of the whole trace: of each source its share. The pilot's rays of a single source do not depend on
/// how many rays are traced.
fn pilot_rays(ir: &SceneIr, plan: &TracePlan) -> Result<Vec<RaySpan>> {
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
