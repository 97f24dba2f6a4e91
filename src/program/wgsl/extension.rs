//! What a strategy adds to the plain module: files, constants, entry points.
//!
//! The plain module is complete without an extension, and traces every scene. An extension may replace the file of a
//! slot ([`crate::program::wgsl::variants`]), and may add entry points beside the plain ones. An extension does not
//! change a result.

use crate::error::Result;
use crate::program::prepared::Prepared;
use crate::program::wgsl::composition::Composition;
use crate::program::wgsl::text::Text;
use crate::shaders::ShaderFile;
use std::any::Any;
use std::fmt::Debug;
use std::sync::Arc;

/// The additions to the plain module of a scene. A method that is not overridden leaves the plain module as it is.
pub trait Extension: Debug + Any + Send + Sync {
    /// The file that replaces a slot's own. The slot is named by its stem, such as `sums/ends`.
    fn replaces(&self, slot: &str) -> Option<ShaderFile> {
        let _ = slot;
        None
    }

    /// Adds constants, files and entry points, with comments that name their origin.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] if the precision cannot hold a number.
    fn add(&self, composition: &Composition, text: &mut Text) -> Result<()> {
        let _ = (composition, text);
        Ok(())
    }

    /// The file that rejects rays on wrong sides, for stages that may reject rays (program::wgsl::wrong_sides).
    fn rejects_wrong_sides(&self) -> Option<ShaderFile> {
        None
    }

    /// True if deposits on detectors in passing are logged, and not added up by the device.
    fn logs_passes(&self) -> bool {
        false
    }

    /// True if the entry points take back what a ray has put into the bins since its birth (`keep_bins`,
    /// `restore_bins`).
    fn restores_bins(&self) -> bool {
        false
    }

    /// True if the bin of this mirror is kept in registers even where the scene lies in tables.
    fn keeps_bin_of(&self, primitive: usize) -> bool {
        let _ = primitive;
        false
    }
}

/// Makes the extension of a scene.
pub trait Extend {
    /// The extension for this scene.
    fn extension(&self, scene: &Prepared) -> Arc<dyn Extension>;
}

/// The plain module.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoExtension;

impl Extension for NoExtension {}

impl Extend for NoExtension {
    fn extension(&self, _scene: &Prepared) -> Arc<dyn Extension> {
        Arc::new(NoExtension)
    }
}
