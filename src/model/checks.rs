//! Checks of single numbers that users give. Each takes the number's place in the scene file, for the message.

use crate::{Error, Result};

/// Longest coordinate or size \[mm\]: a million km.
pub const MAX_LENGTH: f64 = 1e12;
/// Shortest size \[mm\]: a femtometre.
pub const MIN_LENGTH: f64 = 1e-12;

/// Refuses what stands in a place.
///
/// # Errors
/// [`Error::Scene`] with the place and a remedy.
pub fn refuse(place: impl Into<String>, problem: impl Into<String>, remedy: impl Into<String>) -> Result<()> {
    Err(Error::scene(place, problem, remedy))
}

/// A number in a range.
///
/// # Errors
/// [`Error::Scene`] with the place and a remedy.
pub fn between(place: String, value: f64, low: f64, high: f64) -> Result<()> {
    if (low..=high).contains(&value) {
        Ok(())
    } else {
        refuse(place, format!("{value} is out of range"), format!("give a number from {low} to {high}"))
    }
}

/// A number in \[0, 1\].
///
/// # Errors
/// [`Error::Scene`] with the place and a remedy.
pub fn fraction(place: String, value: f64) -> Result<()> {
    between(place, value, 0.0, 1.0)
}

/// A size that must exist \[mm\].
///
/// # Errors
/// [`Error::Scene`] with the place and a remedy.
pub fn size(place: String, value: f64) -> Result<()> {
    match value {
        v if (MIN_LENGTH..=MAX_LENGTH).contains(&v) => Ok(()),
        v if v > MAX_LENGTH => {
            refuse(place, format!("{v} mm is too large"), format!("give at most {MAX_LENGTH:e} mm"))
        }
        v if v > 0.0 => {
            refuse(place, format!("{v} mm is too small"), format!("give at least {MIN_LENGTH:e} mm"))
        }
        v => refuse(place, format!("{v} mm is no size"), "give a number above 0"),
    }
}

/// A position along an axis \[mm\].
///
/// # Errors
/// [`Error::Scene`] with the place and a remedy.
pub fn position(place: String, value: f64) -> Result<()> {
    between(place, value, -MAX_LENGTH, MAX_LENGTH)
}

/// A vertex radius \[mm\]: 0 and infinity mean flat.
///
/// # Errors
/// [`Error::Scene`] with the place and a remedy.
pub fn radius(place: String, value: f64) -> Result<()> {
    if value == 0.0 || value.is_infinite() || value.abs() >= MIN_LENGTH {
        Ok(())
    } else {
        refuse(place, format!("a radius of {value} mm is too small"), "give 0 or Infinity for a flat surface")
    }
}

/// A conic constant.
///
/// # Errors
/// [`Error::Scene`] with the place and a remedy.
pub fn conic_constant(place: String, value: f64) -> Result<()> {
    between(place, value, -1e9, 1e9)
}
