//! What a trace records row by row, in the order of (ray id, event). Rows lie in memory, or in files without a name
//! that vanish with the process.
//!
//! A row is [`WORDS`] words of 64 bits. Rows are kept in blocks, each column by column. So a file of results is
//! written one column after the other, while every row is read once. Only the last, incomplete block is always in
//! memory: that bounds what a trace of any length holds.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use crate::error::{Error, Result};
use crate::model::{DetectorKind, SceneIr, ray_id};
use crate::result::{PathEvent, PathEventKind, RayRow, Tally};

/// Rows in a block.
pub const BLOCK_ROWS: usize = 1 << 14;
/// 64-bit words in a row.
pub const WORDS: usize = 10;
const BLOCK_BYTES: usize = BLOCK_ROWS * WORDS * 8;

/// The word of a row that holds its ray id.
pub(crate) const RAY_ID: usize = 0;
/// The word that holds the number of events before it, and above it the index of its wavelength.
pub(crate) const BOUNCE_AND_WAVELENGTH: usize = 1;
/// The first of the three words of its position.
pub(crate) const POSITION: usize = 2;
/// The first of the three words of its direction.
pub(crate) const DIRECTION: usize = 5;
/// The word that holds its weight.
pub(crate) const WEIGHT: usize = 8;
/// The word that holds what happened.
pub(crate) const KIND: usize = 9;

/// Where complete blocks go.
#[derive(Debug)]
enum Store {
    Memory(VecDeque<Vec<u64>>),
    /// A file without a name on the file system of the folder.
    File {
        folder: PathBuf,
        /// None before the first block.
        file: Mutex<Option<File>>,
    },
    /// Rows are counted alone.
    Nowhere,
}

/// Rows in the making.
#[derive(Debug)]
pub struct RowWriter {
    rows: Rows,
}

/// Rows that were recorded: all of them, or the last so many.
#[derive(Debug)]
pub struct Rows {
    store: Store,
    /// Rows recorded, those included that were not kept.
    recorded: u64,
    /// Rows that were recorded before these, and kept nowhere.
    before: u64,
    keep: Option<u64>,
    /// The rows after the last complete block, at most a block.
    tail: Vec<[u64; WORDS]>,
}

impl RowWriter {
    fn new(store: Store, keep: Option<u64>) -> Self {
        RowWriter { rows: Rows { store, recorded: 0, before: 0, keep, tail: Vec::new() } }
    }

    /// Rows that stay in memory; the last `keep` of them, or all.
    pub fn in_memory(keep: Option<u64>) -> Self {
        RowWriter::new(Store::Memory(VecDeque::new()), keep)
    }

    /// Rows that go to a nameless file on the file system of `folder`; the last `keep` of them, or all.
    pub fn in_folder(folder: &Path, keep: Option<u64>) -> Self {
        RowWriter::new(Store::File { folder: folder.into(), file: Mutex::new(None) }, keep)
    }

    /// Rows that go to this file: for tests of files that cannot be written.
    #[doc(hidden)]
    pub fn in_file(file: File, path: &Path) -> Self {
        RowWriter::new(Store::File { folder: path.into(), file: Mutex::new(Some(file)) }, None)
    }

    /// Rows that are counted and forgotten.
    pub fn nowhere() -> Self {
        RowWriter::new(Store::Nowhere, None)
    }

    /// Adds a row, which must follow the rows before it in the order of (ray id, event).
    ///
    /// # Errors
    /// [`Error::File`] if a file cannot be written, as when its disk is full.
    pub fn push(&mut self, event: &PathEvent) -> Result<()> {
        let rows = &mut self.rows;
        rows.tail.push(words_of(event));
        rows.recorded += 1;
        if rows.tail.len() == BLOCK_ROWS { rows.store_block() } else { Ok(()) }
    }

    /// Adds rows that were recorded apart, and all follow the rows before them.
    ///
    /// # Errors
    /// As [`RowWriter::push`], and [`Error::File`] if a file cannot be read.
    fn append(&mut self, rows: &Rows) -> Result<()> {
        if matches!(self.rows.store, Store::Nowhere) {
            self.rows.recorded += rows.recorded;
            return Ok(());
        }
        self.rows.before += rows.num_recorded() - rows.len();
        let mut pushed = Ok(());
        rows.for_each(|event| {
            if pushed.is_ok() {
                pushed = self.push(event);
            }
        })?;
        pushed
    }

    /// The rows, for reading.
    pub fn finish(self) -> Arc<Rows> {
        Arc::new(self.rows)
    }
}

impl Rows {
    /// Rays in memory.
    pub(crate) fn of_rays(mut rays: impl Iterator<Item = RayRow>) -> Result<Arc<Self>> {
        let mut writer = RowWriter::in_memory(None);
        rays.try_for_each(|ray| writer.push(&PathEvent { ray, kind: PathEventKind::Detector(0) }))?;
        Ok(writer.finish())
    }

    /// Rows kept.
    pub fn len(&self) -> u64 {
        self.keep.map_or(self.recorded, |keep| keep.min(self.recorded))
    }

    /// True if no row was kept.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Rows recorded, those included that were not kept.
    pub fn num_recorded(&self) -> u64 {
        self.before + self.recorded
    }

    /// Calls `take` with every row kept, in order.
    ///
    /// # Errors
    /// [`Error::File`] if a file cannot be read, [`Error::Usage`] if the rows were only counted.
    pub fn for_each(&self, mut take: impl FnMut(&PathEvent)) -> Result<()> {
        for block in self.blocks() {
            let columns = self.read(block, 0..WORDS)?;
            let num_rows = columns.len() / WORDS;
            for row in self.kept_of(block) {
                take(&event_of(std::array::from_fn(|word| columns[word * num_rows + row])));
            }
        }
        Ok(())
    }

    /// Calls `take` with one word of all rows kept, a block at a time, in order.
    ///
    /// # Errors
    /// As [`Rows::for_each`], and the errors of `take`.
    pub(crate) fn for_each_block(
        &self,
        word: usize,
        mut take: impl FnMut(&[u64]) -> io::Result<()>,
    ) -> Result<()> {
        for block in self.blocks() {
            let column = self.read(block, word..word + 1)?;
            take(&column[self.kept_of(block)]).map_err(|error| self.problem(&error))?;
        }
        Ok(())
    }

    /// All rows kept, in memory at once.
    ///
    /// # Errors
    /// As [`Rows::for_each`].
    pub fn to_vec(&self) -> Result<Vec<PathEvent>> {
        let mut events = Vec::with_capacity(self.len() as usize);
        self.for_each(|event| events.push(*event))?;
        Ok(events)
    }

    /// Complete blocks recorded.
    fn num_complete(&self) -> u64 {
        self.recorded / BLOCK_ROWS as u64
    }

    /// The blocks that hold rows to be kept.
    fn blocks(&self) -> Range<u64> {
        if self.is_empty() {
            return 0..0;
        }
        (self.recorded - self.len()) / BLOCK_ROWS as u64..self.recorded.div_ceil(BLOCK_ROWS as u64)
    }

    /// The rows of a block that are to be kept.
    fn kept_of(&self, block: u64) -> Range<usize> {
        let start = block * BLOCK_ROWS as u64;
        let first = (self.recorded - self.len()).saturating_sub(start) as usize;
        let end = (self.recorded - start).min(BLOCK_ROWS as u64) as usize;
        first..end
    }

    /// Complete blocks that must be there at once so that the last `keep` rows are.
    fn most_blocks(&self) -> Option<u64> {
        self.keep.map(|keep| keep.div_ceil(BLOCK_ROWS as u64).max(1))
    }

    /// Stores the tail as a block, in the place of one that is no longer needed.
    fn store_block(&mut self) -> Result<()> {
        let block = self.num_complete() - 1;
        let offset = self.offset(block);
        let most = self.most_blocks();
        let columns = || (0..WORDS).flat_map(|word| self.tail.iter().map(move |row| row[word]));
        let stored = match &mut self.store {
            Store::Nowhere => Ok(()),
            Store::Memory(blocks) => {
                blocks.push_back(columns().collect());
                if most.is_some_and(|most| blocks.len() as u64 > most) {
                    blocks.pop_front();
                }
                Ok(())
            }
            Store::File { folder, file } => {
                let mut bytes = Vec::with_capacity(BLOCK_BYTES);
                columns().for_each(|word| bytes.extend_from_slice(&word.to_le_bytes()));
                write_at(file, folder, offset, &bytes)
            }
        };
        stored.map_err(|error| self.problem(&error))?;
        self.tail.clear();
        Ok(())
    }

    /// Columns `words` of a block, one after the other.
    fn read(&self, block: u64, words: Range<usize>) -> Result<Vec<u64>> {
        if block == self.num_complete() {
            return Ok(words.flat_map(|word| self.tail.iter().map(move |row| row[word])).collect());
        }
        match &self.store {
            Store::Nowhere => Err(Error::Usage("the rows of the trace were counted, but not kept".into())),
            Store::Memory(blocks) => {
                let first = self.num_complete() - blocks.len() as u64;
                let all = &blocks[(block - first) as usize];
                Ok(all[words.start * BLOCK_ROWS..words.end * BLOCK_ROWS].to_vec())
            }
            Store::File { file, .. } => {
                let offset = self.offset(block) + (words.start * BLOCK_ROWS * 8) as u64;
                let bytes = read_at(file, offset, words.len() * BLOCK_ROWS * 8);
                let bytes = bytes.map_err(|error| self.problem(&error))?;
                Ok(bytes
                    .chunks_exact(8)
                    .map(|word| u64::from_le_bytes(word.try_into().unwrap_or_default()))
                    .collect())
            }
        }
    }

    /// Where a complete block lies in a file.
    fn offset(&self, block: u64) -> u64 {
        self.most_blocks().map_or(block, |most| block % most) * BLOCK_BYTES as u64
    }

    fn problem(&self, error: &io::Error) -> Error {
        let folder = match &self.store {
            Store::File { folder, .. } => folder.as_path(),
            Store::Memory(_) | Store::Nowhere => Path::new(""),
        };
        Error::file(
            folder,
            format!("{error}, with {} recorded rows of {} bytes to keep here", self.len(), WORDS * 8),
        )
    }
}

impl PartialEq for Rows {
    fn eq(&self, other: &Self) -> bool {
        self.num_recorded() == other.num_recorded() && self.to_vec() == other.to_vec()
    }
}

fn write_at(file: &Mutex<Option<File>>, folder: &Path, offset: u64, bytes: &[u8]) -> io::Result<()> {
    with_file(file, |file| {
        if file.is_none() {
            *file = Some(tempfile::tempfile_in(folder)?);
        }
        let Some(file) = file else { return Ok(()) };
        file.seek(SeekFrom::Start(offset))?;
        file.write_all(bytes)
    })
}

fn read_at(file: &Mutex<Option<File>>, offset: u64, num_bytes: usize) -> io::Result<Vec<u8>> {
    let mut bytes = vec![0; num_bytes];
    with_file(file, |file| {
        let Some(file) = file else { return Err(io::Error::other("no row was written")) };
        file.seek(SeekFrom::Start(offset))?;
        file.read_exact(&mut bytes)
    })?;
    Ok(bytes)
}

fn with_file<T>(
    file: &Mutex<Option<File>>,
    act: impl FnOnce(&mut Option<File>) -> io::Result<T>,
) -> io::Result<T> {
    let mut file = file.lock().map_err(|_| io::Error::other("a thread died while it held the file"))?;
    act(&mut file)
}

/// All that a trace records by rows: the rays of databases, and the events of paths.
#[derive(Debug)]
pub struct Recording {
    /// Per detector. `None` for other kinds than a ray database.
    databases: Vec<Option<RowWriter>>,
    paths: RowWriter,
}

/// A finished [`Recording`].
#[derive(Debug, Clone, PartialEq)]
pub struct Recorded {
    /// Per detector. `None` for other kinds than a ray database.
    pub databases: Vec<Option<Arc<Rows>>>,
    /// Events of the recorded paths.
    pub paths: Arc<Rows>,
}

impl Recording {
    fn new(ir: &SceneIr, paths: RowWriter, rows: impl Fn(Option<u64>) -> RowWriter) -> Self {
        let database = |kind: &DetectorKind| kind.stores_rays().then(|| rows(kind.max_rays()));
        Recording { databases: ir.detectors.iter().map(|detector| database(&detector.kind)).collect(), paths }
    }

    /// Rows stay in memory.
    pub fn in_memory(ir: &SceneIr) -> Self {
        Recording::new(ir, RowWriter::in_memory(None), RowWriter::in_memory)
    }

    /// Rows go to nameless files on the file system of `folder`: memory does not grow with the rays.
    pub fn in_folder(ir: &SceneIr, folder: &Path) -> Self {
        Recording::new(ir, RowWriter::in_folder(folder, None), |keep| RowWriter::in_folder(folder, keep))
    }

    /// For a trace without files: rows are counted, and only databases with a limit keep their last rows, for their flux.
    pub fn counted(ir: &SceneIr) -> Self {
        let temporary = std::env::temp_dir();
        Recording::new(ir, RowWriter::nowhere(), |keep| match keep {
            Some(_) => RowWriter::in_folder(&temporary, keep),
            None => RowWriter::nowhere(),
        })
    }

    /// Records a ray on a detector.
    ///
    /// # Errors
    /// [`Error::File`] if a file cannot be written.
    pub fn ray(&mut self, detector: usize, ray: RayRow) -> Result<()> {
        match self.databases.get_mut(detector) {
            Some(Some(rows)) => rows.push(&PathEvent { ray, kind: PathEventKind::Detector(detector) }),
            _ => Err(Error::Internal(format!("a row for detector {detector}, which is no ray database"))),
        }
    }

    /// Records an event of a path.
    ///
    /// # Errors
    /// [`Error::File`] if a file cannot be written.
    pub fn event(&mut self, event: &PathEvent) -> Result<()> {
        self.paths.push(event)
    }

    /// Adds what was recorded of rays that all follow those before them.
    ///
    /// # Errors
    /// [`Error::File`] if a file cannot be read or written.
    pub(crate) fn append(&mut self, part: Recorded) -> Result<()> {
        for (writer, rows) in self.databases.iter_mut().zip(part.databases) {
            if let (Some(writer), Some(rows)) = (writer, rows) {
                writer.append(&rows)?;
            }
        }
        self.paths.append(&part.paths)
    }

    /// Ends the recording.
    pub fn finish(self) -> Recorded {
        Recorded {
            databases: self.databases.into_iter().map(|rows| rows.map(RowWriter::finish)).collect(),
            paths: self.paths.finish(),
        }
    }
}

impl Recorded {
    /// The rows that a tally holds, which may be in any order.
    ///
    /// # Errors
    /// [`Error::Internal`] if the tally is not one of this scene.
    pub fn of_tally(ir: &SceneIr, tally: &Tally) -> Result<Self> {
        let mut recording = Recording::in_memory(ir);
        let splits = crate::model::surface_optics::splits(ir);
        for (index, detector) in tally.detectors.iter().enumerate() {
            let mut rows: Vec<&RayRow> = detector.rows.iter().collect();
            rows.sort_by_key(|row| row.order(splits));
            rows.into_iter().try_for_each(|row| recording.ray(index, *row))?;
        }
        let mut events: Vec<&PathEvent> = tally.paths.iter().collect();
        events.sort_by_key(|event| (event.ray.order(splits), event.kind.rank()));
        events.into_iter().try_for_each(|event| recording.event(event))?;
        Ok(recording.finish())
    }
}

impl RayRow {
    /// What rows are ordered by: launched ray, number within its family, event.
    pub(crate) fn order(&self, splits: bool) -> ((u64, u64), u32) {
        (ray_id::order(self.ray_id, splits), self.bounce)
    }
}

fn words_of(event: &PathEvent) -> [u64; WORDS] {
    let RayRow { ray_id, bounce, wavelength, position: [x, y, z], direction: [l, m, n], weight } = event.ray;
    let [x, y, z, l, m, n, weight] = [x, y, z, l, m, n, weight].map(f64::to_bits);
    [ray_id, u64::from(bounce) | u64::from(wavelength) << 32, x, y, z, l, m, n, weight, kind_word(event.kind)]
}

fn event_of(words: [u64; WORDS]) -> PathEvent {
    let reals = |first: usize| [0, 1, 2].map(|axis| f64::from_bits(words[first + axis]));
    PathEvent {
        ray: RayRow {
            ray_id: words[RAY_ID],
            bounce: bounce_of(words[BOUNCE_AND_WAVELENGTH]),
            wavelength: wavelength_of(words[BOUNCE_AND_WAVELENGTH]) as u32,
            position: reals(POSITION),
            direction: reals(DIRECTION),
            weight: f64::from_bits(words[WEIGHT]),
        },
        kind: kind_of(words[KIND]),
    }
}

/// The number of events that a row's word holds.
pub(crate) fn bounce_of(word: u64) -> u32 {
    word as u32
}

/// The index of the wavelength that a row's word holds.
pub(crate) fn wavelength_of(word: u64) -> usize {
    (word >> 32) as usize
}

/// What happened, of a row's word.
pub(crate) fn kind_of(word: u64) -> PathEventKind {
    let index = (word >> 8) as usize;
    match word & 0xff {
        0 => PathEventKind::Birth(index),
        1 => PathEventKind::Surface(index),
        2 => PathEventKind::Detector(index),
        3 => PathEventKind::Escaped,
        4 => PathEventKind::DepthKilled,
        _ => PathEventKind::FluxKilled,
    }
}

fn kind_word(kind: PathEventKind) -> u64 {
    let (kind, index) = match kind {
        PathEventKind::Birth(index) => (0, index),
        PathEventKind::Surface(index) => (1, index),
        PathEventKind::Detector(index) => (2, index),
        PathEventKind::Escaped => (3, 0),
        PathEventKind::DepthKilled => (4, 0),
        PathEventKind::FluxKilled => (5, 0),
    };
    (index as u64) << 8 | kind
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail")]

    use super::*;

    fn row(ray_id: u64) -> PathEvent {
        let kinds = [
            PathEventKind::Birth(3),
            PathEventKind::Surface(70_000),
            PathEventKind::Detector(2),
            PathEventKind::Escaped,
            PathEventKind::DepthKilled,
            PathEventKind::FluxKilled,
        ];
        let x = ray_id as f64;
        let ray = RayRow {
            ray_id: ray_id << 40 | ray_id,
            bounce: ray_id as u32 % 7,
            wavelength: u32::MAX - ray_id as u32,
            position: [x, -x, 1e-300],
            direction: [0.0, -0.0, x / 3.0],
            weight: 0.1 * x,
        };
        PathEvent { ray, kind: kinds[ray_id as usize % 6] }
    }

    fn filled(mut rows: RowWriter, count: u64) -> Arc<Rows> {
        (0..count).try_for_each(|ray_id| rows.push(&row(ray_id))).unwrap();
        rows.finish()
    }

    #[test]
    fn every_bit_comes_back_from_memory_and_from_files() {
        let folder = tempfile::tempdir().unwrap();
        for count in [0, 1, BLOCK_ROWS - 1, BLOCK_ROWS, BLOCK_ROWS + 1, 3 * BLOCK_ROWS + 5] {
            let count = count as u64;
            let expected: Vec<PathEvent> = (0..count).map(row).collect();
            for rows in [RowWriter::in_memory(None), RowWriter::in_folder(folder.path(), None)] {
                let rows = filled(rows, count);
                assert_eq!((rows.len(), rows.num_recorded()), (count, count));
                assert!(rows.to_vec().unwrap() == expected, "{count} rows");
            }
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "the files have no names");
    }

    #[test]
    fn the_last_rows_are_kept() {
        let folder = tempfile::tempdir().unwrap();
        let block = BLOCK_ROWS as u64;
        for keep in [0, 1, 5, block - 1, block, block + 1, 2 * block + 3] {
            for count in [0, 1, keep, keep + 1, block, block + 7, 4 * block, 5 * block + 11] {
                let expected: Vec<PathEvent> = (count.saturating_sub(keep)..count).map(row).collect();
                for rows in
                    [RowWriter::in_memory(Some(keep)), RowWriter::in_folder(folder.path(), Some(keep))]
                {
                    let rows = filled(rows, count);
                    assert_eq!(rows.num_recorded(), count);
                    assert!(rows.to_vec().unwrap() == expected, "the last {keep} of {count} rows");
                }
            }
        }
    }

    #[test]
    fn a_cap_bounds_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let rows = filled(RowWriter::in_folder(folder.path(), Some(100)), 9 * BLOCK_ROWS as u64);
        let Store::File { file, .. } = &rows.store else { unreachable!() };
        let length = with_file(file, |file| file.as_ref().unwrap().metadata()).unwrap().len();
        assert_eq!(length, BLOCK_BYTES as u64);
    }

    #[test]
    fn counted_rows_cannot_be_read() {
        let rows = filled(RowWriter::nowhere(), 2 * BLOCK_ROWS as u64);
        assert_eq!(rows.len(), 2 * BLOCK_ROWS as u64);
        assert!(matches!(rows.to_vec(), Err(Error::Usage(_))));
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn a_full_disk_is_named() {
        let full = File::options().write(true).open("/dev/full").unwrap();
        let mut rows = RowWriter::in_file(full, Path::new("/results"));
        let error = (0..).find_map(|ray_id| rows.push(&row(ray_id)).err()).unwrap();
        assert_eq!(
            error.to_string(),
            format!(
                "/results: No space left on device (os error 28), with {BLOCK_ROWS} recorded rows of 80 bytes to keep here"
            )
        );
    }
}
