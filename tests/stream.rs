//! Rows of databases and paths on disk: the same files as from memory, and a memory that does not grow with the rays.
#![allow(unsafe_code, reason = "an allocator that counts has no safe form")]
#![allow(clippy::unwrap_used, reason = "clippy's exemption of tests does not reach their helpers")]

mod zoo;

use std::alloc::{GlobalAlloc, Layout, System};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard};

use nsq_gpu::model::SceneIr;
use nsq_gpu::program::Precision;
use nsq_gpu::result::output::write_all;
use nsq_gpu::result::{DetectorData, Recording, RunInfo};
use nsq_gpu::run::RecordPaths;
use nsq_gpu::{TraceOptions, TraceResult};

/// Two databases, both hit, and more than one block of rows in each of them and in the paths.
const SCENE: &str = "cemented_achromat_auto";

/// Counts what the program has allocated; the device's driver allocates by other means.
struct Counting;

static LIVE: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

#[global_allocator]
static ALLOCATOR: Counting = Counting;

// SAFETY: every call goes to the system's allocator as it came.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let live = LIVE.fetch_add(layout.size(), Ordering::Relaxed) + layout.size();
        PEAK.fetch_max(live, Ordering::Relaxed);
        // SAFETY: the caller's promise about `layout` is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, place: *mut u8, layout: Layout) {
        LIVE.fetch_sub(layout.size(), Ordering::Relaxed);
        // SAFETY: `place` came from the call above with this layout.
        unsafe { System.dealloc(place, layout) }
    }
}

/// One test at a time, since all share the counts.
fn alone() -> MutexGuard<'static, ()> {
    static LOCK: Mutex<()> = Mutex::new(());
    LOCK.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
}

/// Largest number of bytes that were allocated at once while `act` ran, beyond those before it.
fn peak_of(act: impl FnOnce()) -> usize {
    let before = LIVE.load(Ordering::Relaxed);
    PEAK.store(before, Ordering::Relaxed);
    act();
    PEAK.load(Ordering::Relaxed) - before
}

fn options(num_rays: u64, batch_size: Option<u32>) -> TraceOptions {
    TraceOptions { paths: RecordPaths::All, batch_size, ..zoo::options(num_rays, 5, Precision::F64) }
}

/// A trace whose rows go to disk, or stay in the tally.
fn traced(ir: &SceneIr, options: &TraceOptions, folder: Option<&Path>) -> TraceResult {
    let mut tracer = zoo::tracer(ir, options).unwrap();
    if let Some(folder) = folder {
        tracer.record_to(|| Recording::in_folder(ir, folder));
    }
    let tally = tracer.trace(|_| true).unwrap();
    let run = RunInfo { num_rays: options.num_rays, seed: options.seed, ..RunInfo::default() };
    match tracer.take_recorded().unwrap() {
        Some(recorded) => TraceResult::with_rows(ir, &run, &tally, &recorded).unwrap(),
        None => TraceResult::new(ir, &run, &tally).unwrap(),
    }
}

/// Names and contents of all files of a result.
fn files(result: &TraceResult) -> Vec<(String, Vec<u8>)> {
    let folder = tempfile::tempdir().unwrap();
    let paths = write_all(folder.path(), result).unwrap();
    let name = |path: &Path| path.file_name().unwrap().to_str().unwrap().to_string();
    paths.iter().map(|path| (name(path), std::fs::read(path).unwrap())).collect()
}

#[test]
fn files_from_disk_are_those_from_memory() {
    let _alone = alone();
    let ir = zoo::load(SCENE);
    let folder = tempfile::tempdir().unwrap();
    let expected = files(&traced(&ir, &options(30_000, None), None));
    for batch_size in [None, Some(777), Some(8192)] {
        let result = traced(&ir, &options(30_000, batch_size), Some(folder.path()));
        let events = result.ray_paths.as_ref().unwrap().len();
        assert!(events > 100_000, "{events} events fill several blocks");
        let rows = result.detectors.iter().filter_map(|detector| match &detector.data {
            DetectorData::RayDatabase(rays) => Some(rays.num_rays()),
            _ => None,
        });
        assert!(rows.sum::<u64>() > 30_000);
        let written = files(&result);
        assert_eq!(written.len(), expected.len());
        for ((name, bytes), (expected_name, expected_bytes)) in written.iter().zip(&expected) {
            assert_eq!(name, expected_name);
            assert!(bytes == expected_bytes, "{name} with batches of {batch_size:?}");
        }
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "the rows' own files have no names");
}

#[test]
fn capped_databases_keep_the_same_rows_on_disk() {
    let _alone = alone();
    let mut ir = zoo::load(SCENE);
    for (detector, cap) in ir.detectors.iter_mut().zip([100, 20_000, 100, 20_000]) {
        if let nsq_gpu::model::DetectorKind::RayDatabase(nsq_gpu::model::RayDatabase { max_rays, .. }) =
            &mut detector.kind
        {
            *max_rays = Some(cap);
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let (ours, expected) = (
        traced(&ir, &options(50_000, Some(1000)), Some(folder.path())),
        traced(&ir, &options(50_000, None), None),
    );
    assert_eq!(ours, expected);
    let truncated = |result: &TraceResult| {
        let databases = result.detectors.iter().filter_map(|detector| match &detector.data {
            DetectorData::RayDatabase(rays) => Some(rays.truncated),
            _ => None,
        });
        databases.filter(|truncated| *truncated).count()
    };
    assert!(truncated(&ours) > 0);
}

/// Ten times the rows need no more memory; from memory they need ten times as much.
#[test]
fn memory_does_not_grow_with_the_rows() {
    const BOUND: usize = 4 << 20;
    let _alone = alone();
    let ir = zoo::load(SCENE);
    let folder = tempfile::tempdir().unwrap();
    let peak = |num_rays: u64, folder: Option<&Path>| {
        peak_of(|| {
            let result = traced(&ir, &options(num_rays, Some(2000)), folder);
            let events = result.ray_paths.as_ref().unwrap().len();
            assert!(events > 5 * num_rays, "{events} events");
            let out = tempfile::tempdir().unwrap();
            write_all(out.path(), &result).unwrap();
        })
    };
    // What is allocated once, such as fonts.
    peak(1000, None);
    let (few, many) = (peak(20_000, Some(folder.path())), peak(200_000, Some(folder.path())));
    assert!(many < few + BOUND, "1e5 rows: {few} bytes; 1e6 rows: {many} bytes");
    let in_memory = peak(200_000, None);
    assert!(in_memory > few + 20 * BOUND, "the measure sees rows in memory: {in_memory} bytes");
}

#[test]
fn an_interrupted_trace_keeps_its_rows() {
    let _alone = alone();
    let ir = zoo::load(SCENE);
    let folder = tempfile::tempdir().unwrap();
    let mut tracer = zoo::tracer(&ir, &options(40_000, Some(500))).unwrap();
    tracer.record_to(|| Recording::in_folder(&ir, folder.path()));
    let tally = tracer.trace(|done| done < 2000).unwrap();
    assert!(tally.launched.count < 40_000);
    let recorded = tracer.take_recorded().unwrap().unwrap();
    let births = recorded.paths.to_vec().unwrap();
    let births = births.iter().filter(|event| event.kind.event_type() == "birth").count();
    assert_eq!(births as u64, tally.launched.count);
}
