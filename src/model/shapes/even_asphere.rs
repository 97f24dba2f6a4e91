//! Even aspheres: a conic and even powers of the distance from the axis.

use crate::Result;
use crate::model::shapes::profile::AsphereProfile;
use crate::model::shapes::sag::{SagSurface, check_aperture, written};
use crate::model::shapes::{Normal, Shape, ShapeWgsl, WrittenShape};
use crate::shaders::shader;

/// The surface.
pub type EvenAsphere = SagSurface<AsphereProfile>;

/// The asphere: z = conic + the sum of coefficients\[i\] r^(2 i + 2).
pub const EVEN_ASPHERE: ShapeWgsl = ShapeWgsl {
    name: "even_asphere",
    file: shader!("shapes/even_asphere.wgsl"),
    num_arguments: 20,
    normal: Normal::Sag,
};

written! {
    /// An even asphere in a scene file.
    #[schemars(rename = "EvenAsphere")]
    pub struct Written {
        /// Semi-diameter \[mm\].
        pub aperture_radius: f64,
        /// Coefficients of r^2, r^4, r^6 and so on, up to ten.
        #[serde(default)]
        pub coefficients: Vec<f64>,
    }
}

impl WrittenShape for Written {
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        AsphereProfile::check(self.radius, self.conic, self.aperture_radius, &self.coefficients, at)?;
        check_aperture(self.aperture.as_ref(), at)
    }

    fn shape(&self, place: &str, _: Option<usize>) -> Result<Shape> {
        let Written { radius, conic, aperture_radius, ref coefficients, ref aperture } = *self;
        let profile = AsphereProfile::new(radius, conic, aperture_radius, 2, coefficients);
        SagSurface::written(profile, aperture.as_ref(), place).map(Shape::EvenAsphere)
    }
}
