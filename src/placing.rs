//! How files are put in their places: whole or not at all, and safely beside other runs that write there. No file is
//! put through a link that somebody has planted.
//!
//! New content is first written to a hidden entry on the file system of its place. The name of the entry is `.nsq-gpu-`
//! and six random letters. The entry is made anew for this user alone, and its writer holds its lock. A hidden entry
//! that nobody locks is the remainder of a run that was killed. The next run in that place removes it.

use std::ffi::OsStr;
use std::fs::{self, File, Metadata};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};
use tempfile::TempDir;

/// How the names of hidden entries begin.
const PREFIX: &str = ".nsq-gpu-";
/// The number of random letters after [`PREFIX`].
const NUM_LETTERS: usize = 6;
/// The longest wait for a folder's lock. A run holds such a lock for a moment only. Whoever holds it longer locks the
/// folder for another purpose.
const LONGEST_WAIT: Duration = Duration::from_secs(30);

const STAGED: &str = "new";
const RETIRED: &str = "old";
const JOURNAL: &str = "journal.json";

/// The right to change what a folder holds, among runs of this program. Where the system has no locks, nothing is held.
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

/// A hidden folder in which files are made before they move to their place. The folder is removed with the value.
pub(crate) struct Scratch {
    folder: TempDir,
    /// Held as long as the run lives.
    _lock: Option<File>,
}

/// What a run is about to do to an existing folder. If the run is killed, the next run reads this and cleans up.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Journal {
    /// The folder.
    pub(crate) target: PathBuf,
    /// Where the new files lie within [`Scratch::staged`].
    pub(crate) staged: PathBuf,
    /// Names of the new files. The last is the file that makes the folder a result.
    pub(crate) names: Vec<String>,
    /// Names of the old files, which are removed.
    pub(crate) retired: Vec<String>,
    /// True if files are replaced one by one; false if the whole folder is exchanged.
    pub(crate) in_place: bool,
}

impl Scratch {
    /// A new hidden folder in `place`, from which the hidden folders of killed runs are removed. Runs that change what
    /// lies in `place` hold the lock of the folder `guard`.
    pub(crate) fn new_in(place: &Path, guard: &Path) -> io::Result<Scratch> {
        let lock = Lock::of(guard);
        step();
        let mut builder = tempfile::Builder::new();
        builder.prefix(PREFIX).rand_bytes(NUM_LETTERS);
        // The folder may stand beside one that nobody else may read.
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o700));
        let folder = builder.tempdir_in(place).map_err(own_word)?;
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

    /// The folder in which new files are made.
    pub(crate) fn staged(&self) -> PathBuf {
        self.folder.path().join(STAGED)
    }

    /// Writes the journal of what is about to be done.
    pub(crate) fn note(&self, journal: &Journal) -> io::Result<()> {
        step();
        let path = self.folder.path().join(JOURNAL);
        fs::write(&path, serde_json::to_vec(journal).map_err(io::Error::other)?)?;
        File::open(path)?.sync_all()
    }

    /// Moves the old files away, then the staged files to the target, one by one. If something fails, all is undone.
    ///
    /// # Errors
    /// The place that could not be changed, and why.
    pub(crate) fn move_in(&self, journal: &Journal) -> Result<(), (PathBuf, io::Error)> {
        let (staged, old) = (self.staged().join(&journal.staged), self.folder.path().join(RETIRED));
        let moved = fs::create_dir(&old).map_err(|error| (journal.target.clone(), error)).and_then(|()| {
            // The file with the last name goes first and comes last: whoever finds it finds the files that belong to
            // it.
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
    /// Undoes what [`Scratch::move_in`] has done, as far as it went. Nothing is deleted, so the undoing may be
    /// interrupted and begun again.
    fn roll_back(&self, scratch: &Path) {
        let (staged, old) = (scratch.join(STAGED).join(&self.staged), scratch.join(RETIRED));
        // A file that cannot be moved back stays: there is no better place for it.
        for name in self.names.iter().filter(|name| !exists(&staged.join(name))) {
            step();
            let _ = fs::rename(self.target.join(name), staged.join(name));
        }
        for name in self.names.iter().chain(&self.retired).filter(|name| exists(&old.join(name))) {
            step();
            let _ = fs::rename(old.join(name), self.target.join(name));
        }
    }

    /// Brings back to the target the files that somebody else put into the old folder, after it was exchanged.
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

/// Removes what killed runs of this user have left in `place`.
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

/// Cleans up after a killed run. Everything is undone, unless only the old files were still to be removed.
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

/// Exchanges two folders in one step.
///
/// # Errors
/// The system's error; not every system can do this.
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

/// Renames to a name that is not in use.
///
/// # Errors
/// [`io::ErrorKind::AlreadyExists`] if the name is in use.
pub(crate) fn rename_to_new(from: &Path, to: &Path) -> io::Result<()> {
    step();
    #[cfg(any(target_os = "linux", target_os = "android", target_vendor = "apple"))]
    {
        use rustix::fs::{CWD, RenameFlags, renameat_with};
        use rustix::io::Errno;
        match renameat_with(CWD, from, CWD, to, RenameFlags::NOREPLACE) {
            // Some file systems cannot do this.
            Err(Errno::INVAL | Errno::NOSYS | Errno::NOTSUP) => {}
            done => return Ok(done?),
        }
    }
    if exists(to) { Err(io::ErrorKind::AlreadyExists.into()) } else { fs::rename(from, to) }
}

/// True if something has this name, even a link that leads nowhere.
pub(crate) fn exists(path: &Path) -> bool {
    path.symlink_metadata().is_ok()
}

/// Writes a file in one step: an existing file stays whole until then. The new file has the permissions of the old one.
///
/// # Errors
/// The system's error.
pub(crate) fn replace_file(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let file = filled_file(path, bytes)?;
    if let Ok(old) = path.symlink_metadata() {
        file.as_file().set_permissions(old.permissions())?;
    }
    step();
    file.persist(path).map_err(|error| error.error)?;
    sync_folder(folder_of(path));
    Ok(())
}

/// Writes a new file in one step. Whatever has its name already stays.
///
/// # Errors
/// The system's error; [`io::ErrorKind::AlreadyExists`] if the name is in use.
pub(crate) fn new_file(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let file = filled_file(path, bytes)?;
    step();
    file.persist_noclobber(path).map_err(|error| own_word(error.error))?;
    sync_folder(folder_of(path));
    Ok(())
}

/// A hidden file beside `path`, with these contents.
fn filled_file(path: &Path, bytes: &[u8]) -> io::Result<tempfile::NamedTempFile> {
    let mut file = hidden_file(folder_of(path))?;
    step();
    file.write_all(bytes)?;
    file.as_file().sync_all()?;
    Ok(file)
}

/// Checks that files can be made beside `path`, and removes what killed runs have left there.
///
/// # Errors
/// The system's error.
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
    // The file gets the same permissions as any other new file of the user.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let _lock = Lock::of(folder);
    step();
    let file = builder.tempfile_in(folder).map_err(own_word)?;
    let _ = file.as_file().try_lock();
    Ok(file)
}

/// The operating system's error, without the hidden path that `tempfile` adds.
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

/// Makes renames durable, where folders can be synced.
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

/// Called before each change of the file system. Tests of killed runs set an environment variable to a number: in debug
/// builds, the process then ends at the change with that number.
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
