//! Coatings of surfaces.

/// A coating. On a refractive surface, it takes the place of Fresnel's reflectance and transmittance; what the two leave
/// of 1 is absorbed. On a mirror, its reflectance by angle takes the place of the mirror's own.
#[derive(Debug, Clone, PartialEq)]
pub enum Coating {
    /// The same at every angle, and from both sides. It takes nothing of what is totally reflected.
    Simple(SimpleCoating),
    /// By the angle of incidence, from either side.
    Tabulated(TabulatedCoating),
}

/// A coating that is the same at every angle.
#[derive(Debug, Clone, PartialEq)]
pub struct SimpleCoating {
    /// Reflectance per wavelength of the scene.
    pub reflectance: Vec<f64>,
    /// Transmittance per wavelength of the scene.
    pub transmittance: Vec<f64>,
}

/// A coating by the cosine of the angle of incidence, linear in the cosine between the rows of the table.
///
/// Where reflection is total, what the coating absorbs is 1 - R - T of the table, and the rest is reflected.
#[derive(Debug, Clone, PartialEq)]
pub struct TabulatedCoating {
    /// Cosines of the angles of incidence, each in the medium that light comes from: ascending, from 0 to 1.
    pub cosines: Vec<f64>,
    /// Per wavelength of the scene, the values at each cosine.
    pub rows: Vec<CoatingRow>,
}

/// Values of a tabulated coating at one wavelength, one per cosine.
#[derive(Debug, Clone, PartialEq)]
pub struct CoatingRow {
    /// Reflectance for light from the front medium.
    pub reflectance: Vec<f64>,
    /// Transmittance for light from the front medium.
    pub transmittance: Vec<f64>,
    /// Reflectance for light from the back medium.
    pub reflectance_back: Vec<f64>,
    /// Transmittance for light from the back medium.
    pub transmittance_back: Vec<f64>,
}

impl Coating {
    /// True if it depends on the angle.
    pub fn is_tabulated(&self) -> bool {
        matches!(self, Coating::Tabulated(_))
    }

    /// Its reflectance and transmittance, where these are the same at every angle.
    pub fn simple(&self) -> Option<&SimpleCoating> {
        match self {
            Coating::Simple(simple) => Some(simple),
            Coating::Tabulated(_) => None,
        }
    }

    /// Itself as a table: a simple coating has two equal columns.
    pub fn tabulated(&self) -> TabulatedCoating {
        match self {
            Coating::Tabulated(table) => table.clone(),
            Coating::Simple(SimpleCoating { reflectance, transmittance }) => {
                let rows = reflectance.iter().zip(transmittance).map(|(&r, &t)| CoatingRow {
                    reflectance: vec![r; 2],
                    transmittance: vec![t; 2],
                    reflectance_back: vec![r; 2],
                    transmittance_back: vec![t; 2],
                });
                TabulatedCoating { cosines: vec![0.0, 1.0], rows: rows.collect() }
            }
        }
    }
}

impl TabulatedCoating {
    /// Its numbers as shaders/optics/coating.tabulated.wgsl reads them: the cosines, then R, T, R and T from the back for
    /// each wavelength.
    pub fn numbers(&self) -> Vec<f64> {
        let columns = |row: &CoatingRow| {
            [&row.reflectance, &row.transmittance, &row.reflectance_back, &row.transmittance_back]
                .into_iter()
                .flatten()
                .copied()
                .collect::<Vec<f64>>()
        };
        self.cosines.iter().copied().chain(self.rows.iter().flat_map(columns)).collect()
    }
}
