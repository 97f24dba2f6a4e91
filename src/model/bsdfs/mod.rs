//! BSDFs, the laws by which surfaces scatter: the list of them, and what each must say of itself.
//!
//! Each BSDF stands in one file here, and its function in one file of shaders/bsdfs/. docs/adding-a-kind.md says how to
//! add one.

pub mod harvey_shack;
pub mod k_correlation;
pub mod lambertian;
pub mod measured;
#[cfg(test)]
mod retro;
pub mod specular;
pub mod tabulated;

pub use crate::model::bsdfs::harvey_shack::HarveyShack;
pub use crate::model::bsdfs::k_correlation::KCorrelation;
pub use crate::model::bsdfs::lambertian::Lambertian;
pub use crate::model::bsdfs::measured::{Measured, MeasuredRow, MeasuredTable};
pub use crate::model::bsdfs::specular::Specular;
pub use crate::model::bsdfs::tabulated::{BsdfTable, Tabulated};

use crate::Result;
use crate::model::Interaction;
use crate::model::key_path::quoted;
use crate::model::list::kinds;
use crate::shaders::{ShaderFile, shader};
use std::path::Path;

// The numbers are the codes in the shaders, where 0 means no BSDF. The mirror has code 1, but the last place in the
// schema of scene files.
kinds! {
    Bsdf: Scattering,
    functions BsdfKind: BsdfWgsl,
    /// A scatter model, by its `type`.
    written "Bsdf": WrittenBsdf;
    /// Cosine-weighted over the hemisphere.
    Lambertian(lambertian::Lambertian) by Lambertian(2) = LAMBERTIAN;
    /// b0 / (1 + (beta / l0)^s) in the distance of direction cosines from specular.
    HarveyShack(harvey_shack::HarveyShack) by HarveyShack(3) = HARVEY_SHACK;
    /// Values over polar angles of incidence and scatter: from a file of three columns, or inline.
    Tabulated(tabulated::Tabulated) by Tabulated(4) = TABULATED;
    /// A mirror.
    Specular(specular::Specular) by Specular(1) = SPECULAR;
    /// b0 / (1 + (B beta)^2)^(s/2) in the distance beta of direction cosines from specular.
    KCorrelation(k_correlation::KCorrelation) by KCorrelation(5) = K_CORRELATION;
    /// Values over the angle of incidence, and over two angles about the specular direction: from a file, or inline.
    Measured(measured::Measured) by Measured(6) = MEASURED;
    /// Cat's eyes: the example of docs/adding-a-kind.md.
    #[cfg(test)]
    Retro(retro::Retro) by #[cfg(test)] Retro(1000) = RETRO;
}

/// Distances of direction cosines reach from 0 to 2.
const LONGEST_OFFSET: f64 = 2.0;

/// Scattering at a surface.
#[derive(Debug, Clone, PartialEq)]
pub struct Scatter {
    /// Probability that a ray is scattered; the others follow Fresnel or the mirror.
    pub fraction: f64,
    /// Where scattered rays go.
    pub bsdf: Bsdf,
}

impl Scatter {
    /// True if some rays are scattered and others are not, so that scattering is drawn.
    pub fn is_of_a_part(&self) -> bool {
        self.fraction > 0.0 && self.fraction < 1.0
    }
}

/// What the shaders have of a BSDF.
#[derive(Debug)]
pub struct BsdfWgsl {
    /// Its function is `sample_<name>(s: Scattering, surface: Surface) -> Lobe`.
    pub name: &'static str,
    /// The file that holds it.
    pub file: ShaderFile,
    /// A file that it shares with other kinds.
    pub shared: Option<ShaderFile>,
    /// True if it reads [`Scattering::table`], which begins at `tables[surface.bsdf_table]`.
    pub has_table: bool,
    /// The files that say how it draws a direction, so that a target may take part: the last one has
    /// `toward_<name>(s: Scattering, surface: Surface, direction: vec3<real>) -> Toward` (shaders/scatter_to). Empty
    /// where directions have no density, as with a mirror.
    pub toward: &'static [ShaderFile],
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

    /// What `"scatter_fraction": "tis"` means: the share of the rays that scatters, and by what. Together they have the
    /// level that was written. `None` for a BSDF without a level.
    fn by_tis(&self) -> Option<(f64, Bsdf)> {
        None
    }

    /// True if a plain trace scatters as much as the BSDF's own numbers say, also without `"scatter_fraction": "tis"`.
    fn keeps_level(&self) -> bool {
        false
    }

    /// What the user should know of it on a surface of this name and interaction.
    fn warning(&self, _surface: &str, _interaction: &Interaction) -> Option<String> {
        None
    }
}

/// What the kinds share whose lobes depend on distances of direction cosines alone.
const SHIFT_INVARIANT: ShaderFile = shader!("bsdfs/shift_invariant.wgsl");

/// Says how much such a lobe loses that reaches beyond the unit disk of direction cosines, where no direction lies.
fn too_wide(surface: &str, lost: f64, remedy: &str) -> Option<String> {
    const NOTICED: f64 = 0.01;
    (lost > NOTICED).then(|| {
        format!(
            "the lobe of {} is so wide that {:.1} % of what it scatters at normal incidence has no direction and is \
             lost, more at a slant, as in Optiland; {remedy} narrows it",
            quoted(surface),
            100.0 * lost
        )
    })
}

/// On a refractive surface a lobe is about the ray that Fresnel's branch sends on, or about the mirror image of that
/// ray. The image is on the other side.
fn other_side(surface: &str, interaction: &Interaction, transmissive_fraction: f64) -> Option<String> {
    let is_swapped = *interaction == Interaction::Refractive && transmissive_fraction < 1.0;
    is_swapped.then(|| {
        format!(
            "of what {} scatters, {:.1} % goes to the other side than Fresnel's branch, as in Optiland: a \
             transmissive_fraction of 1 blurs both branches where they are",
            quoted(surface),
            100.0 * (1.0 - transmissive_fraction)
        )
    })
}

/// What each file's `Written` does: the numbers of a BSDF as scene files have them.
trait WrittenBsdf {
    /// Refuses numbers that no BSDF has. `at` gives the place of a key.
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()>;

    /// The BSDF of a surface, proven to scatter.
    fn bsdf(&self, surface: &Labelled<'_>, reading: &mut BsdfContext<'_>) -> Result<Bsdf>;
}

/// What messages say of a BSDF in a scene file.
pub(crate) struct Labelled<'a> {
    /// The name of its surface.
    pub name: &'a str,
    /// Where it stands in the file.
    pub place: &'a str,
}

/// What a BSDF in a scene file needs beside itself.
pub(crate) struct BsdfContext<'a> {
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
    pub(crate) fn bsdf(&self, surface: &Labelled<'_>, reading: &mut BsdfContext<'_>) -> Result<Bsdf> {
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
