//! The K-correlation lobe about the mirrored ray: polish whose power spectral density is flat at low frequencies.
//!
//! Sources: Church and Takacs, The optimal estimation of finish parameters, SPIE 1530, 1991; Dittman, K-correlation
//! power spectral density and surface scatter model, SPIE 6291, 2006.

use crate::model::bsdfs::{
    Bsdf, BsdfContext, BsdfKind, BsdfWgsl, LONGEST_OFFSET, Labelled, SHIFT_INVARIANT, Scattering,
    WrittenBsdf, other_side, too_wide,
};
use crate::model::key_path::quoted;
use crate::model::{Interaction, checks};
use crate::shaders::shader;
use crate::{Error, Result};
use schemars::JsonSchema;
use serde::Deserialize;
use std::f64::consts::PI;

/// The lobe.
pub const K_CORRELATION: BsdfWgsl = BsdfWgsl {
    name: "k_correlation",
    file: shader!("bsdfs/k_correlation.wgsl"),
    shared: Some(SHIFT_INVARIANT),
    has_table: false,
    toward: &[shader!("scatter_to/shift_invariant.wgsl"), shader!("scatter_to/k_correlation.wgsl")],
};

/// b0 / (1 + (B beta)^2)^(s/2), beta being the distance of direction cosines from the specular direction.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct KCorrelation {
    /// Peak \[1/sr\]. It counts where the surface's `scatter_fraction` is `tis`; otherwise that sets the lobe's level.
    pub b0: f64,
    /// Inverse of the shoulder: 2 pi times the typical wavelength of the surface, over the wavelength of the light.
    #[serde(rename = "B")]
    pub b: f64,
    /// Slope of the BSDF beyond the shoulder.
    pub s: f64,
    /// Fraction of the scattered rays that go straight on; on a refractive surface, from Fresnel's branch.
    /// The others are mirrored, there to the other side.
    #[serde(default)]
    pub transmissive_fraction: f64,
}

impl KCorrelation {
    /// Half of what the slope lacks of 2: the integral of the lobe grows with this power of 1 + (B beta)^2.
    fn power(&self) -> f64 {
        1.0 - 0.5 * self.s
    }

    fn logarithm(&self, beta: f64) -> f64 {
        (self.b * beta).powi(2).ln_1p()
    }

    /// (exp(p t) - 1) / p at `beta`, which is t where p is 0: the integral of the lobe, up to a factor.
    fn growth(&self, beta: f64) -> f64 {
        let (p, t) = (self.power(), self.logarithm(beta));
        if p == 0.0 { t } else { (p * t).exp_m1() / p }
    }

    /// The lobe's integral over distances of direction cosines up to `beta`.
    pub fn scattered_within(&self, beta: f64) -> f64 {
        PI * self.b0 * self.growth(beta) / (self.b * self.b)
    }

    /// The distance within which a share of all that is scattered lies.
    pub fn offset(&self, share: f64) -> f64 {
        let (p, t) = (self.power(), self.logarithm(LONGEST_OFFSET));
        let drawn = if p == 0.0 { share * t } else { (share * (p * t).exp_m1()).ln_1p() / p };
        drawn.exp_m1().sqrt() / self.b
    }

    /// A lobe beyond the unit disk of direction cosines has no direction there; f32 cannot hold a very narrow one.
    fn check_lobe(&self, surface: &Labelled<'_>, warnings: &mut Vec<String>) -> Result<()> {
        const NARROW: f64 = 1e-6;
        let total = self.scattered_within(LONGEST_OFFSET);
        if !(total.is_finite() && total > 0.0) {
            let remedy = if self.b0 == 0.0 { "give b0 > 0, or remove the bsdf" } else { "give a smaller B" };
            return Err(Error::scene(surface.place, "the lobe scatters nothing", remedy));
        }
        let half = self.offset(0.5);
        if half < NARROW {
            warnings.push(format!(
                "half of what the lobe of {} scatters differs by less than {half:.1e} in direction cosines from the \
                 specular direction, which `f32` cannot resolve",
                quoted(surface.name)
            ));
        }
        let lost = 1.0 - self.scattered_within(1.0) / total;
        warnings.extend(too_wide(surface.name, lost, "a larger B or a larger s"));
        Ok(())
    }
}

/// In a scene file the same.
pub type Written = KCorrelation;

impl WrittenBsdf for KCorrelation {
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        checks::between(at("b0"), self.b0, 0.0, 1e30)?;
        checks::between(at("B"), self.b, 1e-12, 1e12)?;
        checks::between(at("s"), self.s, 0.0, 1e3)?;
        checks::fraction(at("transmissive_fraction"), self.transmissive_fraction)
    }

    fn bsdf(&self, surface: &Labelled<'_>, reading: &mut BsdfContext<'_>) -> Result<Bsdf> {
        self.check_lobe(surface, reading.warnings)?;
        Ok(Bsdf::KCorrelation(self.clone()))
    }
}

impl Scattering for KCorrelation {
    fn kind(&self) -> BsdfKind {
        BsdfKind::KCorrelation
    }

    fn transmissive_fraction(&self) -> f64 {
        self.transmissive_fraction
    }

    /// See shaders/bsdfs/k_correlation.wgsl.
    fn reals(&self) -> Vec<(&'static str, f64)> {
        // What the draw lacks of 1 is 2^-32 or more, so a smaller rest changes nothing; f32 has no numbers below 1e-38.
        const LEAST: f64 = 1e-30;
        let (p, t) = (self.power(), self.logarithm(LONGEST_OFFSET));
        let rest = Some((p * t).exp()).filter(|rest| *rest > LEAST).unwrap_or(0.0);
        vec![
            ("k_correlation_width", 1.0 / self.b),
            ("k_correlation_growth", self.growth(LONGEST_OFFSET)),
            ("k_correlation_rest", rest),
            ("k_correlation_power", p),
        ]
    }

    /// Beyond the unit disk of direction cosines no direction lies.
    fn takes_whole_weights(&self) -> bool {
        true
    }

    fn by_tis(&self) -> Option<(f64, Bsdf)> {
        Some((self.scattered_within(LONGEST_OFFSET), Bsdf::KCorrelation(self.clone())))
    }

    fn warning(&self, surface: &str, interaction: &Interaction) -> Option<String> {
        other_side(surface, interaction, self.transmissive_fraction)
    }
}
