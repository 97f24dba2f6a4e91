//! The rays of a database as points: by place or by direction.

use crate::error::Result;
use crate::model::photometry;
use crate::result::RayDatabase;
use crate::result::figures::field::Labels;
use crate::result::figures::region::{EncircledEnergy, Region, SpotMoments, encircled_energy};
use glam::DVec3;
use ndarray::Array1;

/// One ray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spot {
    /// Place in the plot.
    pub at: (f64, f64),
    /// The ray's flux \[W or lm\].
    pub flux: f64,
    /// The ray's wavelength \[um\].
    pub wavelength: f64,
    /// The ray's id.
    pub ray_id: u64,
}

/// Rays as points of a plot.
#[derive(Debug, Clone, PartialEq)]
pub struct Spots {
    /// The rays.
    pub spots: Vec<Spot>,
    /// Bounds of x and y, with room around a single point.
    pub bounds: ((f64, f64), (f64, f64)),
    /// Shortest and longest wavelength \[um\].
    pub wavelengths: (f64, f64),
    /// Axes and units.
    pub labels: Labels,
}

/// Figures of rays.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpotFigures {
    /// Rays.
    pub num_rays: u64,
    /// The rays' flux \[W or lm\].
    pub flux: f64,
    /// Centre of the flux.
    pub centroid: (f64, f64),
    /// Root mean square distance from the centroid, weighted by flux.
    pub rms_radius: f64,
    /// Largest distance from the centroid.
    pub largest_radius: f64,
}

impl Spots {
    /// The rays of a database in the detector's own frame: the places where they crossed, or their direction cosines.
    ///
    /// # Errors
    /// [`crate::Error::File`] if the rays lie on disk and cannot be read.
    pub fn new(database: &RayDatabase, directions: bool, photometric: bool) -> Result<Self> {
        let rays = database.columns()?;
        let to_local = database.frame.rotation.transpose();
        let place = |columns: &[Array1<f64>; 3], row: usize| {
            DVec3::from_array([0, 1, 2].map(|axis| columns[axis][row]))
        };
        let points: Vec<(f64, f64)> = if directions {
            let local = |row: usize| to_local * place(&rays.direction, row);
            (0..rays.ray_id.len()).map(local).map(|direction| (direction.x, direction.y)).collect()
        } else {
            let local = |row: usize| to_local * (place(&rays.position, row) - database.frame.origin);
            (0..rays.ray_id.len()).map(local).map(|point| (point.x, point.y)).collect()
        };
        let weight = |wavelength: f64| if photometric { photometry::efficacy(wavelength) } else { 1.0 };
        let spots: Vec<Spot> = points
            .into_iter()
            .zip(&rays.flux)
            .zip(&rays.wavelength)
            .zip(&rays.ray_id)
            .map(|(((at, &flux), &wavelength), &ray_id)| Spot {
                at,
                flux: flux * weight(wavelength),
                wavelength,
                ray_id,
            })
            .collect();
        let (x, y) = if directions { (("L", "1"), ("M", "1")) } else { (("x", "mm"), ("y", "mm")) };
        let flux = if photometric { "lm" } else { "W" };
        Ok(Spots {
            bounds: bounds(&spots),
            wavelengths: range(spots.iter().map(|spot| spot.wavelength)),
            labels: Labels { x, y, value: ("Flux", flux), flux },
            spots,
        })
    }

    /// Figures of the rays in a region, or of all rays.
    pub fn figures(&self, region: Option<&Region>) -> SpotFigures {
        let mut moments = SpotMoments::default();
        let (mut num_rays, mut flux) = (0, 0.0);
        for spot in self.within(region) {
            num_rays += 1;
            flux += spot.flux;
            moments.add(spot.at, spot.flux);
        }
        let centroid = moments.centroid();
        let distance = |spot: &Spot| (spot.at.0 - centroid.0).hypot(spot.at.1 - centroid.1);
        SpotFigures {
            num_rays,
            flux,
            centroid,
            rms_radius: moments.rms_radius(),
            largest_radius: self.within(region).map(distance).fold(0.0, f64::max),
        }
    }

    /// How the flux of the rays in a region, or of all rays, is spread around its centroid.
    pub fn encircled_energy(&self, region: Option<&Region>) -> Option<EncircledEnergy> {
        encircled_energy(self.within(region).map(|spot| (spot.at, spot.flux)))
    }

    fn within(&self, region: Option<&Region>) -> impl Iterator<Item = &Spot> + Clone {
        self.spots.iter().filter(move |spot| region.is_none_or(|region| region.contains(spot.at)))
    }

    /// The ray nearest to a point, if it lies within `reach`.
    pub fn nearest(&self, at: (f64, f64), reach: f64) -> Option<&Spot> {
        let distance = |spot: &Spot| (spot.at.0 - at.0).hypot(spot.at.1 - at.1);
        let nearest = self.spots.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)));
        nearest.filter(|spot| distance(spot) <= reach)
    }
}

fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)))
}

fn bounds(spots: &[Spot]) -> ((f64, f64), (f64, f64)) {
    let x = range(spots.iter().map(|spot| spot.at.0));
    let y = range(spots.iter().map(|spot| spot.at.1));
    let span = (x.1 - x.0).max(y.1 - y.0);
    if spots.is_empty() {
        return ((-1.0, 1.0), (-1.0, 1.0));
    }
    let scale = x.0.abs().max(x.1.abs()).max(y.0.abs()).max(y.1.abs());
    let least = if scale > 0.0 { 1e-6 * scale } else { 1.0 };
    let grown = |(low, high): (f64, f64)| {
        let pad = (0.04 * span).max(least);
        (low - pad, high + pad)
    };
    (grown(x), grown(y))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Frame;
    use crate::result::RayColumns;
    use crate::result::detectors::ray_database::RecordedRays;
    use crate::result::figures::region::RegionOutline;
    use glam::DMat3;
    use ndarray::array;

    /// Four rays at the corners of a square in the detector's plane, which faces along global x.
    fn database() -> RayDatabase {
        let frame = Frame {
            origin: DVec3::new(100.0, 0.0, 0.0),
            rotation: DMat3::from_cols(DVec3::Y, DVec3::Z, DVec3::X),
        };
        let columns = RayColumns {
            ray_id: array![1, 2, 3, 4],
            position: [
                Array1::from_elem(4, 100.0),
                array![1.0, -1.0, -1.0, 1.0],
                array![2.0, 2.0, -2.0, -2.0],
            ],
            direction: [array![0.6, 0.6, 1.0, 1.0], array![0.8, 0.0, 0.0, 0.0], array![0.0, 0.8, 0.0, 0.0]],
            flux: array![1.0, 1.0, 1.0, 1.0],
            wavelength: array![0.5, 0.6, 0.5, 1.5],
        };
        let recorded = RecordedRays { num_rays: 4, kept_flux: 4.0, recorded_flux: 4.0 };
        RayDatabase::of_columns(frame, &columns, recorded).unwrap()
    }

    #[test]
    fn rays_stand_in_the_frame_of_the_detector() {
        let spots = Spots::new(&database(), false, false).unwrap();
        assert_eq!(spots.spots[0].at, (1.0, 2.0));
        let figures = spots.figures(None);
        assert_eq!((figures.num_rays, figures.flux, figures.centroid), (4, 4.0, (0.0, 0.0)));
        assert_eq!((figures.rms_radius, figures.largest_radius), (5f64.sqrt(), 5f64.sqrt()));
        let right = Region { outline: RegionOutline::Rectangle, centre: (1.0, 0.0), half: (0.5, 3.0) };
        assert_eq!(spots.figures(Some(&right)).rms_radius, 2.0);
        assert_eq!(spots.nearest((0.9, 2.1), 0.5).map(|spot| spot.ray_id), Some(1));
        assert_eq!(spots.nearest((0.0, 0.0), 0.5), None);
    }

    #[test]
    fn directions_are_cosines_along_the_axes_of_the_detector() {
        let spots = Spots::new(&database(), true, false).unwrap();
        assert_eq!(spots.spots[0].at, (0.8, 0.0));
        assert_eq!(spots.spots[1].at, (0.0, 0.8));
    }

    #[test]
    fn what_the_eye_does_not_see_weighs_nothing() {
        let spots = Spots::new(&database(), false, true).unwrap();
        assert_eq!(spots.spots[3].flux, 0.0);
        assert_eq!(spots.spots[0].flux, photometry::efficacy(0.5));
    }
}
