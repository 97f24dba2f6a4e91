//! How files are put in their places: whole or not at all, beside other runs that write there, and never through a link that
//! somebody has planted.
//!
//! What is written lies first in a hidden entry on the file system of its place: `.nsq-gpu-` and six random letters, made anew
//! for this user alone. Whoever writes holds its lock. One that nobody holds is left of a run that was killed, and the next
//! run there takes it away.

use std::ffi::OsStr;
use std::fs::{self, File, Metadata};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};
use tempfile::TempDir;

/// What the names of hidden entries begin with.
const PREFIX: &str = ".nsq-gpu-";
/// Random letters after it.
const NUM_LETTERS: usize = 6;
/// A run holds a folder's lock for a moment only. Whoever holds it longer means something else by it.
const LONGEST_WAIT: Duration = Duration::from_secs(30);

const STAGED: &str = "new";
const RETIRED: &str = "old";
const JOURNAL: &str = "journal.json";

/// The right to change what a folder holds, among runs of this program. Where there are no locks, nothing is held.
pub(crate) struct Lock(Option<File>);

impl Lock {
    /// Waits for the lock of a folder.
    pub(crate) fn of(folder: &Path) -> Lock {
        let start = Instant::now();
        let Ok(file) = File::open(folder) else { return Lock(None) };
        loop {
            match file.try_lock() {
                Ok(()) => return Lock(Some(file)),
                Err(fs::TryLockError::WouldBlock) if start.elapsed() < LONGEST_WAIT => {
                    std::thread::sleep(Duration::from_millis(5));
                }
                Err(_) => return Lock(None),
            }
        }
    }
}

/// A hidden folder in which files are made that then move to their place. It goes with the value.
pub(crate) struct Scratch {
    folder: TempDir,
    /// Held as long as the run lives.
    _lock: Option<File>,
}

/// What a run is about to do to a folder that exists, for the run that finds it undone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Journal {
    /// The folder.
    pub(crate) target: PathBuf,
    /// Where the new files lie within [`Scratch::staged`].
    pub(crate) staged: PathBuf,
    /// Names of the new files, the one last that makes them a result.
    pub(crate) names: Vec<String>,
    /// Names of the old files, which go.
    pub(crate) retired: Vec<String>,
    /// The files change places one by one.
    pub(crate) in_place: bool,
}

impl Scratch {
    /// A new one in `place`, from where those of killed runs are taken away; `guard` is the folder whose lock runs hold that
    /// change what lies there.
    pub(crate) fn new_in(place: &Path, guard: &Path) -> io::Result<Scratch> {
        let lock = Lock::of(guard);
        step();
        let folder = tempfile::Builder::new().prefix(PREFIX).rand_bytes(NUM_LETTERS).tempdir_in(place);
        let folder = folder.map_err(own_word)?;
        let own_lock = File::open(folder.path()).ok().filter(|file| file.try_lock().is_ok());
        if lock.0.is_some() {
            let ours = folder.path().symlink_metadata()?;
            [place, guard]
                .iter()
                .take(if place == guard { 1 } else { 2 })
                .for_each(|place| sweep(place, &ours));
        }
        Ok(Scratch { folder, _lock: own_lock })
    }

    /// Where new files are made.
    pub(crate) fn staged(&self) -> PathBuf {
        self.folder.path().join(STAGED)
    }

    /// Writes down what is about to be done.
    pub(crate) fn note(&self, journal: &Journal) -> io::Result<()> {
        step();
        let path = self.folder.path().join(JOURNAL);
        fs::write(&path, serde_json::to_vec(journal).map_err(io::Error::other)?)?;
        File::open(path)?.sync_all()
    }

    /// Moves the staged files to the target one by one, after the old ones have gone; all is undone if something fails.
    ///
    /// # Errors
    /// The place that could not be changed, and why.
    pub(crate) fn move_in(&self, journal: &Journal) -> Result<(), (PathBuf, io::Error)> {
        let (staged, old) = (self.staged().join(&journal.staged), self.folder.path().join(RETIRED));
        let moved = fs::create_dir(&old).map_err(|error| (journal.target.clone(), error)).and_then(|()| {
            // The last name first, and last again: whoever finds it finds the files that belong to it.
            let going = journal.names.iter().rev().chain(&journal.retired);
            going.filter(|name| exists(&journal.target.join(name))).try_for_each(|name| {
                step();
                let from = journal.target.join(name);
                fs::rename(&from, old.join(name)).map_err(|error| (from, error))
            })?;
            journal.names.iter().try_for_each(|name| {
                step();
                let to = journal.target.join(name);
                fs::rename(staged.join(name), &to).map_err(|error| (to, error))
            })
        });
        if moved.is_err() {
            journal.roll_back(self.folder.path());
        }
        moved
    }
}

impl Journal {
    /// Undoes what [`Scratch::move_in`] has done, as far as it went. It may be interrupted and begun again: nothing is deleted.
    fn roll_back(&self, scratch: &Path) {
        let (staged, old) = (scratch.join(STAGED).join(&self.staged), scratch.join(RETIRED));
        // What cannot be moved back has no better place to go.
        for name in self.names.iter().filter(|name| !exists(&staged.join(name))) {
            step();
            let _ = fs::rename(self.target.join(name), staged.join(name));
        }
        for name in self.names.iter().chain(&self.retired).filter(|name| exists(&old.join(name))) {
            step();
            let _ = fs::rename(old.join(name), self.target.join(name));
        }
    }

    /// Brings back to the target what somebody else put into a folder that was exchanged for another.
    pub(crate) fn rescue(&self, folder: &Path) {
        let is_known = |name: &OsStr| {
            let is = |known: &String| name == known.as_str();
            self.names.iter().any(is) || self.retired.iter().any(is)
        };
        let entries = fs::read_dir(folder).into_iter().flatten().flatten();
        for entry in entries.filter(|entry| !is_known(&entry.file_name())) {
            let (found, place) = (entry.path(), self.target.join(entry.file_name()));
            if !is_same(&found, &place) {
                step();
                let _ = rename_to_new(&found, &place);
            }
        }
    }
}

/// Takes away what killed runs of this user have left in `place`.
fn sweep(place: &Path, ours: &Metadata) {
    for entry in fs::read_dir(place).into_iter().flatten().flatten() {
        let path = entry.path();
        let Ok(metadata) = entry.metadata() else { continue };
        let is_left = is_hidden_name(&entry.file_name())
            && (metadata.is_dir() || metadata.is_file())
            && has_same_owner(&metadata, ours)
            && File::open(&path).is_ok_and(|file| file.try_lock().is_ok());
        if !is_left {
            continue;
        }
        step();
        if metadata.is_file() {
            let _ = fs::remove_file(&path);
        } else {
            recover(&path);
            let _ = fs::remove_dir_all(&path);
        }
    }
}

/// Ends what a killed run has begun: all of it is undone, unless only the old files were still to go.
fn recover(scratch: &Path) {
    let journal = fs::read(scratch.join(JOURNAL)).ok();
    let journal = journal.and_then(|bytes| serde_json::from_slice::<Journal>(&bytes).ok());
    let Some(journal) = journal else { return };
    let staged = scratch.join(STAGED).join(&journal.staged);
    if !journal.in_place {
        journal.rescue(&staged);
    } else if journal.names.last().is_some_and(|last| exists(&staged.join(last))) {
        journal.roll_back(scratch);
    }
}

fn is_hidden_name(name: &OsStr) -> bool {
    let letters = name.to_str().and_then(|name| name.strip_prefix(PREFIX));
    letters.is_some_and(|letters| letters.len() == NUM_LETTERS && letters.chars().all(char::is_alphanumeric))
}

/// Puts two folders in each other's place, in one step.
///
/// # Errors
/// That of the system, which may not be able to.
pub(crate) fn exchange(a: &Path, b: &Path) -> io::Result<()> {
    step();
    #[cfg(any(target_os = "linux", target_os = "android", target_vendor = "apple"))]
    {
        use rustix::fs::{CWD, RenameFlags, renameat_with};
        Ok(renameat_with(CWD, a, CWD, b, RenameFlags::EXCHANGE)?)
    }
    #[cfg(not(any(target_os = "linux", target_os = "android", target_vendor = "apple")))]
    {
        let _ = (a, b);
        Err(io::ErrorKind::Unsupported.into())
    }
}

/// Renames to a name that nothing has.
///
/// # Errors
/// [`io::ErrorKind::AlreadyExists`] if something has it.
pub(crate) fn rename_to_new(from: &Path, to: &Path) -> io::Result<()> {
    step();
    #[cfg(any(target_os = "linux", target_os = "android", target_vendor = "apple"))]
    {
        use rustix::fs::{CWD, RenameFlags, renameat_with};
        use rustix::io::Errno;
        match renameat_with(CWD, from, CWD, to, RenameFlags::NOREPLACE) {
            // Not every file system can.
            Err(Errno::INVAL | Errno::NOSYS | Errno::NOTSUP) => {}
            done => return Ok(done?),
        }
    }
    if exists(to) { Err(io::ErrorKind::AlreadyExists.into()) } else { fs::rename(from, to) }
}

/// True if there is anything of this name, be it a link that leads nowhere.
pub(crate) fn exists(path: &Path) -> bool {
    path.symlink_metadata().is_ok()
}

/// Writes a file in one step: the one that is there stays whole until then.
///
/// # Errors
/// That of the system.
pub(crate) fn replace_file(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let folder = folder_of(path);
    let mut file = hidden_file(folder)?;
    step();
    file.write_all(bytes)?;
    file.as_file().sync_all()?;
    step();
    file.persist(path).map_err(|error| error.error)?;
    sync_folder(folder);
    Ok(())
}

/// Finds out whether files can be made beside `path`, and takes away what killed runs have left there.
///
/// # Errors
/// That of the system.
pub(crate) fn check_folder_of(path: &Path) -> io::Result<()> {
    let folder = folder_of(path);
    let file = hidden_file(folder)?;
    let lock = Lock::of(folder);
    if lock.0.is_some() {
        sweep(folder, &file.as_file().metadata()?);
    }
    Ok(())
}

fn hidden_file(folder: &Path) -> io::Result<tempfile::NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(PREFIX).rand_bytes(NUM_LETTERS);
    // Whoever may read other new files of the user may read this one, too.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let _lock = Lock::of(folder);
    step();
    let file = builder.tempfile_in(folder).map_err(own_word)?;
    let _ = file.as_file().try_lock();
    Ok(file)
}

/// What the operating system says, without the hidden path that `tempfile` adds.
pub(crate) fn own_word(error: io::Error) -> io::Error {
    let text = error.to_string();
    match text.split_once(" at path ") {
        Some((word, _)) => io::Error::new(error.kind(), word),
        None => error,
    }
}

fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Makes renames durable where folders can be synced; elsewhere the file system does what it does.
pub(crate) fn sync_folder(folder: &Path) {
    let _ = File::open(folder).and_then(|folder| folder.sync_all());
}

#[cfg(unix)]
fn has_same_owner(a: &Metadata, b: &Metadata) -> bool {
    use std::os::unix::fs::MetadataExt;
    a.uid() == b.uid()
}

#[cfg(not(unix))]
fn has_same_owner(_: &Metadata, _: &Metadata) -> bool {
    true
}

/// True if both are names of one file.
#[cfg(unix)]
fn is_same(a: &Path, b: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let identity = |path: &Path| path.symlink_metadata().ok().map(|found| (found.dev(), found.ino()));
    identity(a).is_some_and(|a| Some(a) == identity(b))
}

#[cfg(not(unix))]
fn is_same(_: &Path, _: &Path) -> bool {
    false
}

/// Called before each change of the file system. In builds for development the process ends at the one whose number stands in
/// the variable: for tests of what a killed run leaves.
pub(crate) fn step() {
    #[cfg(debug_assertions)]
    {
        use std::sync::atomic::{AtomicU64, Ordering};
        static STEPS: AtomicU64 = AtomicU64::new(0);
        let number = STEPS.fetch_add(1, Ordering::Relaxed);
        let last = std::env::var("NSQ_GPU_TEST_KILL_AT").ok().and_then(|text| text.parse().ok());
        if last == Some(number) {
            #[cfg(unix)]
            let _ = nix::sys::signal::raise(nix::sys::signal::Signal::SIGKILL);
            std::process::abort();
        }
    }
}
