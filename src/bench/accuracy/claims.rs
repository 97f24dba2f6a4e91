//! How many random numbers a Sobol point is worth: the ratio of the mean squared errors at the same number of rays.
//! With random numbers the mean squared error falls as the number of rays grows. So this is also the ratio of the
//! numbers of rays at the same error.

use crate::bench::accuracy::scenes::{AccuracyScene, scene};
use crate::bench::accuracy::variances::{FluxVariance, GROUP, Quantity, Ratio, Variances};
use crate::error::Result;
use crate::gpu::Gpu;
use crate::model::{ReflectProb, SceneIr};
use crate::program::{Precision, Sampler};
use crate::run::{StandardError, TraceOptions, Tracer};
use crate::scene::Scene;

/// A claim about Sobol points in a scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Claim {
    /// The scene and the detector.
    pub scene: AccuracyScene,
    /// `split_depth` and `split_budget`, if rays are split; else the scene's own policy.
    pub split: Option<(u32, f64)>,
    /// Rays of each trace.
    pub num_rays: u64,
    /// Number of groups of [`GROUP`] traces with random numbers.
    pub pcg_groups: u64,
    /// Number of groups with Sobol points.
    pub sobol_groups: u64,
    /// The least ratio that is claimed for the map, if any.
    pub map: Option<f64>,
    /// The least ratio that is claimed for the detector's flux, if any.
    pub flux: Option<f64>,
}

/// The measurement of a claim.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Verdict {
    /// The claim.
    pub claim: Claim,
    /// How many random numbers a Sobol point is worth, by the map; `None` if random numbers make no error either.
    pub map: Option<Ratio>,
    /// The same, by the detector's flux.
    pub flux: Option<Ratio>,
    /// Error of the map with random numbers, of `num_rays` rays.
    pub map_error: f64,
}

impl Verdict {
    /// True if the ratios are at least the claimed ones, with a confidence of 99 %.
    pub fn holds(&self) -> bool {
        at_least(self.map, self.claim.map) && at_least(self.flux, self.claim.flux)
    }
}

/// True if a ratio is at least the claimed one, or if none is claimed.
pub fn at_least(ratio: Option<Ratio>, claim: Option<f64>) -> bool {
    ratio.zip(claim).is_none_or(|(ratio, least)| ratio.low >= least)
}

/// The first seed of random numbers. Lower seeds belong to the traces that determine how many traces are needed.
const FIRST_PCG_SEED: u64 = 1 << 37;
/// The first seed of Sobol points.
const FIRST_SOBOL_SEED: u64 = 1 << 38;

/// The claim of at least ten random numbers a point.
const TEN: Option<f64> = Some(10.0);
/// The claim of being no worse.
const AS_GOOD: Option<f64> = Some(0.95);

macro_rules! claim {
    ($name:literal, $detector:literal, $split:expr, $num_rays:expr, $traces:expr, $least:expr) => {{
        let traces: [u64; 2] = $traces;
        Claim {
            scene: scene!($name, "", $detector, 16),
            split: $split,
            num_rays: $num_rays,
            pcg_groups: traces[0] / GROUP,
            sobol_groups: traces[1] / GROUP,
            map: $least,
            flux: $least,
        }
    }};
}

macro_rules! not_worse {
    ($name:literal, $detector:literal, $pcg_traces:literal, $sobol_traces:literal) => {
        claim!($name, $detector, None, 1 << 13, [$pcg_traces, $sobol_traces], AS_GOOD)
    };
}

/// All claims. The first scenes have few dimensions. In some, only the source draws, because rays decide nothing after
/// their birth; in a singlet two reflections are added. Then come lenses whose rays are split.
///
/// All other scenes of the repository follow, so that no scene is chosen by its result. The exception is
/// `coated_projector`, whose scattering is in a file of its own. Each scene is judged by its first detector with cells.
/// With enough rays, a lamp's map has the ratio of few dimensions: its pixels see all four.
///
/// A pilot with its own seeds estimated the ratios. From it follows the number of traces that decides a claim, with
/// three standard errors to spare. Closer claims need more traces.
pub const CLAIMS: [Claim; 41] = [
    claim!("bench_surface_count_50", "D", None, 1 << 13, [128, 128], TEN),
    claim!("bench_cavity", "D", None, 1 << 13, [128, 128], TEN),
    claim!("newtonian_telescope", "camera", None, 1 << 14, [128, 128], TEN),
    claim!("hubble_nasmyth", "camera", None, 1 << 14, [128, 128], TEN),
    Claim {
        scene: LAMP,
        split: None,
        num_rays: 1 << 22,
        pcg_groups: 5,
        sobol_groups: 8,
        map: TEN,
        flux: TEN,
    },
    claim!("bench_lens", "D", None, 1 << 14, [128, 128], TEN),
    claim!("bench_lens", "D", Some((4, 5.0)), 1 << 12, [64, 64], TEN),
    claim!("cooke_triplet", "image", Some((6, 7.0)), 1 << 16, [40, 40], TEN),
    Claim {
        scene: LAMP,
        split: None,
        num_rays: 1 << 14,
        pcg_groups: 8,
        sobol_groups: 8,
        map: AS_GOOD,
        flux: AS_GOOD,
    },
    claim!("lambertian_sphere", "port", None, 1000, [512, 8192], AS_GOOD),
    not_worse!("aspheric_collimator", "collimated", 512, 512),
    not_worse!("ball_lens_ghosts", "near", 512, 512),
    not_worse!("cemented_achromat_auto", "beside", 512, 512),
    not_worse!("cooke_triplet", "image", 512, 512),
    not_worse!("double_gauss", "image", 512, 512),
    not_worse!("erfle_eyepiece", "exit_pupil", 512, 512),
    not_worse!("filter_stack", "behind", 512, 512),
    not_worse!("heliar_ghosts", "image", 512, 2048),
    not_worse!("infrared_triplet_ghosts", "image", 512, 512),
    not_worse!("integrating_sphere", "port", 512, 512),
    not_worse!("kaleidoscope", "eye", 512, 512),
    not_worse!("lambertian_sphere", "port", 512, 16384),
    not_worse!("light_pipe", "exit_map", 512, 512),
    not_worse!("mangin_catadioptric", "focus", 512, 512),
    not_worse!("mesh_lens", "focus", 128, 128),
    not_worse!("mesh_prism", "image", 256, 256),
    not_worse!("mirror_ball_billiard", "slot", 512, 2048),
    not_worse!("nested_media", "front", 512, 512),
    not_worse!("opal_lamp", "down", 512, 2048),
    not_worse!("petzval_projector", "screen", 512, 512),
    not_worse!("prism_spectrometer", "spectrum", 512, 512),
    not_worse!("reverse_telephoto_wide", "image", 512, 1024),
    not_worse!("scattering_telescope", "focus", 512, 512),
    not_worse!("searchlight", "beam", 512, 512),
    not_worse!("split_ghosts", "image", 128, 128),
    not_worse!("stacked_plates_ghosts", "through", 512, 2048),
    not_worse!("tapered_light_guide", "plane", 512, 512),
    not_worse!("telephoto_spectral", "image", 512, 512),
    not_worse!("telescope_doublet_finder", "field_stop", 512, 512),
    not_worse!("tessar_gaussian_beams", "image", 512, 512),
    not_worse!("triplet_telescope_ghosts", "image", 512, 1024),
];

/// A disk shines through a stop onto a map: four dimensions.
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

impl Claim {
    /// The claim with few rays and traces, which is not judged.
    pub fn quick(&self) -> Self {
        Claim {
            num_rays: self.num_rays.min(1 << 10),
            pcg_groups: 6,
            sobol_groups: 6,
            map: None,
            flux: None,
            ..*self
        }
    }

    /// The numbers of traces with random numbers, and with Sobol points.
    pub fn num_traces(&self) -> [u64; 2] {
        [self.pcg_groups, self.sobol_groups].map(|groups| groups * GROUP)
    }

    /// The claim's scene as in its file, splats included.
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

    /// Measures the claim.
    ///
    /// # Errors
    /// The errors of the trace.
    pub fn measure(&self, gpu: &Gpu, precision: Precision) -> Result<Verdict> {
        let ir = self.ir()?;
        let detector = self.scene.detector(&ir)?;
        let options = TraceOptions {
            num_rays: self.num_rays,
            max_depth: self.scene.max_depth,
            precision,
            ..TraceOptions::default()
        };
        let measure = |sampler, standard_error, num_groups, first_seed, flux| {
            let options = TraceOptions { sampler, standard_error, ..options.clone() };
            let mut tracer = Tracer::new(gpu, &ir, &options)?;
            Variances::measure(&mut tracer, (&ir, detector), num_groups, first_seed, flux)
        };
        let pcg = measure(
            Sampler::Pcg,
            StandardError::On,
            self.pcg_groups,
            FIRST_PCG_SEED,
            FluxVariance::BetweenRays,
        )?;
        let (sobol, off) = (Sampler::Sobol, StandardError::Off);
        let sobol = measure(sobol, off, self.sobol_groups, FIRST_SOBOL_SEED, FluxVariance::BetweenTraces)?;
        Ok(Verdict {
            claim: *self,
            map: pcg.ratio_to(&sobol, Quantity::Map),
            flux: pcg.ratio_to(&sobol, Quantity::Flux),
            map_error: pcg.relative_error(Quantity::Map),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_scene_is_held_to_a_claim_on_its_first_map() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
        let names = std::fs::read_dir(folder).unwrap().filter_map(|entry| {
            let name = entry.unwrap().file_name().into_string().unwrap();
            name.strip_suffix(".json").map(str::to_string)
        });
        for name in names.filter(|name| name != "coated_projector") {
            let claims: Vec<&Claim> = CLAIMS.iter().filter(|claim| claim.scene.name == name).collect();
            assert!(!claims.is_empty(), "{name}");
            for claim in claims {
                let ir = claim.ir().unwrap_or_else(|error| panic!("{name}: {error}"));
                let first = ir.detectors.iter().position(|detector| detector.num_cells() > 0).unwrap();
                assert_eq!(claim.scene.detector(&ir).unwrap(), first, "{name}");
            }
        }
    }

    #[test]
    fn nothing_is_claimed_of_what_makes_no_error_and_nothing_holds_that_is_not_known() {
        let ratio = |low| Some(Ratio { low, value: 1.0, high: 2.0 });
        assert!(at_least(ratio(0.96), AS_GOOD) && !at_least(ratio(0.94), AS_GOOD));
        assert!(at_least(None, TEN) && at_least(ratio(0.1), None) && !at_least(ratio(f64::NAN), AS_GOOD));
    }
}
