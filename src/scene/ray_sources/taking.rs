//! What a source makes of the rays of its file: their wavelengths, places and shares of the light.

use crate::format::significant;
use crate::model::photometry;
use crate::model::sources::rays::{Order, StreamedRay, Written};
use crate::scene::ray_files::{self, FluxKind, Header, Wavelengths};

/// A ray's wavelength is put to the nearest one of the source's spectrum, if that is so near \[um\].
const FARTHEST: f64 = 0.025;

/// What is wrong with the file, or with what the scene says of it.
pub(super) enum Refusal {
    OfFile(ray_files::Error),
    OfScene(String, String),
}

impl From<ray_files::Error> for Refusal {
    fn from(error: ray_files::Error) -> Self {
        Refusal::OfFile(error)
    }
}

/// What a source makes of the rays of its file.
#[derive(Debug)]
pub(super) struct Taking {
    pub(super) order: Order,
    /// The wavelengths that rays are put to \[um\]; one none if rays have no wavelengths of their own.
    pub(super) wavelengths: Vec<Option<f64>>,
    /// Rays have a flux in lm, and wavelengths of their own.
    pub(super) is_luminous: bool,
    scale: f64,
}

/// A ray of a file, as the source has it.
pub(super) struct Taken {
    /// The number of its wavelength in the list.
    pub(super) number: usize,
    /// How far its own wavelength is from the listed one \[um\].
    pub(super) off: f64,
    pub(super) ray: StreamedRay,
}

impl Taking {
    pub(super) fn of(written: &Written, header: &Header) -> Self {
        let by_wavelength = matches!(header.wavelengths, Wavelengths::PerRay | Wavelengths::One(_));
        let wavelengths = match by_wavelength {
            true => written.spectrum.wavelengths.iter().copied().map(Some).collect(),
            false => vec![None],
        };
        // A file that does not say W or lm has what the scene says.
        let kind = header.flux_kind.or(written.total_flux_lumens.map(|_| FluxKind::Luminous));
        let is_luminous = by_wavelength && kind == Some(FluxKind::Luminous);
        Taking { order: written.order, wavelengths, is_luminous, scale: written.scale }
    }

    pub(super) fn is_by_wavelength(&self) -> bool {
        self.wavelengths.iter().all(Option::is_some)
    }

    /// The share of the light that a ray has, in any unit.
    pub(super) fn share(
        &self,
        number: u64,
        flux: f64,
        wavelength: Option<f64>,
    ) -> std::result::Result<f64, Refusal> {
        if !self.is_luminous || flux == 0.0 {
            return Ok(flux);
        }
        let (_, wavelength, _) = self.nearest(number, wavelength)?;
        let efficacy = wavelength.map_or(0.0, photometry::efficacy);
        if photometry::is_visible(efficacy) {
            return Ok(flux / efficacy);
        }
        Err(Refusal::OfScene(
            format!("ray {number} has a flux in lm, and nobody sees light of its wavelength"),
            "name a file whose flux is in W".into(),
        ))
    }

    /// What a ray becomes.
    pub(super) fn ray(&self, number: u64, ray: &ray_files::Ray) -> std::result::Result<Taken, Refusal> {
        let (nearest, wavelength, off) = self.nearest(number, ray.wavelength)?;
        let position = ray.position.map(|x| x * self.scale);
        let ray = StreamedRay { wavelength, position, direction: ray.direction };
        Ok(Taken { number: nearest, off, ray })
    }

    /// The number of a ray's wavelength in the list, the listed wavelength, and how far it is from the ray's own \[um\].
    fn nearest(
        &self,
        number: u64,
        own: Option<f64>,
    ) -> std::result::Result<(usize, Option<f64>, f64), Refusal> {
        let Some(own) = own.filter(|_| self.is_by_wavelength()) else { return Ok((0, None, 0.0)) };
        let listed = self.wavelengths.iter().copied().flatten().enumerate();
        let off = |(_, listed): &(usize, f64)| (listed - own).abs();
        match listed.min_by(|a, b| off(a).total_cmp(&off(b))) {
            Some(nearest) if off(&nearest) <= FARTHEST => Ok((nearest.0, Some(nearest.1), off(&nearest))),
            _ => Err(Refusal::OfScene(
                format!(
                    "ray {number} of the file has a wavelength of {} um, and the spectrum of the source has none within {} nm",
                    significant(own, 6),
                    1e3 * FARTHEST
                ),
                "add wavelengths to the spectrum of the source".into(),
            )),
        }
    }
}
