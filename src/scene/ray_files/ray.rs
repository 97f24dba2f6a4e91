//! What all ray files have in common: rays, units, headers, and what is wrong with a file.

use std::fmt;
use std::io;

/// Difference of a direction's length from 1 up to which it is taken for rounding.
const UNIT_LENGTH: f64 = 1e-3;

/// What is wrong with a ray file, where, and what would be right.
#[derive(Debug, Clone, PartialEq)]
pub struct Error {
    /// A byte, a line or a ray, such as `ray 17, byte 36804`. Rays and bytes count from 0, lines from 1.
    pub place: String,
    /// What is wrong there.
    pub problem: String,
    /// What would be right.
    pub remedy: String,
}

/// Shorthand for results of this module.
pub type Result<T> = std::result::Result<T, Error>;

/// A ray that a file holds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// Where it starts \[mm\].
    pub position: [f64; 3],
    /// Direction cosines, of length 1.
    pub direction: [f64; 3],
    /// Flux in the unit of [`Header::flux_kind`], 0 or more.
    pub flux: f64,
    /// Wavelength \[um\]. None if the file has no wavelengths, or a spectrum for all rays.
    pub wavelength: Option<f64>,
}

/// The formats that are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// IES TM-25-13.
    Tm25,
    /// Binary source file of OpticStudio.
    ZemaxBinary,
    /// Text source file of OpticStudio.
    ZemaxText,
    /// Columns of a ray database.
    Npz,
}

/// What the flux of a ray measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FluxKind {
    /// Radiant flux \[W\].
    Radiant,
    /// Luminous flux \[lm\].
    Luminous,
}

/// The unit of length in a file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LengthUnit {
    /// Its symbol.
    pub symbol: &'static str,
    /// Millimetres in one of it.
    pub millimetres: f64,
}

/// What a file says of wavelengths.
#[derive(Debug, Clone, PartialEq)]
pub enum Wavelengths {
    /// Nothing.
    None,
    /// One for all rays \[um\].
    One(f64),
    /// One for each ray.
    PerRay,
    /// One spectrum for all rays: wavelengths \[um\], rising, and relative radiant flux per wavelength.
    Spectrum(Vec<(f64, f64)>),
}

/// What a file says before its rays.
#[derive(Debug, Clone, PartialEq)]
pub struct Header {
    /// The format.
    pub format: Format,
    /// Number of rays.
    pub num_rays: u64,
    /// The unit of length in the file. Rays are given in mm.
    pub unit: LengthUnit,
    /// What the flux of a ray measures. None if the file does not say.
    pub flux_kind: Option<FluxKind>,
    /// Flux of all rays that the header states, in the unit of `flux_kind`.
    pub total_flux: Option<f64>,
    /// Wavelengths.
    pub wavelengths: Wavelengths,
    /// What the file calls the light source.
    pub description: String,
    /// What a user should know of how the file is read, in plain English.
    pub remarks: Vec<String>,
}

/// Picks some rays of a file.
pub trait Picking<E> {
    /// True if a ray is wanted, of which these are number, flux and wavelength, as the file has them.
    ///
    /// # Errors
    /// Where the file is to be read no further.
    fn wants(&mut self, number: u64, flux: f64, wavelength: Option<f64>) -> std::result::Result<bool, E>;

    /// Takes a ray that is wanted.
    ///
    /// # Errors
    /// Where the file is to be read no further.
    fn take(&mut self, number: u64, ray: &Ray) -> std::result::Result<(), E>;
}

/// All rays are wanted.
impl Picking<Error> for Vec<Ray> {
    fn wants(&mut self, _: u64, _: f64, _: Option<f64>) -> Result<bool> {
        Ok(true)
    }

    fn take(&mut self, _: u64, ray: &Ray) -> Result<()> {
        self.push(*ray);
        Ok(())
    }
}

impl Error {
    pub(super) fn new(
        place: impl Into<String>,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Error { place: place.into(), problem: problem.into(), remedy: remedy.into() }
    }

    /// At a byte of the file.
    pub(super) fn at(byte: u64, problem: impl Into<String>, remedy: impl Into<String>) -> Self {
        Error::new(format!("byte {byte}"), problem, remedy)
    }

    /// What the operating system said.
    pub(super) fn io(place: impl Into<String>, error: &io::Error) -> Self {
        Error::new(place, error.to_string(), "see that the whole file is there and its disk works")
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}; {}", self.place, self.problem, self.remedy)
    }
}

impl std::error::Error for Error {}

impl FluxKind {
    /// `W` or `lm`.
    pub fn unit(self) -> &'static str {
        match self {
            FluxKind::Radiant => "W",
            FluxKind::Luminous => "lm",
        }
    }
}

impl LengthUnit {
    pub(super) const MILLIMETRE: LengthUnit = LengthUnit { symbol: "mm", millimetres: 1.0 };
    /// The units of Zemax source files, each at its number.
    const ZEMAX: [LengthUnit; 5] = [
        LengthUnit { symbol: "m", millimetres: 1000.0 },
        LengthUnit { symbol: "in", millimetres: 25.4 },
        LengthUnit { symbol: "cm", millimetres: 10.0 },
        LengthUnit { symbol: "ft", millimetres: 304.8 },
        LengthUnit::MILLIMETRE,
    ];

    /// Of its number in a Zemax source file, binary or text.
    pub(super) fn of_zemax(number: u64) -> Option<Self> {
        LengthUnit::ZEMAX.get(usize::try_from(number).ok()?).copied()
    }
}

impl Ray {
    /// The ray as a source may take it: all numbers finite, direction of length 1. `place` names the ray.
    pub(super) fn checked(mut self, place: impl Fn() -> String) -> Result<Self> {
        let refused = |problem: String, remedy: &str| Err(Error::new(place(), problem, remedy));
        if !self.position.iter().all(|x| x.is_finite()) {
            return refused(
                format!("the position is {:?} mm", self.position),
                "positions are finite numbers",
            );
        }
        let [l, m, n] = self.direction;
        let length = (l * l + m * m + n * n).sqrt();
        // A NaN is not within.
        let is_unit = (length - 1.0).abs() <= UNIT_LENGTH;
        if !is_unit {
            return refused(
                format!("the direction {:?} has length {length}", self.direction),
                "directions are unit vectors, to within 0.001",
            );
        }
        self.direction = self.direction.map(|cosine| cosine / length);
        if !(self.flux.is_finite() && self.flux >= 0.0) {
            return refused(format!("the flux is {}", self.flux), "a flux is a finite number, 0 or more");
        }
        // -0 is 0.
        self.flux += 0.0;
        match self.wavelength {
            Some(wavelength) if !(wavelength.is_finite() && wavelength > 0.0) => refused(
                format!("the wavelength is {wavelength} um"),
                "a wavelength is a finite number above 0",
            ),
            _ => Ok(self),
        }
    }
}
