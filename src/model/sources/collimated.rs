//! Parallel beams.

use crate::Result;
use crate::format::significant;
use crate::model::key_path::quoted;
use crate::model::sources::{Emission, SourceFunction, SourceKind, SourceWgsl, WrittenSource, written};
use crate::model::{Outline, checks};
use crate::shaders::shader;
use schemars::JsonSchema;
use serde::Deserialize;

/// The uniform beam.
pub const TOPHAT: SourceWgsl =
    SourceWgsl { name: "collimated_tophat", file: shader!("sources/collimated_tophat.wgsl"), num_steps: 1 };

/// The Gaussian beam: the last step is for the rim, where all attempts failed.
pub const GAUSSIAN: SourceWgsl = SourceWgsl {
    name: "collimated_gaussian",
    file: shader!("sources/collimated_gaussian.wgsl"),
    num_steps: ATTEMPTS + 1,
};

/// How often the Gaussian beam draws a place, as shaders/sources/collimated_gaussian.wgsl has it.
const ATTEMPTS: u32 = 32;

/// Parallel rays along local +z from a disk.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Collimated {
    /// Disk radius \[mm\].
    pub aperture_radius: f64,
    /// Of a Gaussian beam, truncated at the rim: standard deviation of x and of y before truncation \[mm\]. None for a
    /// uniform beam.
    pub sigma: Option<f64>,
}

/// Flux over a beam.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "Profile")]
pub enum BeamProfile {
    /// Uniform.
    #[default]
    Tophat,
    /// Gaussian, cut at the aperture.
    Gaussian,
}

written! {
    /// A parallel beam along local +z.
    pub struct Written {
        /// Radius of the beam \[mm\].
        #[serde(default = "one")]
        pub aperture_radius: f64,
        /// Flux over the beam.
        #[serde(default)]
        pub profile: BeamProfile,
        /// Standard deviation of a Gaussian beam \[mm\]; half the aperture radius if null.
        #[serde(default)]
        pub gaussian_sigma: Option<f64>,
    }
}

fn one() -> f64 {
    1.0
}

impl WrittenSource for Written {
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        checks::size(at("aperture_radius"), self.aperture_radius)?;
        self.gaussian_sigma.map_or(Ok(()), |sigma| checks::size(at("gaussian_sigma"), sigma))
    }

    fn kind(&self) -> SourceKind {
        let aperture_radius = self.aperture_radius;
        let sigma = match self.profile {
            BeamProfile::Tophat => None,
            BeamProfile::Gaussian => Some(self.gaussian_sigma.unwrap_or(aperture_radius / 2.0)),
        };
        SourceKind::Collimated(Collimated { aperture_radius, sigma })
    }
}

impl Emission for Collimated {
    fn kind(&self) -> SourceFunction {
        match self.sigma {
            None => SourceFunction::CollimatedTophat,
            Some(_) => SourceFunction::CollimatedGaussian,
        }
    }

    fn arguments(&self) -> Vec<f64> {
        [self.aperture_radius].into_iter().chain(self.sigma).collect()
    }

    fn births(&self) -> Outline {
        Outline::Disk { radius: self.aperture_radius }
    }

    fn half_angle(&self) -> f64 {
        0.0
    }

    /// Places of a Gaussian beam are drawn until one lies within the radius, but no more than so often, as in Optiland.
    /// Then the ray starts on the rim. Each draw lies beyond the radius with a probability of exp(-R^2 / 2 sigma^2).
    fn warning(&self, name: &str) -> Option<String> {
        /// Fewer are lost in the noise of a million rays and more.
        const SHARE: f64 = 1e-6;
        let (radius, sigma) = (self.aperture_radius, self.sigma?);
        let share = (-0.5 * f64::from(ATTEMPTS) * (radius / sigma).powi(2)).exp();
        (share > SHARE).then(|| {
            format!(
                "source {} has a gaussian_sigma of {sigma} mm in a radius of {radius} mm: {} % of its rays start on the rim, \
                 because their places are drawn no more than {ATTEMPTS} times, as in Optiland; a tophat profile or a smaller \
                 gaussian_sigma has none there",
                quoted(name),
                significant(100.0 * share, 2)
            )
        })
    }
}
