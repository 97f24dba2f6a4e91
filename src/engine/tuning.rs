//! How work is cut for an adapter. `nsq-bench --tune` measures what suits the adapter, and keeps it in the user's
//! cache. No tuning changes a result.

use crate::error::{Error, Result};
use crate::folders::Folder;
use crate::gpu::AdapterInfo;
use crate::gpu::adapter_name::without_width;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// How work is cut for an adapter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Tuning {
    /// Invocations a workgroup.
    pub workgroup_size: u32,
    /// Events that a ray goes through in registers before the survivors are compacted.
    pub events_per_dispatch: u32,
}

impl Default for Tuning {
    fn default() -> Self {
        Tuning { workgroup_size: 64, events_per_dispatch: 16 }
    }
}

/// The choices that are measured; every adapter that computes can do them.
pub const WORKGROUP_SIZES: [u32; 3] = [32, 64, 128];
/// See [`WORKGROUP_SIZES`].
pub const EVENTS_PER_DISPATCH: [u32; 3] = [4, 16, 64];

/// The tuning measured for one adapter with one driver.
#[derive(Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Found {
    adapter: String,
    driver: String,
    tuning: Tuning,
}

impl Tuning {
    /// The tuning of an adapter that was not measured. Lavapipe allocates memory for each workgroup, so processors do
    /// better with fewer workgroups. Lavapipe also writes survivors lane by lane, so processors do better with more
    /// events a dispatch.
    pub fn untuned(adapter: &AdapterInfo) -> Self {
        if adapter.class.emulates_lanes() {
            Tuning { workgroup_size: 128, events_per_dispatch: 64 }
        } else {
            Self::default()
        }
    }

    /// The tuning measured for an adapter. If none was measured, or the file cannot be read: [`Tuning::untuned`].
    pub fn of(adapter: &AdapterInfo) -> Self {
        let found = known().into_iter().find(|found| found.is_of(adapter)).map(|found| found.tuning);
        // The user may have edited the file.
        let is_offered = |tuning: &Tuning| {
            WORKGROUP_SIZES.contains(&tuning.workgroup_size)
                && EVENTS_PER_DISPATCH.contains(&tuning.events_per_dispatch)
        };
        found.filter(is_offered).unwrap_or_else(|| Self::untuned(adapter))
    }

    /// Keeps the tuning for an adapter, and returns the path of the file.
    ///
    /// # Errors
    /// [`Error::File`] if the file cannot be written; [`Error::Usage`] if the user has no folder for caches.
    pub fn keep(self, adapter: &AdapterInfo) -> Result<PathBuf> {
        let path = path().ok_or_else(|| {
            Error::Usage("there is no folder for caches: set XDG_CACHE_HOME or HOME".to_string())
        })?;
        let mut found: Vec<Found> = known().into_iter().filter(|found| !found.is_of(adapter)).collect();
        let (name, driver) = (adapter.name.clone(), adapter.driver.clone());
        found.push(Found { adapter: name, driver, tuning: self });
        let text = serde_json::to_string_pretty(&found).map_err(|e| Error::Internal(e.to_string()))?;
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(|error| Error::file(folder, error))?;
        }
        std::fs::write(&path, text).map_err(|error| Error::file(&path, error))?;
        Ok(path)
    }
}

impl Found {
    fn is_of(&self, adapter: &AdapterInfo) -> bool {
        without_width(&self.adapter) == adapter.name && self.driver == adapter.driver
    }
}

fn known() -> Vec<Found> {
    let text = path().and_then(|path| std::fs::read_to_string(path).ok());
    text.and_then(|text| serde_json::from_str(&text).ok()).unwrap_or_default()
}

fn path() -> Option<PathBuf> {
    Folder::Cache.path().map(|folder| folder.join("tuning.json"))
}
