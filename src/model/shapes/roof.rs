//! A roof, the example of docs/adding-a-kind.md: a shape that is neither a quadric nor of revolution. Tests alone have it.

use crate::Result;
use crate::model::checks;
use crate::model::mesh::Mesh;
use crate::model::shapes::{Extent, Geometry, Level, Normal, Shape, ShapeKind, ShapeWgsl, WrittenShape};
use crate::shaders::ShaderFile;
use glam::{DMat3, DVec3};
use schemars::JsonSchema;
use serde::Deserialize;

/// The roof.
pub const ROOF: ShapeWgsl = ShapeWgsl {
    name: "roof",
    file: ShaderFile {
        path: "../tests/fixtures/roof.wgsl",
        text: include_str!("../../../tests/fixtures/roof.wgsl"),
    },
    num_arguments: 3,
    normal: Normal::Own,
};

/// The two planes z = slope |x| where |x| <= width/2 and |y| <= height/2, the normal to the side of larger z.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Roof {
    /// Rise of each plane; 1 for a right angle between the planes.
    pub slope: f64,
    /// Full width along local x \[mm\].
    pub width: f64,
    /// Full height along local y \[mm\].
    pub height: f64,
}

impl Roof {
    fn corners(&self) -> [[DVec3; 3]; 2] {
        let [x, y] = [0.5 * self.width, 0.5 * self.height];
        let z = self.slope * x;
        [-y, y].map(|y| [DVec3::new(-x, y, z), DVec3::new(0.0, y, 0.0), DVec3::new(x, y, z)])
    }
}

/// In a scene file the same.
pub type Written = Roof;

impl WrittenShape for Roof {
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        checks::between(at("slope"), self.slope, 0.0, 100.0)?;
        checks::size(at("width"), self.width)?;
        checks::size(at("height"), self.height)
    }

    fn shape(&self, _: &str, _: Option<usize>) -> Result<Shape> {
        Ok(Shape::Roof(*self))
    }
}

impl Geometry for Roof {
    fn kind(&self) -> ShapeKind {
        ShapeKind::Roof
    }

    fn arguments(&self) -> Vec<f64> {
        vec![self.slope, 0.5 * self.width, 0.5 * self.height]
    }

    fn level(&self, p: DVec3) -> Option<Level> {
        let gradient = DVec3::new(-self.slope * p.x.signum(), 0.0, 1.0);
        Some(Level { value: p.z - self.slope * p.x.abs(), gradient, hessian: DMat3::ZERO })
    }

    fn holds(&self, p: DVec3) -> bool {
        p.x.abs() <= 0.5 * self.width && p.y.abs() <= 0.5 * self.height
    }

    fn extent(&self, _: &[Mesh]) -> Option<Extent> {
        let corners = self.corners();
        let corners = || corners.as_flattened().iter().copied();
        Some(Extent::block(corners().reduce(DVec3::min)?, corners().reduce(DVec3::max)?))
    }

    fn samples(&self) -> Vec<DVec3> {
        self.corners().as_flattened().to_vec()
    }

    fn edges(&self, _: &[Mesh]) -> Vec<Vec<DVec3>> {
        let [[a, b, c], [d, e, f]] = self.corners();
        vec![vec![a, b, c, f, e, d, a], vec![b, e]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{AdapterChoice, Gpu};
    use crate::model::{Point, SceneIr, SourceKind};
    use crate::program::Precision;
    use crate::program::geometry::contact::Contacts;
    use crate::result::Tally;
    use crate::{Scene, TraceOptions, Tracer};

    /// A beam at x = 2.5 goes down into a roof, whose planes turn it to x = -2.5 and back up to a detector.
    fn retroreflector() -> SceneIr {
        let text = r#"{
            "nsq_schema_version": 1,
            "sources": [{"type": "collimated", "name": "S", "cs": {"x": 2.5, "z": 120.0, "rx": 3.141592653589793},
                "spectrum": {"wavelengths": [0.55], "weights": [1.0]}, "total_flux": 1.0, "aperture_radius": 0.4}],
            "detectors": [{"type": "irradiance", "name": "D", "cs": {"z": 130.0}, "width": 8.0, "height": 8.0,
                "num_pixels_x": 8, "num_pixels_y": 1}],
            "nsq_gpu": {"version": 1, "surfaces": [{"name": "R", "cs": {"z": 100.0}, "interaction": "reflective",
                "reflectance": 0.9, "shape": {"type": "roof", "slope": 1.0, "width": 10.0, "height": 6.0}}]}
        }"#;
        Scene::from_json(text).unwrap().lower().unwrap()
    }

    /// Tallies of 1000 rays by all ways in which shapes are searched, in all precisions.
    fn traced(ir: &SceneIr) -> Vec<Tally> {
        let gpu = Gpu::open(&AdapterChoice::default()).unwrap();
        let ways = [(true, false), (false, false), (false, true)];
        let all = ways.into_iter().flat_map(|way| {
            [Precision::F32, Precision::Df64, Precision::F64].map(|precision| (way, precision))
        });
        let trace = |((baked, tree), precision)| {
            let num_rays = 1000;
            let options = TraceOptions {
                num_rays,
                precision,
                baked: Some(baked),
                tree: Some(tree),
                ..TraceOptions::default()
            };
            Tracer::new(&gpu, ir, &options).unwrap().trace(|_| true).unwrap()
        };
        all.map(trace).collect()
    }

    #[test]
    fn a_shape_that_is_no_quadric_is_traced_where_its_planes_are() {
        for tally in traced(&retroreflector()) {
            let detector = &tally.detectors[0];
            assert_eq!(detector.hits, [0, 1000, 0, 0, 0, 0, 0, 0]);
            let share = detector.quanta.iter().sum::<u128>() as f64 / tally.launched.quanta as f64;
            assert!((share - 0.81).abs() < 1e-6, "two mirrors of 0.9 leave {share}");
        }
    }

    #[test]
    fn rays_leave_a_shape_that_is_no_quadric_where_they_are_born_on_it() {
        let mut ir = retroreflector();
        ir.sources[0].kind = SourceKind::Point(Point { half_angle: 1e-3 });
        ir.sources[0].frame.origin = DVec3::new(2.3, 0.1, 102.3);
        ir.sources[0].frame.rotation = DMat3::IDENTITY;
        let contacts = Contacts::of(&ir, DVec3::new(0.1, 0.2, 77.7), Precision::F32).unwrap();
        assert_eq!(contacts.born_on, [true, false]);
        for tally in traced(&ir) {
            assert_eq!(tally.detectors[0].hits, [0, 0, 0, 0, 0, 0, 1000, 0]);
        }
    }

    #[test]
    fn two_roofs_in_one_place_are_in_contact() {
        let mut ir = retroreflector();
        ir.surfaces.push(ir.surfaces[0].clone());
        let contacts = Contacts::of(&ir, DVec3::ZERO, Precision::F32).unwrap();
        assert!(contacts.touches(0) && contacts.touches(1));
        for tally in traced(&ir) {
            assert_eq!(tally.detectors[0].hits, [0, 1000, 0, 0, 0, 0, 0, 0], "both are one mirror");
        }
    }
}
