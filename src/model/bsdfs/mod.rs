//! BSDFs, the laws by which surfaces scatter: the list of them, and what each must say of itself.
//!
//! Each BSDF stands in one file here, and its function in one file of shaders/bsdfs/. docs/adding-a-kind.md tells how to
//! add one.

pub mod harvey_shack;
pub mod lambertian;
#[cfg(test)]
mod retro;
pub mod specular;
pub mod tabulated;

pub use crate::model::bsdfs::harvey_shack::HarveyShack;
pub use crate::model::bsdfs::lambertian::Lambertian;
pub use crate::model::bsdfs::specular::Specular;
pub use crate::model::bsdfs::tabulated::{BsdfTable, Tabulated};

use crate::Result;
use crate::model::Interaction;
use crate::model::list::kinds;
use crate::shaders::ShaderFile;
use std::path::Path;

// The numbers are the codes in the shaders, where 0 means no BSDF. The mirror has code 1, but the last place in the
// schema of scene files.
kinds! {
    Bsdf: Scattering,
    functions BsdfKind: BsdfWgsl,
    /// A scatter model, by its `type`.
    written "Bsdf": Entry;
    /// Cosine-weighted over the hemisphere.
    Lambertian(lambertian::Lambertian) by Lambertian(2) = LAMBERTIAN;
    /// b0 / (1 + (beta / l0)^s) in the distance of direction cosines from specular.
    HarveyShack(harvey_shack::HarveyShack) by HarveyShack(3) = HARVEY_SHACK;
    /// Values over polar angles of incidence and scatter: from a file of three columns, or inline.
    Tabulated(tabulated::Tabulated) by Tabulated(4) = TABULATED;
    /// A mirror.
    Specular(specular::Specular) by Specular(1) = SPECULAR;
    /// Cat's eyes: the example of docs/adding-a-kind.md.
    #[cfg(test)]
    Retro(retro::Retro) by #[cfg(test)] Retro(5) = RETRO;
}

/// Scattering at a surface.
#[derive(Debug, Clone, PartialEq)]
pub struct Scatter {
    /// Probability that a ray is scattered; the others follow Fresnel or the mirror.
    pub fraction: f64,
    /// Where scattered rays go.
    pub bsdf: Bsdf,
}

/// What the shaders have of a BSDF.
#[derive(Debug)]
pub struct BsdfWgsl {
    /// Its function is `sample_<name>(s: Scattering, surface: Surface) -> Lobe`.
    pub name: &'static str,
    /// The file that holds it.
    pub file: ShaderFile,
    /// True if it reads [`Scattering::table`], which begins at `tables[surface.bsdf_table]`.
    pub has_table: bool,
}

/// What the program, the checks of scenes and the engine ask of a BSDF.
pub trait Scattering: std::fmt::Debug {
    /// The function that samples it.
    fn kind(&self) -> BsdfKind;

    /// The probability that a scattered ray leaves on the far side.
    fn transmissive_fraction(&self) -> f64;

    /// Numbers that the function reads, as columns of `surface`. Surfaces that lack a column have 0 there.
    fn reals(&self) -> Vec<(&'static str, f64)> {
        Vec::new()
    }

    /// Whole numbers that the function reads, likewise.
    fn counts(&self) -> Vec<(&'static str, u32)> {
        Vec::new()
    }

    /// Its table, if the function reads one. Equal BSDFs share it.
    fn table(&self) -> Vec<f64> {
        Vec::new()
    }

    /// True if its lobe is about the normal, whatever the incidence; other lobes turn with the ray.
    fn is_about_normal(&self) -> bool {
        false
    }

    /// True if it takes the whole weight of some rays and leaves it to others: then hits say nothing of the error.
    fn takes_whole_weights(&self) -> bool {
        false
    }

    /// What the user should know of it on a surface of this name and interaction.
    fn warning(&self, _surface: &str, _interaction: &Interaction) -> Option<String> {
        None
    }
}

/// What each file's `Written` does: the numbers of a BSDF as scene files have them.
trait Entry {
    /// Refuses numbers that no BSDF has. `at` gives the place of a key.
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()>;

    /// The BSDF of a surface, proven to scatter.
    fn bsdf(&self, surface: &Labelled<'_>, reading: &mut Reading<'_>) -> Result<Bsdf>;
}

/// What messages say of a BSDF in a scene file.
pub(crate) struct Labelled<'a> {
    /// The name of its surface.
    pub name: &'a str,
    /// Where it stands in the file.
    pub place: &'a str,
}

/// What a BSDF in a scene file needs beside itself.
pub(crate) struct Reading<'a> {
    /// Folder that paths start from.
    pub folder: &'a Path,
    /// Where to say what the user should know.
    pub warnings: &'a mut Vec<String>,
}

impl Written {
    /// Refuses numbers that no BSDF has; `at` gives the place of a key.
    ///
    /// # Errors
    /// [`crate::Error::Scene`] with the place and a remedy.
    pub fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        self.entry().check(at)
    }

    /// The BSDF of a surface, proven to scatter.
    pub(crate) fn bsdf(&self, surface: &Labelled<'_>, reading: &mut Reading<'_>) -> Result<Bsdf> {
        self.entry().bsdf(surface, reading)
    }
}

impl BsdfKind {
    /// The name in the shaders.
    pub fn name(self) -> &'static str {
        self.wgsl().name
    }

    /// True if it reads a table.
    pub fn has_table(self) -> bool {
        self.wgsl().has_table
    }
}
