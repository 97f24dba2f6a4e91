//! How many random numbers a Sobol point is worth: the ratio of the mean squared errors at the same number of rays, which
//! is the ratio of the numbers of rays at the same error, since that of random numbers falls with their number.

use super::estimate::{Errors, Estimate};
use super::scenes::{AccuracyScene, scene};
use crate::error::Result;
use crate::gpu::Gpu;
use crate::ir::{ReflectProb, SceneIr};
use crate::program::{Precision, Sampler};
use crate::scene::Scene;
use crate::trace::{StandardError, TraceOptions, Tracer};

/// What is claimed of Sobol points in a scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Claim {
    /// The scene and the detector.
    pub scene: AccuracyScene,
    /// `split_depth` and `split_budget`, if rays are split; else the scene's own policy.
    pub split: Option<(u32, f64)>,
    /// Rays of each trace.
    pub num_rays: u64,
    /// Groups of [`GROUP`] traces, of either kind of draw.
    pub num_groups: u64,
    /// The map's ratio is at least this, where something is claimed of it.
    pub map: Option<f64>,
    /// The same of the detector's flux.
    pub flux: Option<f64>,
}

/// Which error a ratio is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// RMS over the pixels.
    Map,
    /// That of the detector's flux.
    Flux,
}

impl Quantity {
    fn of(self, errors: &Errors) -> f64 {
        match self {
            Quantity::Map => errors.cells,
            Quantity::Flux => errors.total,
        }
    }
}

/// What was measured of a claim.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Verdict {
    /// The claim.
    pub claim: Claim,
    /// How many random numbers a Sobol point is worth, by the map.
    pub map: Ratio,
    /// The same by the detector's flux.
    pub flux: Ratio,
    /// Error of the map with random numbers, of so many rays.
    pub map_error: f64,
}

impl Verdict {
    /// True if the ratios are at least what is claimed, at 99 %.
    pub fn holds(&self) -> bool {
        let holds = |ratio: Ratio, least: Option<f64>| least.is_none_or(|least| ratio.low >= least);
        holds(self.map, self.claim.map) && holds(self.flux, self.claim.flux)
    }
}

/// A ratio with its confidence interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ratio {
    /// At least this, with a confidence of 99 %.
    pub low: f64,
    /// The estimate.
    pub value: f64,
    /// At most this, with a confidence of 99 %.
    pub high: f64,
}

/// Traces of a group: each has a seed of its own, so that scrambles are independent.
pub const GROUP: u64 = 8;
/// Seeds of Sobol points begin here, those of random numbers at 0.
const FIRST_SOBOL_SEED: u64 = 1 << 33;

/// Standard errors beyond which a mean of few lies on one side with a probability of 1 %: Student's t, by its expansion
/// about the normal deviate (Abramowitz and Stegun, 26.7.5), within 2 % from 4 degrees of freedom on.
fn students_t(freedom: f64) -> f64 {
    const Z: f64 = 2.326_347_874;
    let first = (Z.powi(3) + Z) / 4.0;
    let second = (5.0 * Z.powi(5) + 16.0 * Z.powi(3) + 3.0 * Z) / 96.0;
    let third = (3.0 * Z.powi(7) + 19.0 * Z.powi(5) + 17.0 * Z.powi(3) - 15.0 * Z) / 384.0;
    Z + first / freedom + second / freedom.powi(2) + third / freedom.powi(3)
}

/// At least ten random numbers a point.
const TEN: Option<f64> = Some(10.0);
/// Not worse.
const AS_GOOD: Option<f64> = Some(0.95);

macro_rules! claim {
    ($name:literal, $detector:literal, $split:expr, $log2_rays:literal, $groups:literal, $map:expr, $flux:expr) => {
        Claim {
            scene: scene!($name, "", $detector, 16),
            split: $split,
            num_rays: 1 << $log2_rays,
            num_groups: $groups,
            map: $map,
            flux: $flux,
        }
    };
}

/// Few dimensions: two of the source and two reflections; two and the wavelength; four of a lamp. Then a real lens whose
/// rays are split. Then scenes where many dimensions matter. A lamp's map has the ratio from enough rays on: its pixels see
/// all four dimensions. Of two fluxes that are about alike, so few traces know the ratio to a quarter: it is shown alone.
pub const CLAIMS: [Claim; 18] = [
    claim!("bench_lens", "D", None, 14, 16, TEN, TEN),
    claim!("newtonian_telescope", "camera", None, 14, 16, TEN, TEN),
    claim!("hubble_nasmyth", "camera", None, 14, 16, TEN, TEN),
    Claim { scene: LAMP, split: None, num_rays: 1 << 14, num_groups: 8, map: AS_GOOD, flux: AS_GOOD },
    Claim { scene: LAMP, split: None, num_rays: 1 << 22, num_groups: 5, map: TEN, flux: TEN },
    claim!("cooke_triplet", "image", Some((6, 7.0)), 16, 5, TEN, TEN),
    claim!("bench_lens", "D", Some((4, 5.0)), 12, 8, TEN, TEN),
    claim!("light_pipe", "exit_map", None, 13, 24, AS_GOOD, AS_GOOD),
    claim!("petzval_projector", "screen", None, 13, 24, AS_GOOD, None),
    claim!("tapered_light_guide", "plane", None, 13, 24, AS_GOOD, AS_GOOD),
    claim!("scattering_telescope", "focus", None, 13, 24, AS_GOOD, AS_GOOD),
    claim!("integrating_sphere", "port", None, 13, 24, AS_GOOD, AS_GOOD),
    claim!("kaleidoscope", "eye", None, 13, 24, AS_GOOD, AS_GOOD),
    claim!("lambertian_sphere", "port", None, 13, 48, AS_GOOD, None),
    claim!("opal_lamp", "down", None, 13, 48, AS_GOOD, None),
    claim!("mirror_ball_billiard", "slot", None, 13, 24, AS_GOOD, None),
    claim!("stacked_plates_ghosts", "through", None, 13, 64, AS_GOOD, AS_GOOD),
    claim!("heliar_ghosts", "image", None, 13, 64, AS_GOOD, AS_GOOD),
];

/// A disk through a stop onto a map, and nothing else: four dimensions.
const LAMP: AccuracyScene = AccuracyScene {
    name: "lamp",
    title: "",
    detector: "D",
    max_depth: 16,
    text: r#"{
        "nsq_schema_version": 1, "components": [],
        "sources": [{"type": "extended", "name": "S", "cs": {"z": 0.0}, "total_flux": 1.0, "aperture_radius": 5.0,
            "half_angle_deg": 30.0, "spectrum": {"wavelengths": [0.55], "weights": [1.0]}}],
        "detectors": [{"type": "irradiance", "name": "D", "cs": {"z": 20.0}, "width": 30.0, "height": 30.0,
            "num_pixels_x": 32, "num_pixels_y": 32, "absorb": true}],
        "nsq_gpu": {"version": 1, "surfaces": [{"name": "stop", "cs": {"z": 10.0}, "interaction": "absorbing",
            "shape": {"type": "annulus", "inner_radius": 6.0, "outer_radius": 100.0}}]}
    }"#,
};

/// Mean squared deviations from the mean of their group, by group: variances without bias.
#[derive(Debug, Clone, PartialEq)]
pub struct Variances(Vec<Errors>);

impl Variances {
    /// Of traces of a tracer's scene by independent seeds.
    ///
    /// # Errors
    /// Those of the trace.
    pub fn measure(tracer: &mut Tracer, sensor: usize, num_groups: u64, first_seed: u64) -> Result<Self> {
        let group = |group: u64| {
            let seeds = first_seed + group * GROUP..first_seed + (group + 1) * GROUP;
            let estimates = seeds.map(|seed| {
                tracer.set_seed(seed);
                Ok(Estimate::of(&tracer.trace(|_| true)?, sensor))
            });
            Ok(variance(&estimates.collect::<Result<Vec<_>>>()?))
        };
        Ok(Variances((0..num_groups).map(group).collect::<Result<_>>()?))
    }

    /// Mean over the groups, and the square of its relative standard error.
    fn mean(&self, quantity: Quantity) -> (f64, f64) {
        let values: Vec<f64> = self.0.iter().map(|errors| quantity.of(errors)).collect();
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
        (mean, squares / (count - 1.0).max(1.0) / count / (mean * mean))
    }

    /// This over another.
    pub fn ratio_to(&self, other: &Variances, quantity: Quantity) -> Ratio {
        let ((ours, our_spread), (theirs, their_spread)) = (self.mean(quantity), other.mean(quantity));
        let value = ours / theirs;
        // Of the logarithm, which is closer to a normal deviate.
        let freedom = self.0.len().min(other.0.len()) as f64 - 1.0;
        let factor = (students_t(freedom.max(1.0)) * (our_spread + their_spread).sqrt()).exp();
        Ratio { low: value / factor, value, high: value * factor }
    }
}

fn variance(estimates: &[Estimate]) -> Errors {
    let mean = Estimate::mean(estimates);
    let errors: Vec<Errors> = estimates.iter().map(|estimate| estimate.errors(&mean)).collect();
    let rms = Errors::root_mean_square(&errors);
    let count = estimates.len() as f64;
    let square = |rms: f64| rms * rms * count / (count - 1.0);
    Errors { cells: square(rms.cells), total: square(rms.total) }
}

impl Claim {
    /// A claim that is not judged: of few rays and traces.
    pub fn quick(&self) -> Self {
        Claim { num_rays: self.num_rays.min(1 << 10), num_groups: 6, map: None, flux: None, ..*self }
    }

    /// Traces of either kind of draw.
    pub fn num_traces(&self) -> u64 {
        self.num_groups * GROUP
    }

    /// Its scene, as its file says, splats included.
    ///
    /// # Errors
    /// [`crate::Error::Scene`] if the file is refused.
    pub fn ir(&self) -> Result<SceneIr> {
        let mut ir = Scene::from_json(self.scene.text)?.lower()?;
        if let Some((depth, budget)) = self.split {
            ir.sampling.reflect_prob = ReflectProb::Fresnel;
            (ir.sampling.split_depth, ir.sampling.split_budget) = (depth, budget);
        }
        Ok(ir)
    }

    /// Measures it.
    ///
    /// # Errors
    /// Those of the trace.
    pub fn measure(&self, gpu: &Gpu, precision: Precision) -> Result<Verdict> {
        let ir = self.ir()?;
        let sensor = self.scene.sensor(&ir)?;
        let variances = |sampler, first_seed| {
            let options = TraceOptions {
                num_rays: self.num_rays,
                max_depth: self.scene.max_depth,
                precision,
                sampler,
                standard_error: StandardError::Off,
                ..TraceOptions::default()
            };
            Variances::measure(&mut Tracer::new(gpu, &ir, &options)?, sensor, self.num_groups, first_seed)
        };
        let pcg = variances(Sampler::Pcg, 0)?;
        let sobol = variances(Sampler::Sobol, FIRST_SOBOL_SEED)?;
        Ok(Verdict {
            claim: *self,
            map: pcg.ratio_to(&sobol, Quantity::Map),
            flux: pcg.ratio_to(&sobol, Quantity::Flux),
            map_error: pcg.mean(Quantity::Map).0.sqrt(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_of_claims_are_valid_and_have_their_detectors() {
        for claim in CLAIMS.iter().chain([&Claim { split: None, ..CLAIMS[0] }]) {
            let ir = claim.ir().unwrap_or_else(|error| panic!("{}: {error}", claim.scene.name));
            assert!(ir.sensors[claim.scene.sensor(&ir).unwrap()].num_cells() > 0, "{}", claim.scene.name);
        }
    }

    #[test]
    fn ratios_are_of_means_and_their_intervals_shrink_with_groups() {
        let variances = |values: &[f64]| {
            Variances(values.iter().map(|&cells| Errors { cells, total: 2.0 * cells }).collect())
        };
        let (few, many) = (variances(&[8.0, 12.0]), variances(&[8.0, 12.0].repeat(50)));
        let one = variances(&[1.0; 100]);
        let [few, many] = [few, many].map(|v| v.ratio_to(&one, Quantity::Map));
        assert_eq!((few.value, many.value), (10.0, 10.0));
        assert!(few.low < many.low && many.low < 10.0 && many.high < few.high);
        // Standard deviation of a mean of 100: 0.2.
        approx::assert_relative_eq!(many.high / many.value, (2.365 * 0.0201_f64).exp(), max_relative = 1e-3);
    }

    #[test]
    fn quantiles_are_those_of_students_t() {
        for (freedom, t) in [(4.0, 3.747), (7.0, 2.998), (15.0, 2.602), (63.0, 2.387)] {
            approx::assert_relative_eq!(students_t(freedom), t, max_relative = 0.02);
        }
    }

    #[test]
    fn the_variance_of_a_group_has_no_bias() {
        let estimate = |total: f64| Estimate { cells: vec![total, 1.0], total };
        // About their mean of 2 the values deviate by 1, 0 and 1, so that their variance is 1.
        let found = variance(&[1.0, 2.0, 3.0].map(estimate));
        approx::assert_relative_eq!(found.total, 0.25, max_relative = 1e-12);
        approx::assert_relative_eq!(found.cells, 0.5, max_relative = 1e-12);
    }
}
