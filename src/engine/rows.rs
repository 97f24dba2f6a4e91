//! Rows for the host: rays of a database, and events of recorded paths.

use crate::engine::device::DeviceState;
use crate::engine::plan::TracePlan;
use crate::error::{Error, Result};
use crate::model::ray_id;
use crate::program::layout::reals::StructLayout;
use crate::program::rewrite::df64;
use crate::program::{Precision, RayRange, Splitting, events};
use crate::result::{PathEvent, PathEventKind, RayRow, Recorded, Recording, Tally};

/// Rows that are not yet in a tally.
#[derive(Default)]
pub(crate) struct Rows {
    events: Vec<DeviceEvent>,
    /// One recording per source, where rows are recorded instead of tallied.
    recordings: Vec<Recording>,
}

/// A row as the device wrote it. Positions are relative to the scene's centre.
pub(crate) struct DeviceEvent {
    pub(crate) kind: u32,
    pub(crate) subject: u32,
    pub(crate) row: RayRow,
}

impl Rows {
    /// From now on, fetched rows go to recordings, one for each source.
    pub(crate) fn record_to(&mut self, num_sources: usize, recording: impl Fn() -> Recording) {
        self.recordings = (0..num_sources).map(|_| recording()).collect();
    }

    /// The recorded rows, with sources in order; `None` without [`Rows::record_to`].
    pub(crate) fn take_recorded(&mut self) -> Result<Option<Recorded>> {
        let mut parts = std::mem::take(&mut self.recordings).into_iter();
        let Some(mut all) = parts.next() else { return Ok(None) };
        parts.try_for_each(|part| all.append(part.finish()))?;
        Ok(Some(all.finish()))
    }

    /// Fetches the rows of a range that a device has traced, if the device keeps rows.
    pub(crate) fn fetch(&mut self, device: &DeviceState, plan: &TracePlan, range: &RayRange) -> Result<()> {
        let Some(buffer) = &device.events else { return Ok(()) };
        let mut events = read_events(device, buffer, plan, range.first)?;
        let splits = plan.program.splitting.is_some();
        events.sort_unstable_by_key(|event| (event.row.order(splits), event.kind));
        match self.recordings.get_mut(range.source) {
            Some(recording) => events.into_iter().try_for_each(|event| event.record(recording))?,
            None => self.events.append(&mut events),
        }
        Ok(())
    }

    /// Moves all rows to a tally.
    pub(crate) fn drain(&mut self, tally: &mut Tally) {
        for event in self.events.drain(..) {
            match event.path_event() {
                Some(path_event) => tally.paths.push(path_event),
                None => tally.detectors[event.subject as usize].rows.push(event.row),
            }
        }
    }
}

/// Reads the rows of the range that began at ray `first`, in the order in which the device wrote them, and forgets them.
pub(crate) fn read_events(
    device: &DeviceState,
    buffer: &wgpu::Buffer,
    plan: &TracePlan,
    first: u64,
) -> Result<Vec<DeviceEvent>> {
    let counts = device.gpu.read(&device.counts, 12)?;
    let num_events = u32::from_le_bytes([counts[8], counts[9], counts[10], counts[11]]);
    let layout = StructLayout::of(&plan.program.module, "Event")?;
    let size = u64::from(num_events) * layout.stride as u64;
    if size > buffer.size() {
        return Err(Error::Internal(format!("{num_events} rows do not fit the buffer")));
    }
    let bytes = device.gpu.read(buffer, size)?;
    device.forget_rows();
    Ok(bytes.chunks_exact(layout.stride).map(decoder(plan, &layout, first)?).collect())
}

/// A function that decodes the rows of the range that began at ray `first`.
fn decoder(
    plan: &TracePlan,
    layout: &StructLayout,
    first: u64,
) -> Result<impl Fn(&[u8]) -> DeviceEvent + use<>> {
    let at = |field: &str| layout.offset(field);
    let [kind, subject, index, bounce, wavelength] =
        [at("kind")?, at("subject")?, at("index")?, at("bounce")?, at("wavelength")?];
    let position = [at("position_x")?, at("position_y")?, at("position_z")?];
    let direction = [at("direction_x")?, at("direction_y")?, at("direction_z")?];
    let weight = at("weight")?;
    let centre = plan.program.centre.to_array();
    let precision = plan.options.precision;
    let splitting = plan.program.splitting;
    Ok(move |row: &[u8]| {
        let uint = |at: usize| u32::from_le_bytes(row[at..at + 4].try_into().unwrap_or_default());
        let real = |at: usize| match precision {
            Precision::F32 => f64::from(f32::from_bits(uint(at))),
            Precision::Df64 => df64::join([at, at + 4].map(|at| f32::from_bits(uint(at)))),
            Precision::F64 => f64::from_le_bytes(row[at..at + 8].try_into().unwrap_or_default()),
        };
        DeviceEvent {
            kind: uint(kind),
            subject: uint(subject),
            row: RayRow {
                ray_id: ray_id_of(splitting, first, uint(index)),
                bounce: uint(bounce),
                wavelength: uint(wavelength),
                position: [0, 1, 2].map(|axis| real(position[axis]) + centre[axis]),
                direction: direction.map(real),
                weight: real(weight),
            },
        }
    })
}

impl DeviceEvent {
    /// The event of a path; `None` if the row belongs to a ray database.
    fn path_event(&self) -> Option<PathEvent> {
        let index = self.subject as usize;
        let kind = match (self.kind, self.subject) {
            (events::RECORDED, _) => return None,
            (events::BIRTH, _) => PathEventKind::Birth(index),
            (events::SURFACE, _) => PathEventKind::Surface(index),
            (events::DETECTOR, _) => PathEventKind::Detector(index),
            (_, events::ESCAPED) => PathEventKind::Escaped,
            (_, events::DEPTH_KILLED) => PathEventKind::DepthKilled,
            (..) => PathEventKind::FluxKilled,
        };
        Some(PathEvent { ray: self.row, kind })
    }

    fn record(self, recording: &mut Recording) -> Result<()> {
        match self.path_event() {
            Some(event) => recording.event(&event),
            None => recording.ray(self.subject as usize, self.row),
        }
    }
}

/// The id of a ray with this index in the range that began at ray `first`.
fn ray_id_of(splitting: Option<Splitting>, first: u64, index: u32) -> u64 {
    let (position, number) = splitting.map_or((index, 0), |splitting| splitting.parts(index));
    ray_id::of(first + u64::from(position), number)
}
