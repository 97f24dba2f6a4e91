//! What a scene needs of the tracer. Whatever is absent here produces no code.

use crate::model::primitives::primitives;
use crate::model::shapes::Normal;
use crate::model::surface_optics::{least_share, splits};
use crate::model::{
    BsdfKind, Coating, DetectorFunction, Interaction, Medium, ReflectProb, SceneIr, ShapeKind,
    SourceFunction, Splat,
};
use crate::program::layout::bsdf;

/// What the scene and the options of the trace need.
#[derive(Debug, Clone, PartialEq)]
pub struct Features {
    /// Shapes of surfaces and detectors.
    pub shapes: Vec<ShapeKind>,
    /// Some source has rays that are aimed.
    pub aimed: bool,
    /// Some surface has an aperture that is no disk about the axis.
    pub clips: bool,
    /// Some surface refracts.
    pub refractive: bool,
    /// Some surface reflects.
    pub reflective: bool,
    /// Some surface is coated.
    pub coated: bool,
    /// Some coating depends on the angle; then all are tables.
    pub tabulated_coatings: bool,
    /// The reflectance of some mirror, or what a coating that is no table does, depends on the wavelength.
    pub spectral_reflectance: bool,
    /// Kinds of BSDFs, without repetition.
    pub bsdfs: Vec<BsdfKind>,
    /// Some BSDF scatters to the far side.
    pub transmissive_lobes: bool,
    /// Some surface scatters towards targets.
    pub scatters_to: bool,
    /// More than one wavelength.
    pub polychromatic: bool,
    /// Some medium absorbs.
    pub bulk_absorption: bool,
    /// Branches are not drawn with their own probability.
    pub importance: bool,
    /// Rays are split at refractive surfaces.
    pub splits: bool,
    /// Some weight can fall below the threshold of roulette.
    pub roulette: bool,
    /// Rays keep the weight that they are born with.
    pub keeps_weight: bool,
    /// They do, and detectors sum it whole.
    pub whole_weights: bool,
    /// Every surface that turns rays has a gradient of unit length on it (spheres, planes).
    pub unit_gradients: bool,
    /// The tip of a cone belongs to some surface.
    pub tips: bool,
    /// Splats of irradiance and spectral detectors: hard, bilinear, Gaussian.
    pub splats: [bool; 3],
    /// The largest radius of a Gaussian splat \[pixels\].
    pub splat_radius: u32,
    /// Some detector lets rays pass.
    pub transmissive: bool,
    /// Functions of detectors, without repetition.
    pub detectors: Vec<DetectorFunction>,
    /// Kinds of sources, without repetition.
    pub sources: Vec<SourceFunction>,
}

/// True if every surface that turns rays has a gradient of unit length on it.
pub(crate) fn has_unit_gradients(ir: &SceneIr) -> bool {
    let turning = ir.surfaces.iter().filter(|s| !matches!(s.interaction, Interaction::Absorbing));
    turning.filter_map(|s| s.shape.quadric()).all(|quadric| quadric.has_unit_gradient())
}

impl Features {
    /// Derives the features of a scene. The rays of its sources are born with `weights`, and roulette plays below
    /// `roulette_threshold`. Both are in units of the mean weight of a new ray. A ray has at most `max_depth` events.
    pub fn of(ir: &SceneIr, weights: &[f64], roulette_threshold: f64, max_depth: u32) -> Self {
        let lowest_birth_weight = weights.iter().copied().fold(f64::INFINITY, f64::min);
        let primitives = primitives(ir);
        let shapes = ShapeKind::among(primitives.iter().map(|(_, shape)| shape));
        let sources = SourceFunction::distinct(ir.sources.iter().map(|source| source.kind.kind()));
        let detectors =
            DetectorFunction::distinct(ir.detectors.iter().map(|detector| detector.kind.function()));
        let reflectances = || {
            ir.surfaces.iter().filter_map(|s| match &s.interaction {
                Interaction::Reflective { reflectance } => Some(reflectance),
                Interaction::Refractive | Interaction::Absorbing => None,
            })
        };
        let bulk_absorption = ir.allowed.absorbing || ir.media.iter().any(Medium::absorbs);
        let refractive = ir.surfaces.iter().any(|s| s.interaction == Interaction::Refractive);
        let importance = ir.sampling.reflect_prob != ReflectProb::Fresnel && refractive;
        let splits = splits(ir);
        let bsdfs = bsdf::kinds(ir);
        let coatings = || ir.surfaces.iter().filter_map(|s| s.coating.as_ref());
        let tabulated_coatings = coatings().any(Coating::is_tabulated);
        let is_unbounded = bulk_absorption || importance || splits || !bsdfs.is_empty() || tabulated_coatings;
        let least_share = if is_unbounded { 0.0 } else { least_share(ir) };
        let loses_weight =
            is_unbounded || reflectances().flatten().any(|&r| r != 1.0) || coatings().next().is_some();
        let lowest_weight = lowest_birth_weight * (ROUNDED_DOWN * least_share).powf(max_depth.into());
        let is_spectral = |values: &Vec<f64>| values.iter().any(|&value| value != values[0]);
        let grids: Vec<Splat> = ir.detectors.iter().filter_map(|s| s.kind.grid().map(|g| g.splat)).collect();
        let roulette =
            lowest_birth_weight < roulette_threshold || loses_weight && lowest_weight < roulette_threshold;
        let keeps_weight = !loses_weight && !roulette;
        Features {
            shapes,
            aimed: ir.sources.iter().any(|source| source.kind.is_aimed()),
            clips: ir.surfaces.iter().any(|surface| surface.shape.is_clipped()),
            refractive,
            reflective: reflectances().next().is_some(),
            coated: coatings().next().is_some(),
            tabulated_coatings,
            spectral_reflectance: reflectances().any(is_spectral)
                || coatings()
                    .filter_map(|coating| coating.simple().filter(|_| !tabulated_coatings))
                    .any(|c| is_spectral(&c.reflectance) || is_spectral(&c.transmittance)),
            bsdfs,
            transmissive_lobes: bsdf::scatters(ir).any(|s| s.bsdf.transmissive_fraction() > 0.0),
            scatters_to: ir.scatter_sampling.iter().any(|sampling| !sampling.targets.is_empty()),
            polychromatic: ir.wavelengths.len() > 1,
            bulk_absorption,
            importance,
            splits,
            roulette,
            keeps_weight,
            whole_weights: keeps_weight && grids.iter().all(|splat| *splat == Splat::Hard),
            unit_gradients: !ir.allowed.conic && has_unit_gradients(ir),
            tips: ir.surfaces.iter().any(|s| s.shape.tip().is_some()),
            splats: [
                grids.contains(&Splat::Hard),
                grids.contains(&Splat::Bilinear),
                grids.iter().any(|s| matches!(s, Splat::Gaussian { .. })),
            ],
            splat_radius: grids.iter().map(|splat| splat.radius()).max().unwrap_or(0),
            transmissive: ir.detectors.iter().any(|s| !s.absorb),
            detectors,
            sources,
        }
    }

    /// The same where an addition draws branches and scattering, if it does.
    #[must_use]
    pub fn with_branches_drawn(self, by_addition: bool) -> Self {
        let has_choices = self.refractive || !self.bsdfs.is_empty();
        let importance = self.importance || by_addition && has_choices;
        let keeps_weight = self.keeps_weight && !importance;
        Features { importance, keeps_weight, whole_weights: self.whole_weights && keeps_weight, ..self }
    }

    /// What rays meet depends on the table of media: on its indices, where wavelengths differ, or its absorption.
    pub fn reads_media(&self) -> bool {
        self.refractive && self.polychromatic || self.bulk_absorption
    }

    /// True if some detector stores rays.
    pub fn stores_rays(&self) -> bool {
        self.detectors.iter().any(|function| function.stores_rays())
    }

    /// True if some detector reads the table of wavelength bins.
    pub fn reads_bins(&self) -> bool {
        self.detectors.iter().any(|function| function.reads_bins())
    }

    /// True if some detector calls the function of another one, which no detector has.
    pub fn borrows(&self, function: DetectorFunction) -> bool {
        use DetectorFunction::{ApartFarField, ApartSphere, FarField, FarFieldSphere};
        let borrowers: &[DetectorFunction] = if function == FarField {
            &[FarFieldSphere, ApartFarField, ApartSphere]
        } else if function == FarFieldSphere {
            &[ApartSphere]
        } else {
            &[]
        };
        !self.detectors.contains(&function) && borrowers.iter().any(|other| self.detectors.contains(other))
    }

    /// True if some source has rays that the host uploads before each dispatch.
    pub fn uploads_rays(&self) -> bool {
        self.sources.contains(&SourceFunction::StreamedRays)
    }

    /// True if directions are drawn by tables over two angles.
    pub fn has_polar_tables(&self) -> bool {
        self.sources.contains(&SourceFunction::Tabulated) || self.bsdfs.contains(&BsdfKind::Measured)
    }

    /// True if some shape, source, BSDF, target of scattering or coating reads a table.
    pub fn has_tables(&self) -> bool {
        self.clips
            || self.scatters_to
            || self.aimed
            || self.sources.contains(&SourceFunction::Tabulated)
            || self.sources.contains(&SourceFunction::Rays)
            || self.uploads_rays()
            || self.shapes.contains(&ShapeKind::Freeform)
            || self.tabulated_coatings
            || self.bsdfs.iter().any(|kind| kind.has_table())
    }
}

impl Features {
    /// True if some surface is a triangle mesh.
    pub fn has_meshes(&self) -> bool {
        self.shapes.iter().any(|kind| kind.is_searched())
    }

    /// True if some shape has a function for its normal.
    pub fn has_own_normals(&self) -> bool {
        self.shapes.iter().any(|kind| kind.has_own_normal())
    }

    /// True if the functions of some shape ask for its aperture.
    pub fn can_clip(&self) -> bool {
        self.clips || self.has_sags()
    }

    /// True if crossings of some shape are searched along the ray.
    pub fn has_sags(&self) -> bool {
        self.shapes.iter().any(|kind| matches!(kind.wgsl().normal, Normal::Sag))
    }

    /// True if every shape is a part of a quadric.
    pub fn has_quadrics_alone(&self) -> bool {
        self.shapes.iter().all(|kind| kind.is_quadric())
    }
}

/// More than f32 takes from a share and from its product with a weight by rounding.
const ROUNDED_DOWN: f64 = 1.0 - 1.0 / (1 << 20) as f64;

#[cfg(test)]
mod tests {
    use super::*;

    const MIRRORS: &str = r#"{
        "nsq_schema_version": 1,
        "components": [
            {"type": "mirror", "name": "M", "cs": {"z": 50.0}, "config": {"radius": Infinity, "reflectance": 0.98, "aperture_radius": 20.0}},
            {"type": "mirror", "name": "N", "cs": {"z": -50.0}, "config": {"radius": Infinity, "reflectance": 0.0, "aperture_radius": 20.0}}
        ],
        "sources": [{"type": "collimated", "name": "S", "cs": {}, "spectrum": {"wavelengths": [0.55], "weights": [1.0]},
            "total_flux": 1.0, "aperture_radius": 3.0}],
        "detectors": [{"type": "irradiance", "name": "D", "cs": {"z": 25.0}, "width": 12.0, "height": 12.0,
            "num_pixels_x": 4, "num_pixels_y": 4, "absorb": false}]
    }"#;

    fn has_roulette(ir: &SceneIr, weight: f64, threshold: f64, max_depth: u32) -> bool {
        Features::of(ir, &[1.0, weight], threshold, max_depth).roulette
    }

    #[test]
    fn roulette_is_left_out_where_no_ray_can_fall_below_its_threshold() {
        let mut ir = crate::Scene::from_json(MIRRORS).unwrap().lower().unwrap();
        // 0.98^341 > 1e-3 > 0.98^342; what the other mirror leaves is nothing, and so none of roulette's.
        for (weight, threshold, max_depth, expected) in [
            (1.0, 1e-3, 341, false),
            (1.0, 1e-3, 342, true),
            (0.5, 1e-3, 341, true),
            (0.5, 1e-3, 16, false),
            (1e-4, 1e-3, 16, true),
            (1.0, 0.0, 1 << 20, false),
        ] {
            let found = has_roulette(&ir, weight, threshold, max_depth);
            assert_eq!(found, expected, "weight {weight}, threshold {threshold}, {max_depth} events");
        }
        ir.media[0].k[0] = 1e-9;
        assert!(has_roulette(&ir, 1.0, 1e-3, 16), "a way through a medium has no least share");
    }

    #[test]
    fn weights_that_are_all_born_below_the_threshold_keep_it() {
        let mut ir = crate::Scene::from_json(MIRRORS).unwrap().lower().unwrap();
        ir.surfaces.clear();
        assert!(has_roulette(&ir, 1e-4, 1e-3, 16));
        assert!(!has_roulette(&ir, 1e-3, 1e-3, 16), "only below the threshold");
    }
}
