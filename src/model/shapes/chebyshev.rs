//! Chebyshev surfaces: a conic and products of Chebyshev polynomials of x and y.

use crate::Result;
use crate::model::shapes::freeform::Freeform;
pub use crate::model::shapes::freeform::FreeformSurface;
use crate::model::shapes::freeform::{Polynomial, clenshaw};
use crate::model::shapes::sag::{SagSurface, check_aperture, written};
use crate::model::shapes::{Shape, WrittenShape};
use glam::DVec2;

written! {
    /// A Chebyshev surface in a scene file.
    #[schemars(rename = "Chebyshev")]
    pub struct Written {
        /// Semi-diameter \[mm\], at most `norm_x` and `norm_y`.
        pub aperture_radius: f64,
        /// `coefficients[i][j]` of T_i(x / norm_x) T_j(y / norm_y) \[mm\]; orders up to 31.
        #[serde(default)]
        pub coefficients: Vec<Vec<f64>>,
        /// What x is divided by \[mm\].
        pub norm_x: f64,
        /// What y is divided by \[mm\].
        pub norm_y: f64,
    }
}

impl WrittenShape for Written {
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        Freeform::check(self.radius, self.conic, self.aperture_radius, &self.coefficients, at)?;
        Freeform::check_norm("norm_x", self.norm_x, self.aperture_radius, at)?;
        Freeform::check_norm("norm_y", self.norm_y, self.aperture_radius, at)?;
        check_aperture(self.aperture.as_ref(), at)
    }

    fn shape(&self, place: &str, _: Option<usize>) -> Result<Shape> {
        let Written { radius, conic, aperture_radius, coefficients, norm_x, norm_y, .. } = self;
        let value = |p: DVec2| {
            let along_y = |row: &Vec<f64>| clenshaw(row.iter().copied(), p.y / norm_y);
            clenshaw(coefficients.iter().map(along_y), p.x / norm_x)
        };
        let polynomial = Polynomial::of_rows(coefficients, &[2.0, *norm_x, *norm_y], &value);
        let freeform = Freeform::new(*radius, *conic, *aperture_radius, &polynomial).checked(place)?;
        SagSurface::written(freeform, self.aperture.as_ref(), place).map(Shape::Chebyshev)
    }
}
