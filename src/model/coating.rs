//! Coatings of surfaces.

/// A coating of a refractive surface: it takes the place of Fresnel's reflectance and transmittance, total reflection
/// excepted. What the two leave of 1 is absorbed.
#[derive(Debug, Clone, PartialEq)]
pub struct Coating {
    /// Reflectance per wavelength of the scene.
    pub reflectance: Vec<f64>,
    /// Transmittance per wavelength of the scene.
    pub transmittance: Vec<f64>,
}
