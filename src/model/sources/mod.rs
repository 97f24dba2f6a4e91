//! Sources of rays: the list of them, and what each must say of itself.
//!
//! Each source stands in one file here, and its function in one file of shaders/sources/. docs/adding-a-kind.md says
//! how to add one. Everything is said in the source's own frame. There rays are born at z = 0 and go towards +z. Rays
//! of a file may begin and go anywhere. Lengths are in mm, angles in rad.

pub mod collimated;
pub mod extended;
pub mod point;
pub mod pupil;
pub mod rays;
pub mod tabulated;

pub use crate::model::sources::collimated::Collimated;
pub use crate::model::sources::extended::Extended;
pub use crate::model::sources::point::Point;
pub use crate::model::sources::pupil::{Aim, Pupil};
pub use crate::model::sources::rays::Rays;
pub use crate::model::sources::tabulated::Tabulated;

use crate::Result;
use crate::model::list::kinds;
use crate::model::written::{CoordinateSystem, Material, Spectrum};
use crate::model::{Outline, checks, photometry};
use crate::shaders::ShaderFile;

kinds! {
    SourceKind: Emission,
    functions SourceFunction: SourceWgsl,
    /// A source, by its `type`.
    written "Source": WrittenSource;
    /// Rays from one point.
    Point(point::Point) by Point = POINT;
    /// A parallel beam.
    Collimated(collimated::Collimated) by CollimatedTophat = TOPHAT, CollimatedGaussian = GAUSSIAN;
    /// An emitting area.
    Extended(extended::Extended) by ExtendedRectangle = RECTANGLE, ExtendedDisk = DISK;
    /// The light of one field of a lens.
    Pupil(pupil::Pupil) by Pupil = PUPIL;
    /// A lamp by a table of its intensity.
    Tabulated(tabulated::Tabulated) by Tabulated = TABULATED;
    /// Rays of a file.
    Rays(rays::Rays) by Rays = RAYS, StreamedRays = STREAMED_RAYS;
}

/// Makes what scene files have of a source: the keys of all sources around its own.
macro_rules! written {
    (
        $(#[$attribute:meta])*
        pub struct $name:ident {
            $($(#[$key_attribute:meta])* pub $key:ident: $type:ty,)*
        }
    ) => {
        $(#[$attribute])*
        #[derive(Debug, Clone, PartialEq, serde::Deserialize, schemars::JsonSchema)]
        #[serde(deny_unknown_fields)]
        pub struct $name {
            /// Unique name.
            pub name: String,
            /// Position and axis.
            pub cs: $crate::model::written::CoordinateSystem,
            /// Discrete spectrum.
            pub spectrum: $crate::model::written::Spectrum,
            /// Flux \[W\].
            #[serde(default)]
            pub total_flux: Option<f64>,
            /// Flux \[lm\], instead of `total_flux`.
            #[serde(default)]
            pub total_flux_lumens: Option<f64>,
            $($(#[$key_attribute])* pub $key: $type,)*
            /// Medium around the source.
            #[serde(default)]
            pub medium: $crate::model::written::Material,
        }

        impl $crate::model::sources::HasShared for $name {
            fn shared(&self) -> $crate::model::sources::Shared<'_> {
                let $name { name, cs, spectrum, total_flux, total_flux_lumens, medium, .. } = self;
                $crate::model::sources::Shared {
                    name,
                    cs,
                    spectrum,
                    total_flux: *total_flux,
                    total_flux_lumens: *total_flux_lumens,
                    medium,
                }
            }
        }
    };
}
use written;

/// What the shaders have of a source.
#[derive(Debug)]
pub struct SourceWgsl {
    /// Its function is `emit_<name>(key: RayKey, e: Source) -> LocalRay`, which reads `e.p0`, `e.p1` and so on.
    pub name: &'static str,
    /// The file that holds it.
    pub file: ShaderFile,
    /// Steps of the random generator that it may take.
    pub num_steps: u32,
}

/// What the program, the checks of scenes and the viewer ask of a source.
pub trait Emission: std::fmt::Debug {
    /// The function that emits its rays.
    fn kind(&self) -> SourceFunction;

    /// The numbers `p0`, `p1` and so on of the function. The last one of a source with a [`Emission::table`] stands for where
    /// that begins.
    fn arguments(&self) -> Vec<f64>;

    /// What the function reads from the buffer of tables, in a scene of these wavelengths \[um\]; empty for nothing.
    fn table(&self, _wavelengths: &[f64]) -> Vec<f64> {
        Vec::new()
    }

    /// Where rays are born; of a point, a disk without an extent.
    fn births(&self) -> Outline;

    /// The lowest and the highest place along the axis where rays are born \[mm\].
    fn heights(&self) -> [f64; 2] {
        [0.0; 2]
    }

    /// The largest angle between a ray and the axis \[rad\].
    fn half_angle(&self) -> f64;

    /// True if all rays are born in one point.
    fn is_point(&self) -> bool {
        false
    }

    /// True if its rays are aimed at the stop of a lens.
    fn is_aimed(&self) -> bool {
        false
    }

    /// True if directions are drawn by Lambert's law.
    fn is_lambertian(&self) -> bool {
        false
    }

    /// What the user should know of a source of this name.
    fn warning(&self, _name: &str) -> Option<String> {
        None
    }
}

/// What all sources of scene files have.
struct Shared<'a> {
    name: &'a str,
    cs: &'a CoordinateSystem,
    spectrum: &'a Spectrum,
    total_flux: Option<f64>,
    total_flux_lumens: Option<f64>,
    medium: &'a Material,
}

/// What `written` gives to each file's `Written`.
trait HasShared {
    fn shared(&self) -> Shared<'_>;
}

/// What each file's `Written` does: the numbers of a source as scene files have them.
trait WrittenSource: HasShared {
    /// Refuses numbers that no such source has. `at` gives the place of a key.
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()>;

    /// How its rays are born.
    fn kind(&self) -> SourceKind;

    /// The flux that its own numbers say, if they do.
    fn own_flux(&self) -> Option<OwnFlux> {
        None
    }
}

/// Flux that a source's own numbers say.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum OwnFlux {
    /// \[W\]
    Watts(f64),
    /// \[lm\]
    Lumens(f64),
}

impl Written {
    /// The user's name for it.
    pub fn name(&self) -> &str {
        self.entry().shared().name
    }

    /// Position and axis.
    pub fn cs(&self) -> &CoordinateSystem {
        self.entry().shared().cs
    }

    /// Discrete spectrum.
    pub fn spectrum(&self) -> &Spectrum {
        self.entry().shared().spectrum
    }

    /// The flux as the source says it: by its own numbers, or beside them.
    fn stated_flux(&self) -> Option<OwnFlux> {
        let Shared { total_flux, total_flux_lumens, .. } = self.entry().shared();
        let beside = total_flux_lumens.map(OwnFlux::Lumens).or(total_flux.map(OwnFlux::Watts));
        self.entry().own_flux().or(beside)
    }

    /// Flux \[W\].
    pub fn total_flux(&self) -> f64 {
        match self.stated_flux() {
            Some(OwnFlux::Watts(watts)) => watts,
            Some(OwnFlux::Lumens(lumens)) => lumens / photometry::efficacy_of(self.spectrum()),
            None => 0.0,
        }
    }

    /// Flux \[lm\], of a source that says its flux in lumens or its intensity in candela.
    pub fn total_flux_lumens(&self) -> Option<f64> {
        match self.stated_flux() {
            Some(OwnFlux::Lumens(lumens)) => Some(lumens),
            Some(OwnFlux::Watts(_)) | None => None,
        }
    }

    /// Refuses a flux that is missing, or is said twice, or is said in lumens of light that nobody sees.
    fn check_flux(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        let Shared { total_flux, total_flux_lumens, spectrum, .. } = self.entry().shared();
        let given = match (total_flux, total_flux_lumens) {
            (Some(_), _) => Some("total_flux"),
            (None, Some(_)) => Some("total_flux_lumens"),
            (None, None) => None,
        };
        match (self.entry().own_flux(), given) {
            (Some(_), Some(key)) => {
                return checks::refuse(
                    at(key),
                    "the intensities say the flux as well",
                    "leave it out, or give the intensity in units of `relative`",
                );
            }
            (None, None) => {
                return checks::refuse(
                    at("total_flux"),
                    "the source has no flux",
                    "give total_flux in W, or total_flux_lumens in lm",
                );
            }
            (None, Some(_)) if total_flux.and(total_flux_lumens).is_some() => {
                return checks::refuse(
                    at("total_flux_lumens"),
                    "the source has a total_flux in W as well",
                    "give one of the two",
                );
            }
            (None, Some(_)) | (Some(_), None) => {}
        }
        let is_seen = photometry::is_visible(photometry::efficacy_of(spectrum));
        if self.total_flux_lumens().is_some() && !is_seen {
            return checks::refuse(
                at("spectrum"),
                "the flux is in lumens, and nobody sees light of these wavelengths",
                "give wavelengths within 0.38 to 0.78 um, or the flux in W",
            );
        }
        Ok(())
    }

    /// Medium around the source.
    pub fn medium(&self) -> &Material {
        self.entry().shared().medium
    }

    /// Refuses numbers that no such source has, but for those that all sources have; `at` gives the place of a key.
    ///
    /// # Errors
    /// [`crate::Error::Scene`] with the place and a remedy.
    pub fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        self.entry().check(at)?;
        self.check_flux(at)
    }

    /// How its rays are born.
    pub fn kind(&self) -> SourceKind {
        self.entry().kind()
    }
}

impl SourceFunction {
    /// The name in the shaders.
    pub fn name(self) -> &'static str {
        self.wgsl().name
    }

    /// The function that emits a source's rays.
    pub fn of(kind: &SourceKind) -> Self {
        kind.kind()
    }
}

/// 1 - cos(half angle), without cancellation.
fn cap_height(half_angle: f64) -> f64 {
    let s = (half_angle / 2.0).sin();
    2.0 * s * s
}

/// The half-angle that scene files leave out \[deg\].
fn right_angle() -> f64 {
    90.0
}
