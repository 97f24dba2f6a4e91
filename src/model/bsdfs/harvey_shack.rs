//! Harvey and Shack's lobe about the mirrored ray: what polish leaves on lenses and mirrors.

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
use std::f64::consts::TAU;

/// The lobe.
pub const HARVEY_SHACK: BsdfWgsl = BsdfWgsl {
    name: "harvey_shack",
    file: shader!("bsdfs/harvey_shack.wgsl"),
    shared: Some(SHIFT_INVARIANT),
    has_table: true,
    toward: &[shader!("scatter_to/shift_invariant.wgsl"), shader!("scatter_to/harvey_shack.wgsl")],
};

/// Knots of a table.
pub const KNOTS: usize = 4096;

/// Distance of two knots.
pub const STEP: f64 = LONGEST_OFFSET / (KNOTS - 1) as f64;

/// b0 / (1 + (beta / l0)^s), beta being the distance of direction cosines from the specular direction.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct HarveyShack {
    /// Peak \[1/sr\]. It counts where the surface's `scatter_fraction` is `tis`; otherwise that sets the lobe's level.
    pub b0: f64,
    /// Shoulder.
    pub l0: f64,
    /// Slope.
    pub s: f64,
    /// Fraction of the scattered rays that go straight on; on a refractive surface, from Fresnel's branch.
    /// The others are mirrored, there to the other side.
    #[serde(default)]
    pub transmissive_fraction: f64,
}

impl HarveyShack {
    /// The distribution of the radial offset at [`KNOTS`] equal steps, by Optiland's trapezoids in its order, and the
    /// total integrated scatter.
    pub fn distribution(&self) -> (Vec<f64>, f64) {
        let HarveyShack { b0, l0, s, .. } = *self;
        let last = KNOTS - 1;
        let beta = |knot: usize| if knot == last { LONGEST_OFFSET } else { knot as f64 * STEP };
        // d(beta_x) d(beta_y) = 2 pi beta d(beta).
        let density = |knot: usize| b0 / (1.0 + (beta(knot) / l0).powf(s)) * TAU * beta(knot);
        let mut sum = 0.0;
        let mut cumulative = vec![0.0];
        cumulative.extend((1..KNOTS).map(|knot| {
            sum += 0.5 * (density(knot) + density(knot - 1)) * (beta(knot) - beta(knot - 1));
            sum
        }));
        cumulative.iter_mut().for_each(|value| *value /= sum);
        (cumulative, sum)
    }

    /// A lobe that Optiland's table cannot resolve becomes wider than it is; one that falls through it has no shape at
    /// all. One about the normal that reaches beyond the unit disk of direction cosines has no direction there, and what
    /// is drawn is lost.
    fn check_lobe(&self, surface: &Labelled<'_>, warnings: &mut Vec<String>) -> Result<()> {
        let (cumulative, total) = self.distribution();
        if !(total.is_finite() && total > 0.0) {
            let remedy = if self.b0 == 0.0 { "give b0 > 0, or remove the bsdf" } else { "give a larger l0" };
            return Err(Error::scene(surface.place, "the lobe scatters nothing", remedy));
        }
        let (name, l0) = (quoted(surface.name), self.l0);
        if l0 < 2.0 * STEP {
            warnings.push(format!(
                "the lobe of {name} is too narrow (l0 = {l0}) for the steps of {STEP:.1e} in which it is tabulated: it is \
                 traced wider"
            ));
        }
        let lost = 1.0 - cumulative[(1.0 / STEP).round() as usize];
        warnings.extend(too_wide(surface.name, lost, "a smaller l0 or a larger s"));
        Ok(())
    }
}

/// In a scene file the same.
pub type Written = HarveyShack;

impl WrittenBsdf for HarveyShack {
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        checks::between(at("b0"), self.b0, 0.0, 1e30)?;
        checks::between(at("l0"), self.l0, 1e-12, 1e12)?;
        checks::between(at("s"), self.s, 0.0, 1e3)?;
        checks::fraction(at("transmissive_fraction"), self.transmissive_fraction)
    }

    fn bsdf(&self, surface: &Labelled<'_>, reading: &mut BsdfContext<'_>) -> Result<Bsdf> {
        self.check_lobe(surface, reading.warnings)?;
        Ok(Bsdf::HarveyShack(self.clone()))
    }
}

impl Scattering for HarveyShack {
    fn kind(&self) -> BsdfKind {
        BsdfKind::HarveyShack
    }

    fn transmissive_fraction(&self) -> f64 {
        self.transmissive_fraction
    }

    fn table(&self) -> Vec<f64> {
        self.distribution().0
    }

    /// Beyond the unit disk of direction cosines no direction lies.
    fn takes_whole_weights(&self) -> bool {
        true
    }

    fn by_tis(&self) -> Option<(f64, Bsdf)> {
        Some((self.distribution().1, Bsdf::HarveyShack(self.clone())))
    }

    fn warning(&self, surface: &str, interaction: &Interaction) -> Option<String> {
        other_side(surface, interaction, self.transmissive_fraction)
    }
}
