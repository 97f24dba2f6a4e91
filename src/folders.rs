//! The folders in which the operating system keeps a program's files for a user.

use std::path::PathBuf;

/// What the files are for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Folder {
    /// Data that can be computed again.
    Cache,
    /// The user's choices.
    Settings,
}

impl Folder {
    /// This program's folder; `None` where the user has no such folder. The folder need not exist yet.
    pub fn path(self) -> Option<PathBuf> {
        let variable =
            |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
        let (windows, macos, xdg, home) = match self {
            Folder::Cache => ("LOCALAPPDATA", "Library/Caches", "XDG_CACHE_HOME", ".cache"),
            Folder::Settings => ("APPDATA", "Library/Application Support", "XDG_CONFIG_HOME", ".config"),
        };
        let base = if cfg!(windows) {
            variable(windows)
        } else if cfg!(target_os = "macos") {
            variable("HOME").map(|folder| folder.join(macos))
        } else {
            variable(xdg).or_else(|| variable("HOME").map(|folder| folder.join(home)))
        };
        base.map(|base| base.join("nsq-gpu"))
    }
}
