//! XY polynomials: a conic and powers of x times powers of y.

use crate::Result;
use crate::model::shapes::freeform::Freeform;
use crate::model::shapes::freeform::Polynomial;
pub use crate::model::shapes::freeform::{FREEFORM, FreeformSurface};
use crate::model::shapes::sag::{SagSurface, check_aperture, written};
use crate::model::shapes::{Shape, WrittenShape};
use glam::DVec2;

written! {
    /// A polynomial of x and y in a scene file.
    #[schemars(rename = "Polynomial")]
    pub struct Written {
        /// Semi-diameter \[mm\].
        pub aperture_radius: f64,
        /// `coefficients[i][j]` of x^i y^j; powers up to 31. Rows may differ in length.
        #[serde(default)]
        pub coefficients: Vec<Vec<f64>>,
    }
}

impl WrittenShape for Written {
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        Freeform::check(self.radius, self.conic, self.aperture_radius, &self.coefficients, at)?;
        check_aperture(self.aperture.as_ref(), at)
    }

    fn shape(&self, place: &str, _: Option<usize>) -> Result<Shape> {
        let Written { radius, conic, aperture_radius, coefficients, .. } = self;
        let value = |p: DVec2| {
            let along_y = |row: &Vec<f64>| row.iter().rev().fold(0.0, |sum, c| sum * p.y + c);
            coefficients.iter().rev().fold(0.0, |sum, row| sum * p.x + along_y(row))
        };
        let polynomial = Polynomial::of_rows(coefficients, &[1.0], &value);
        let freeform = Freeform::new(*radius, *conic, *aperture_radius, &polynomial).checked(place)?;
        SagSurface::written(freeform, self.aperture.as_ref(), place).map(Shape::Polynomial)
    }
}
