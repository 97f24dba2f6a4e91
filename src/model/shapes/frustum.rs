//! A cone or a cylinder without its ends: edges of lenses, tubes, light guides.

use crate::Result;
use crate::model::checks;
use crate::model::mesh::Mesh;
use crate::model::shapes::{
    Extent, FrontSide, Geometry, Normal, Quadric, Shape, ShapeKind, ShapeWgsl, Slab, WrittenShape,
    ring_samples,
};
use crate::shaders::shader;
use glam::{DVec2, DVec3};
use schemars::JsonSchema;
use serde::Deserialize;

/// The cone.
pub const FRUSTUM: ShapeWgsl = ShapeWgsl {
    name: "frustum",
    file: shader!("shapes/frustum.wgsl"),
    num_arguments: 4,
    normal: Normal::Quadric(|a| format!("frustum_quadric({}, {})", a[0], a[1])),
};

/// A cone whose apex is so many times farther than its ends are wide is left without a box: its quadric cancels.
const FARTHEST_APEX: f64 = 8.0;

/// The cone or cylinder of radius r_front at z_front and r_back at z_back, its normal outward.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Frustum {
    /// Radius at z_front \[mm\].
    pub r_front: f64,
    /// Radius at z_back \[mm\].
    pub r_back: f64,
    /// Lower end along local z \[mm\].
    pub z_front: f64,
    /// Upper end along local z \[mm\].
    pub z_back: f64,
}

impl Frustum {
    /// Radius at z = 0, slope, z_front, z_back. A frustum of no height has an empty range of z, so rays miss it.
    fn line(&self) -> [f64; 4] {
        let Frustum { r_front, r_back, z_front, z_back } = *self;
        let height = z_back - z_front;
        if height.abs() < 1e-15 {
            return [r_front, 0.0, 1.0, -1.0];
        }
        let slope = (r_back - r_front) / height;
        [r_front - slope * z_front, slope, z_front, z_back]
    }

    /// Radius and height, a share of the way from the front to the back.
    fn at(&self, share: f64) -> (f64, f64) {
        let Frustum { r_front, r_back, z_front, z_back } = *self;
        (r_front + share * (r_back - r_front), z_front + share * (z_back - z_front))
    }
}

/// In a scene file the same.
pub type Written = Frustum;

impl WrittenShape for Frustum {
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        let Frustum { r_front, r_back, z_front, z_back } = *self;
        checks::between(at("r_front"), r_front, 0.0, checks::MAX_LENGTH)?;
        checks::between(at("r_back"), r_back, 0.0, checks::MAX_LENGTH)?;
        checks::size(at("r_front"), r_front.max(r_back))?;
        checks::position(at("z_front"), z_front)?;
        checks::position(at("z_back"), z_back)?;
        if z_front < z_back {
            return Ok(());
        }
        checks::refuse(at("z_back"), "the frustum has no height", "give z_front < z_back")
    }

    fn shape(&self, _: &str, _: Option<usize>) -> Result<Shape> {
        Ok(Shape::Frustum(*self))
    }
}

impl Geometry for Frustum {
    fn kind(&self) -> ShapeKind {
        ShapeKind::Frustum
    }

    fn front_side(&self) -> FrontSide {
        FrontSide::Inside
    }

    fn arguments(&self) -> Vec<f64> {
        self.line().to_vec()
    }

    fn quadric(&self) -> Option<Quadric> {
        let [r0, slope, ..] = self.line();
        Some(Quadric { radial: 1.0, axial: -slope * slope, offset: -slope * r0, constant: -r0 * r0 })
    }

    fn holds(&self, p: DVec3) -> bool {
        /// A ray through the rim is inside either the frustum or the face that it ends on \[mm\].
        const Z_SLACK: f64 = 1e-9;
        let [_, _, low, high] = self.line();
        (low - Z_SLACK..=high + Z_SLACK).contains(&p.z)
    }

    fn extent(&self, _: &[Mesh]) -> Option<Extent> {
        let Frustum { r_front, r_back, z_front, z_back } = *self;
        let radius = r_front.max(r_back);
        let (low, high) = (z_front.min(z_back), z_front.max(z_back));
        let slope = (r_back - r_front) / (z_back - z_front);
        let at_origin = (r_front - slope * z_front).abs();
        let size = match at_origin <= FARTHEST_APEX * radius {
            true => FARTHEST_APEX * FARTHEST_APEX * radius + low.abs().max(high.abs()),
            false => f64::INFINITY,
        };
        Some(Extent::round(radius, low, high, size))
    }

    fn samples(&self) -> Vec<DVec3> {
        ring_samples(&[0.1, 0.5, 0.9].map(|share| self.at(share)))
    }

    fn rims(&self) -> Vec<(f64, f64)> {
        vec![(self.r_front, self.z_front), (self.r_back, self.z_back)]
    }

    fn section(&self) -> Vec<Vec<DVec2>> {
        let side = |sign: f64| {
            vec![DVec2::new(sign * self.r_front, self.z_front), DVec2::new(sign * self.r_back, self.z_back)]
        };
        vec![side(1.0), side(-1.0)]
    }

    fn slab(&self) -> Option<Slab> {
        Some(Slab { ends: [self.z_front, self.z_back], steepness: None })
    }

    fn opening(&self) -> Option<f64> {
        Some(self.r_front.min(self.r_back))
    }

    fn coincides(&self, other: &Shape) -> bool {
        matches!(other, Shape::Frustum(other) if other == self)
    }

    fn tip(&self) -> Option<f64> {
        let Frustum { r_front, r_back, .. } = *self;
        (r_front == 0.0 || r_back == 0.0).then_some(if r_front < r_back { -1.0 } else { 1.0 })
    }
}
