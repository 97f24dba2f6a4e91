//! What a way of tracing adds to the plain module: files, constants, entry points.
//!
//! The plain module is complete without it, and traces every scene. An extension may put a file of its own in the place of
//! a slot's ([`crate::program::wgsl::variants`]), and may add entry points beside the plain ones. It never changes a result.

use crate::error::Result;
use crate::program::wgsl::compose::Composition;
use crate::program::wgsl::text::{ShaderFile, Text};

/// What is added to the plain module of a scene. Each method says what the plain module has unless an extension overrides it.
pub trait Extension: std::fmt::Debug {
    /// The file that takes the place of a slot's own; the slot is named by its stem, such as `sums/ends`.
    fn replaces(&self, slot: &str) -> Option<ShaderFile> {
        let _ = slot;
        None
    }

    /// Adds constants, files and entry points, with the comments that name them.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] if the precision cannot hold a number.
    fn add(&self, composition: &Composition, text: &mut Text) -> Result<()> {
        let _ = (composition, text);
        Ok(())
    }

    /// What rays leave on detectors in passing is logged, and not added up by the device.
    fn logs_passes(&self) -> bool {
        false
    }

    /// The entry points take back what a ray has put into the bins since its birth (`keep_bins`, `restore_bins`).
    fn restores_bins(&self) -> bool {
        false
    }

    /// The bin of this mirror is kept in registers even where the scene lies in tables.
    fn keeps_bin_of(&self, primitive: usize) -> bool {
        let _ = primitive;
        false
    }
}

/// The plain module.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoExtension;

impl Extension for NoExtension {}
