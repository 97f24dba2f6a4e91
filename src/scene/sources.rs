//! Sources as scene files give them -> how their rays are born.

use crate::model::{CollimatedGaussian, CollimatedTophat, Extended, Outline, Point, SourceKind};
use crate::scene::json::{Profile, Source};

/// How the rays of a source are born.
pub(crate) fn kind_of(source: &Source) -> SourceKind {
    match source {
        Source::Point(point) => SourceKind::Point(Point { half_angle: point.half_angle_deg.to_radians() }),
        Source::Collimated(beam) => {
            let aperture_radius = beam.aperture_radius;
            match beam.profile {
                Profile::Tophat => SourceKind::CollimatedTophat(CollimatedTophat { aperture_radius }),
                Profile::Gaussian => {
                    let sigma = beam.gaussian_sigma.unwrap_or(aperture_radius / 2.0);
                    SourceKind::CollimatedGaussian(CollimatedGaussian { aperture_radius, sigma })
                }
            }
        }
        Source::Extended(area) => SourceKind::Extended(Extended {
            area: match area.aperture_radius {
                Some(radius) => Outline::Disk { radius },
                None => Outline::Rectangle { width: area.width, height: area.height },
            },
            half_angle: area.half_angle_deg.to_radians(),
        }),
    }
}
