//! Numbers with units, as people write tolerances: `0.1deg`, `50um`. The number is given to a scene in the file's own unit.

use crate::model::key_path::ticked;
use crate::scene::named_entries::{last_key, moves};

/// What a number of a scene is.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    /// In mm.
    Length,
    /// In um.
    Wavelength,
    /// In rad.
    Angle,
    /// In degrees.
    Degrees,
}

/// Units of lengths: a number times the first factor, over the second, is in mm.
const LENGTHS: [(&str, f64, f64); 7] = [
    ("nm", 1.0, 1e6),
    ("um", 1.0, 1e3),
    ("µm", 1.0, 1e3),
    ("μm", 1.0, 1e3),
    ("mm", 1.0, 1.0),
    ("cm", 10.0, 1.0),
    ("m", 1e3, 1.0),
];
/// Units of angles, and how many of each are a degree.
const DEGREES: [(&str, f64); 4] = [("deg", 1.0), ("°", 1.0), ("arcmin", 60.0), ("arcsec", 3600.0)];
/// Units of angles, and how many of each are a radian.
const RADIANS: [(&str, f64); 3] = [("rad", 1.0), ("mrad", 1e3), ("urad", 1e6)];

/// Keys of lengths, beside the keys of frames and keys that end in `radius`.
const LENGTH_KEYS: [&str; 16] = [
    "thickness",
    "thickness1",
    "thickness2",
    "width",
    "height",
    "z_front",
    "z_back",
    "z_offset",
    "r_front",
    "r_back",
    "gaussian_sigma",
    "semi_axis_x",
    "semi_axis_y",
    "r1",
    "r2",
    "r3",
];

/// A finite number of the scene, in the file's unit: `0.1deg` of `L4.rx` is 0.001745.
///
/// # Errors
/// What is wrong, for people.
pub(crate) fn parse(name: &str, text: &str) -> Result<f64, String> {
    let text = text.trim();
    let unit = unit_of(text);
    if unit.is_empty() {
        return plain(text);
    }
    let digits = text[..text.len() - unit.len()].trim_end();
    let number = plain(digits).map_err(|_| format!("`{text}` is no number"))?;
    let converted = match kind(name) {
        Some(Kind::Length) => length(number, unit),
        Some(Kind::Wavelength) => length(number, unit).map(|mm| mm * 1e3),
        Some(Kind::Angle) => in_radians(number, unit).or(in_degrees(number, unit).map(f64::to_radians)),
        Some(Kind::Degrees) => in_degrees(number, unit).or(in_radians(number, unit).map(f64::to_degrees)),
        None => None,
    };
    let units = match kind(name) {
        Some(Kind::Length | Kind::Wavelength) => "it takes nm, um, mm, cm or m",
        Some(Kind::Angle | Kind::Degrees) => "it takes deg, arcmin, arcsec, rad, mrad or urad",
        None => "lengths, angles and wavelengths take one; check the name, or give a plain number",
    };
    match converted {
        Some(number) if number.is_finite() => Ok(number),
        Some(_) => Err(format!("`{text}` is not finite; give a finite number")),
        None => Err(format!("{} has no unit {}; {units}", ticked(name), ticked(unit))),
    }
}

/// The unit of a number; empty where it has none.
pub(crate) fn unit_of(text: &str) -> &str {
    let text = text.trim();
    let digits = text.trim_end_matches(|letter: char| letter.is_alphabetic() || letter == '°').trim_end();
    if digits.is_empty() { "" } else { text[digits.len()..].trim_start() }
}

/// A finite number without a unit.
///
/// # Errors
/// What is wrong, for people.
pub(crate) fn plain(text: &str) -> Result<f64, String> {
    let text = text.trim();
    match text.parse::<f64>() {
        Ok(number) if number.is_finite() => Ok(number),
        Ok(_) => Err(format!("`{text}` is not finite; give a finite number")),
        Err(_) => Err(format!("`{text}` is no number")),
    }
}

/// What the number of a name is. `None` if its unit is not known.
fn kind(name: &str) -> Option<Kind> {
    match last_key(name) {
        "rx" | "ry" | "rz" => Some(Kind::Angle),
        "wavelengths" | "wl_min" | "wl_max" => Some(Kind::Wavelength),
        key if key.ends_with("_deg") => Some(Kind::Degrees),
        key if moves(key) || key.contains("radius") || LENGTH_KEYS.contains(&key) => Some(Kind::Length),
        _ => None,
    }
}

fn length(number: f64, unit: &str) -> Option<f64> {
    LENGTHS.iter().find(|(known, ..)| *known == unit).map(|(_, times, parts)| number * times / parts)
}

fn in_degrees(number: f64, unit: &str) -> Option<f64> {
    DEGREES.iter().find(|(known, _)| *known == unit).map(|(_, parts)| number / parts)
}

fn in_radians(number: f64, unit: &str) -> Option<f64> {
    RADIANS.iter().find(|(known, _)| *known == unit).map(|(_, parts)| number / parts)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_read_in_the_unit_of_the_file() {
        let degree = std::f64::consts::PI / 180.0;
        for (name, text, number) in [
            ("L4.y", "0.05", 0.05),
            ("L4.y", "50um", 0.05),
            ("L4.y", "50 µm", 0.05),
            ("L4.y", "-2e1nm", -2e-5),
            ("L4.y", "1m", 1000.0),
            ("gap_3", "0.02mm", 0.02),
            ("L1.r1", "5cm", 50.0),
            ("L1.front.aperture_radius", "12mm", 12.0),
            ("L4.rx", "0.1deg", 0.1 * degree),
            ("L4.rx", "6arcmin", 0.1 * degree),
            ("L4.rx", "360arcsec", 0.1 * degree),
            ("L4.rx", "1mrad", 1e-3),
            ("L4.rx", "2", 2.0),
            ("lamp.half_angle_deg", "30deg", 30.0),
            ("lamp.half_angle_deg", "3.14159265358979rad", 180.0),
            ("lamp.spectrum.wavelengths.0", "550nm", 0.55),
            ("glass.n", "1.5", 1.5),
        ] {
            let found = parse(name, text).unwrap();
            assert!((found - number).abs() <= 4e-15 * number.abs(), "{name}={text}: {found}");
        }
    }

    #[test]
    fn a_unit_of_something_else_is_refused() {
        for (name, text, said) in [
            ("L4.rx", "0.1mm", "it takes deg"),
            ("L4.y", "0.1deg", "it takes nm"),
            ("gap_3", "1inch", "it takes nm"),
            ("glass.n", "1mm", "a plain number"),
            ("L4.y", "mm", "no number"),
            ("L4.y", "1..2mm", "no number"),
            ("L4.y", "inf", "not finite"),
            ("L4.y", "1e308m", "not finite"),
            ("L4.y", "", "no number"),
        ] {
            let problem = parse(name, text).unwrap_err();
            assert!(problem.contains(said), "{name}={text}: {problem}");
        }
    }
}
