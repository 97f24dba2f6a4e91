//! One file that a command was asked to write, such as the points of a sweep.
//!
//! The place is looked at before the first ray. A file that is there is replaced only where the user said so; a scene and
//! the files that the scene names are never replaced. The file appears whole or not at all.

use crate::error::{Error, Result};
use crate::placing;
use serde_json::Value;
use std::io;
use std::path::{Path, PathBuf};

/// Looks at the places of some files in one folder, which may not exist yet.
///
/// # Errors
/// [`Error::File`] with the place, if nothing can be written there, or a file would be lost.
pub fn check_places(folder: &Path, names: &[&str], overwrite: bool) -> Result<()> {
    crate::result::output::check_writable(folder)?;
    let mut there = names.iter().map(|name| folder.join(name)).filter(|path| placing::exists(path));
    there.try_for_each(|path| OutputFile::new(&path, overwrite, Path::new(""), |_| false).map(drop))
}

/// A place where a file may be written.
#[derive(Debug)]
pub(crate) struct OutputFile {
    path: PathBuf,
    may_replace: bool,
}

impl OutputFile {
    /// Looks at the place of a file. `scene` is the scene file that the command reads. `is_own` is true of a file as this
    /// program wrote it. Such a file may be replaced, and so may an empty one: `mktemp` makes one, and nothing is lost.
    ///
    /// # Errors
    /// [`Error::File`] with the place, if nothing can be written there, or something would be lost.
    pub(crate) fn new(
        path: &Path,
        overwrite: bool,
        scene: &Path,
        is_own: impl FnOnce(&Path) -> bool,
    ) -> Result<Self> {
        let refused = |problem: &str| Err(Error::file(path, problem));
        let found = match path.symlink_metadata() {
            Ok(found) => Some(found),
            Err(error) if error.kind() == io::ErrorKind::NotFound => None,
            Err(error) => return Err(Error::file(path, error)),
        };
        let is_file = found.as_ref().is_some_and(|found| found.is_file());
        let is_empty = found.as_ref().is_some_and(|found| found.len() == 0);
        let may_replace = is_file && (overwrite || is_empty || is_own(path));
        match &found {
            None if path.file_name().is_none() => return refused("is no name of a file; give one"),
            None => {}
            Some(found) if found.is_dir() => return refused("is a folder; give the name of a file"),
            Some(found) if found.is_symlink() => {
                return refused("is a link, and links are not written through; give another name");
            }
            Some(found) if !found.is_file() => return refused("is a pipe or a device; give another name"),
            Some(_) if is_input(path, scene) => {
                return refused("is read by this command, and would be lost; give another name");
            }
            Some(_) if !may_replace => {
                return refused("exists; --overwrite replaces it, or give another name");
            }
            Some(_) => {}
        }
        placing::check_folder_of(path).map_err(|error| Error::file(path, error))?;
        Ok(OutputFile { path: path.into(), may_replace })
    }

    /// Writes the file.
    ///
    /// # Errors
    /// [`Error::File`] if the file cannot be written, or somebody else made one of its name meanwhile; that one then stays.
    pub(crate) fn write(&self, bytes: &[u8]) -> Result<&Path> {
        let written = match self.may_replace {
            true => placing::replace_file(&self.path, bytes),
            false => placing::new_file(&self.path, bytes),
        };
        written.map_err(|error| Error::file(&self.path, error))?;
        Ok(&self.path)
    }
}

/// True if a file is the scene, or one that the scene names.
fn is_input(path: &Path, scene: &Path) -> bool {
    let Ok(real) = path.canonicalize() else { return false };
    let is_this = |other: &Path| other.canonicalize().is_ok_and(|other| other == real);
    let folder = scene.parent().unwrap_or(Path::new(""));
    // A stream can be read only once, and by the command.
    let text = if scene.is_file() { std::fs::read_to_string(scene).ok() } else { None };
    let document = text.and_then(|text| json5::from_str::<Value>(&text).ok());
    is_this(scene)
        || document.is_some_and(|document| texts(&document).any(|name| is_this(&folder.join(name))))
}

/// All texts of a document.
fn texts(document: &Value) -> Box<dyn Iterator<Item = &str> + '_> {
    match document {
        Value::String(text) => Box::new(std::iter::once(text.as_str())),
        Value::Array(items) => Box::new(items.iter().flat_map(texts)),
        Value::Object(items) => Box::new(items.values().flat_map(texts)),
        Value::Null | Value::Bool(_) | Value::Number(_) => Box::new(std::iter::empty()),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn nothing_that_could_be_lost_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::write(path("scene.json"), r#"{"a": [{"path": "part.stl"}]}"#).unwrap();
        for name in ["part.stl", "old.csv"] {
            fs::write(path(name), "made by a user").unwrap();
        }
        fs::write(path("empty.csv"), "").unwrap();
        fs::create_dir(path("folder")).unwrap();
        let open =
            |name: &str, overwrite| OutputFile::new(&path(name), overwrite, &path("scene.json"), |_| false);
        let always = ["scene.json", "part.stl", "folder", "missing/new.csv"];
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink(path("old.csv"), path("link")).unwrap();
            std::os::unix::fs::symlink(path("nowhere"), path("dangling")).unwrap();
            assert!(std::process::Command::new("mkfifo").arg(path("pipe")).status().unwrap().success());
            for name in ["link", "dangling", "pipe"] {
                assert!(open(name, true).is_err(), "{name}");
            }
        }
        always.iter().for_each(|name| assert!(open(name, true).is_err(), "{name}"));
        assert!(open("old.csv", false).unwrap_err().to_string().contains("--overwrite"));
        for (name, overwrite) in [("old.csv", true), ("empty.csv", false), ("new.csv", false)] {
            open(name, overwrite).unwrap().write(b"points").unwrap();
            assert_eq!(fs::read(path(name)).unwrap(), b"points");
        }
        let late = open("late.csv", false).unwrap();
        fs::write(path("late.csv"), "made meanwhile").unwrap();
        late.write(b"points").unwrap_err();
        assert_eq!(fs::read(path("late.csv")).unwrap(), b"made meanwhile");
        assert_eq!(fs::read(path("part.stl")).unwrap(), b"made by a user");
        let hidden = fs::read_dir(folder.path())
            .unwrap()
            .filter(|entry| entry.as_ref().unwrap().file_name().to_string_lossy().starts_with('.'));
        assert_eq!(hidden.count(), 0);
    }

    #[cfg(unix)]
    #[test]
    fn a_file_that_is_replaced_keeps_its_permissions() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("points.csv");
        fs::write(&path, "old").unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o600)).unwrap();
        OutputFile::new(&path, true, Path::new(""), |_| false).unwrap().write(b"new").unwrap();
        assert_eq!(path.metadata().unwrap().permissions().mode() & 0o777, 0o600);
    }
}
