//! What sources give and detectors saw, in lumens, lux and candela.

use crate::error::Result;
use crate::result::color::Color;
use crate::result::npz::ArrayWriter;
use ndarray::{ArrayD, arr0};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// What a detector saw, in photometric units.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Luminous {
    /// Luminous flux \[lm\].
    pub flux_lm: f64,
    /// Its standard error \[lm\]; none if second moments were not summed. It assumes that light of one wavelength
    /// arrives equally well from every source.
    pub flux_lm_standard_error: Option<f64>,
    /// Illuminance \[lx\], or luminous intensity of a far field \[cd\], in the shape of the detector's map.
    #[serde(skip)]
    pub map: ArrayD<f64>,
    /// Its standard error; none if second moments were not summed.
    #[serde(skip)]
    pub standard_error: Option<ArrayD<f64>>,
    /// True of luminous intensity.
    #[serde(skip)]
    pub is_intensity: bool,
    /// Its colour, if the detector sees colour.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub color: Option<Color>,
}

impl Luminous {
    /// The mean of the map \[lx\]; over the directions of a far field there is none.
    pub fn mean_lx(&self) -> Option<f64> {
        (!self.is_intensity).then(|| self.map.mean()).flatten()
    }

    /// The largest value of the map, with its standard error \[lx\] or \[cd\].
    pub fn peak(&self) -> (f64, Option<f64>) {
        let largest = self.map.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1));
        let error =
            |place: usize| self.standard_error.as_ref().and_then(|errors| errors.iter().nth(place).copied());
        largest.map_or((0.0, None), |(place, value)| (*value, error(place)))
    }

    /// What the map is called, and its unit.
    pub(crate) fn quantity(&self) -> (&'static str, &'static str) {
        if self.is_intensity { ("Luminous intensity", "cd") } else { ("Illuminance", "lx") }
    }

    /// The map's values for 1 lm in a unit of a cell's size: an area \[mm^2\], or a solid angle \[sr\].
    pub(crate) fn per_size(&self) -> f64 {
        if self.is_intensity { 1.0 } else { 1e6 }
    }

    /// The unit of the map.
    pub fn unit(&self) -> &'static str {
        self.quantity().1
    }

    /// The name of the map in files. The name of its standard error ends in `_standard_error`.
    pub fn name(&self) -> &'static str {
        if self.is_intensity { "luminous_intensity" } else { "illuminance" }
    }

    /// Its entry of the report.
    pub(crate) fn entry(&self) -> Value {
        let (peak, error) = self.peak();
        let mut entry = json!(self);
        if let Some(mean) = self.mean_lx() {
            let per_lumen = if self.flux_lm > 0.0 { mean / self.flux_lm } else { 0.0 };
            entry["mean_lx"] = json!(mean);
            entry["mean_lx_standard_error"] =
                json!(self.flux_lm_standard_error.map(|error| error * per_lumen));
        }
        entry[format!("peak_{}", self.unit())] = json!(peak);
        entry[format!("peak_{}_standard_error", self.unit())] = json!(error);
        entry
    }

    /// Adds its map to a file of arrays.
    pub(crate) fn add_to(&self, file: &mut ArrayWriter) -> Result<()> {
        file.add(self.name(), &self.map)?;
        file.add_optional(&format!("{}_standard_error", self.name()), &self.standard_error)?;
        file.add("luminous_flux", &arr0(self.flux_lm))?;
        file.add_optional("luminous_flux_standard_error", &self.flux_lm_standard_error.map(arr0))?;
        self.color.as_ref().map_or(Ok(()), |color| color.add_to(file))
    }

    /// Units of the arrays in that file.
    pub(crate) fn units(&self) -> Vec<(&'static str, &'static str)> {
        let maps = match self.is_intensity {
            true => ["luminous_intensity", "luminous_intensity_standard_error"],
            false => ["illuminance", "illuminance_standard_error"],
        };
        let fluxes = ["luminous_flux", "luminous_flux_standard_error"].map(|name| (name, "lm"));
        let of_color = self.color.iter().flat_map(|_| Color::units(self.unit()));
        maps.into_iter().map(|name| (name, self.unit())).chain(fluxes).chain(of_color).collect()
    }
}

/// What a source gives, in photometric units.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LuminousSource {
    /// Luminous flux \[lm\].
    pub flux_lm: f64,
    /// Luminous efficacy of its spectrum \[lm/W\].
    pub efficacy: f64,
}
