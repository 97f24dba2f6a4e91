//! Lamp files: luminous intensity by direction, as makers of lamps measure and publish it. Two formats are
//! read and written: IES LM-63 and EULUMDAT.
//!
//! The readers are our own, because a file may come from anywhere. They check sizes before they take memory,
//! and name the line in messages. Files of photometry of type C are read, and no others.
//!
//! The frame: gamma = 0 is +z, the half plane C = 0 holds +x, and C = 90 holds +y. Both formats use these
//! angles, but they lay the length of the opening along different axes; each reader says which.

#[cfg(test)]
mod broken;
mod eulumdat;
mod ies;

use crate::model::key_path::quoted;
use crate::model::polar_table::flux;
use crate::model::sources::tabulated::{Plane, mirrored};
pub use eulumdat::{read_eulumdat, write_eulumdat};
pub use ies::{read_ies, write_ies};

/// Most intensities of a table, after a file's symmetries were unfolded.
const MAX_VALUES: usize = 1 << 20;
/// Largest intensity that is read \[cd\]: a thousand times a searchlight and more.
const MAX_INTENSITY: f64 = 1e15;
/// Largest dimension of an opening that is read \[mm\]: a kilometre.
const MAX_DIMENSION: f64 = 1e6;
/// Difference that is taken for rounding, between planes that ought to mirror each other \[deg\].
const ROUNDED_ANGLE: f64 = 0.01;
/// Relative difference of lumens from what a file states that goes without a remark.
const SMALL_DIFFERENCE: f64 = 0.05;

/// Luminous intensity over the directions of a lamp: photometry of type C.
#[derive(Debug, Clone, PartialEq)]
pub struct Lamp {
    /// Angles gamma from the lamp's axis \[deg\], rising, between 0 and 180. A ceiling lamp shines straight
    /// down at 0, which is +z. There is no light outside them.
    pub polar_angles_deg: Vec<f64>,
    /// Planes C \[deg\], rising from 0 to 360, where the last row repeats the first. A lamp of revolution has
    /// the one number 0.
    pub azimuth_angles_deg: Vec<f64>,
    /// Luminous intensity \[cd\]: a row for each plane, a number for each polar angle.
    pub intensity: Vec<Vec<f64>>,
    /// The luminous opening \[mm\].
    pub opening: Opening,
    /// What the file says of itself, by the keywords of IES LM-63: `TEST`, `MANUFAC`, `LUMCAT`, `LUMINAIRE`,
    /// `LAMP`. Keywords that begin with an underscore are not of the standard. A value may have several
    /// lines.
    pub keywords: Vec<(String, String)>,
    /// Luminous flux that the file states of its bare lamps \[lm\], all lamps together. None in absolute
    /// photometry.
    pub lamp_lumens: Option<f64>,
    /// Electrical power that the lamp takes in \[W\], if the file states it.
    pub watts: Option<f64>,
    /// What a user should know of how the file was read, in plain English.
    pub remarks: Vec<String>,
}

/// The flat luminous opening of a lamp: its centre is the origin of the lamp's frame, its normal is +z.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Opening {
    /// No extent.
    Point,
    /// A round opening.
    Disk {
        /// Radius \[mm\], above 0.
        radius: f64,
    },
    /// A rectangular opening. One extent may be 0: a line.
    Rectangle {
        /// Extent along x, which is plane C0 \[mm\].
        width: f64,
        /// Extent along y, which is plane C90 \[mm\].
        height: f64,
    },
}

/// What is wrong in a lamp file, where, and what would be right.
#[derive(Debug, Clone, PartialEq)]
pub struct Malformed {
    /// The line, such as `line 12`.
    pub place: String,
    /// What is wrong there.
    pub problem: String,
    /// What would be right.
    pub remedy: String,
}

type Checked<T> = Result<T, Malformed>;

impl Lamp {
    /// Luminous flux \[lm\]: the integral of the intensity over all directions. Between the angles of the
    /// table the intensity is linear in both angles, and the integral of that is exact.
    pub fn lumens(&self) -> f64 {
        let radians = |angles: &[f64]| angles.iter().map(|angle| angle.to_radians()).collect::<Vec<_>>();
        flux(&radians(&self.polar_angles_deg), &radians(&self.azimuth_angles_deg), &self.intensity)
    }

    /// Azimuths \[deg\] and intensities in the frame of a source: see [`azimuths_of`].
    pub fn in_frame(&self) -> (Vec<f64>, Vec<Vec<f64>>) {
        azimuths_of(&self.azimuth_angles_deg, &self.intensity)
    }

    /// The value of a keyword, if the file has it.
    fn keyword(&self, key: &str) -> Option<&str> {
        self.keywords.iter().find(|(other, _)| other == key).map(|(_, value)| value.as_str())
    }
}

/// Azimuths and their rows of planes C and theirs, or the other way round.
///
/// Planes C are counted counter-clockwise as seen from above a lamp that shines down (IES LM-63). Radiance's `ies2rad`
/// reads planes so, with C90 at +y where light goes to -z. A source shines along its +z, from which azimuths run the
/// other way. So plane C lies at the azimuth 360 - C, and C90 at -y.
pub fn azimuths_of(planes: &[f64], rows: &[Vec<f64>]) -> (Vec<f64>, Vec<Vec<f64>>) {
    match planes {
        [_] => (planes.to_vec(), rows.to_vec()),
        _ => (planes.iter().rev().map(|angle| 360.0 - angle).collect(), rows.iter().rev().cloned().collect()),
    }
}

fn at_line(index: usize, problem: impl Into<String>, remedy: impl Into<String>) -> Malformed {
    Malformed { place: format!("line {}", index + 1), problem: problem.into(), remedy: remedy.into() }
}

/// The lines of a file, if they end in line feeds. A mark for the end of a file, of old systems, is left out.
fn lines_of(text: &str) -> Checked<Vec<&str>> {
    if text.contains('\r') && !text.contains('\n') {
        return Err(at_line(0, "its lines end in a carriage return alone", "end lines in a line feed"));
    }
    Ok(text.trim_end_matches(|c: char| c == '\u{1a}' || c.is_whitespace()).lines().collect())
}

/// A number of the file, if it is finite.
fn number_of(word: &str) -> Option<f64> {
    // -0 is 0.
    word.parse::<f64>().ok().filter(|number| number.is_finite()).map(|number| number + 0.0)
}

/// A count that a file states, from `least` on.
fn count_of(number: f64, least: usize, index: usize, what: &str) -> Checked<usize> {
    if number.fract() == 0.0 && number >= least as f64 && number <= MAX_VALUES as f64 {
        return Ok(number as usize);
    }
    let remedy = format!("write a whole number from {least} to {MAX_VALUES}");
    Err(at_line(index, format!("the {what} cannot be {number:?}"), remedy))
}

/// Refuses a table of too many intensities, before memory is taken for it.
fn check_size(planes: usize, polar: usize, index: usize) -> Checked<()> {
    match planes.checked_mul(polar) {
        Some(values) if values <= MAX_VALUES => Ok(()),
        _ => Err(at_line(
            index,
            format!("{planes} planes of {polar} angles are too many intensities"),
            format!("measure at most {MAX_VALUES} directions, counted all around the lamp"),
        )),
    }
}

/// An intensity, if a lamp can have it.
fn checked_intensity(candela: f64, index: usize) -> Checked<f64> {
    match candela {
        value if value < 0.0 => Err(at_line(
            index,
            format!("the intensity {value:?} cd is negative"),
            "write 0 where the lamp gives no light",
        )),
        value if value <= MAX_INTENSITY => Ok(value),
        value => Err(at_line(
            index,
            format!("the intensity {value:?} cd is out of range"),
            format!("intensities reach to {MAX_INTENSITY:e} cd; check factors and lumens"),
        )),
    }
}

/// Refuses angles that do not rise within 0 to 360; `line_of` gives the line of an angle.
fn check_rising(angles: &[f64], what: &str, line_of: impl Fn(usize) -> usize) -> Checked<()> {
    for (i, &angle) in angles.iter().enumerate() {
        if !(0.0..=360.0).contains(&angle) {
            let problem = format!("the {what} {angle:?} deg is out of range");
            return Err(at_line(line_of(i), problem, "write angles from 0 to 360 degrees"));
        }
        if i > 0 && angle <= angles[i - 1] {
            let problem = format!("the {what} {angle:?} deg comes after {:?} deg", angles[i - 1]);
            return Err(at_line(line_of(i), problem, "write angles in rising order, each one once"));
        }
    }
    Ok(())
}

/// Says where a lamp's polar angles leave directions dark.
fn dark_directions(polar: &[f64]) -> Option<String> {
    let (first, last) = (polar.first()?, polar.last()?);
    // A downlight's file ends at the horizon.
    match (*first > 0.0, *last < 180.0 && *last != 90.0) {
        (false, false) => None,
        (false, true) => {
            Some(format!("the file states no intensity beyond {last} deg from the axis: no light goes there"))
        }
        (true, false) => {
            Some(format!("the file states no intensity below {first} deg from the axis: no light goes there"))
        }
        (true, true) => Some(format!(
            "the file states intensities from {first} to {last} deg from the axis: no light goes elsewhere"
        )),
    }
}

/// Which planes of a full table a file leaves out.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Symmetry {
    /// All planes are there.
    None,
    /// The one plane stands for all.
    Revolution,
    /// Planes from 0 to 180: C0-C180 is a mirror.
    AboutC0,
    /// Planes from 90 to 270: C90-C270 is a mirror.
    AboutC90,
    /// Planes from 0 to 90: both are mirrors.
    Both,
}

impl Symmetry {
    /// Most planes that `stored` ones become.
    fn unfolded(self, stored: usize) -> usize {
        match self {
            Symmetry::Revolution => stored,
            Symmetry::None => stored.saturating_add(1),
            Symmetry::AboutC0 => stored.saturating_mul(2),
            Symmetry::AboutC90 => stored.saturating_mul(2).saturating_add(1),
            Symmetry::Both => stored.saturating_mul(4),
        }
    }

    /// The planes all around, from 0 to 360. Those without symmetry must already be so.
    fn unfold(self, stored: Vec<Plane>) -> Vec<Plane> {
        match self {
            Symmetry::None | Symmetry::Revolution => stored,
            Symmetry::AboutC0 => mirrored(stored),
            Symmetry::AboutC90 => turned(stored),
            Symmetry::Both => mirrored(mirrored(stored)),
        }
    }
}

/// Planes from 90 to 270, mirrored about C90-C270 and cut at C0, which is the image of C180. A file without
/// C180 gets it by interpolation, as everywhere between planes.
fn turned(mut planes: Vec<Plane>) -> Vec<Plane> {
    let above = planes.iter().position(|(angle, _)| *angle >= 180.0);
    if let Some(above) = above.filter(|&above| above > 0 && planes[above].0 > 180.0) {
        let between = interpolated(&planes[above - 1], &planes[above], 180.0);
        planes.insert(above, between);
    }
    let first = planes.iter().rev().filter(|(angle, _)| *angle <= 180.0);
    let last = planes.iter().rev().filter(|(angle, _)| (180.0..270.0).contains(angle));
    let mut all: Vec<Plane> = first.map(|(angle, row)| (180.0 - angle, row.clone())).collect();
    let last: Vec<Plane> = last.map(|(angle, row)| (540.0 - angle, row.clone())).collect();
    all.extend(planes.into_iter().skip(1));
    all.extend(last);
    all
}

fn interpolated(low: &Plane, high: &Plane, angle: f64) -> Plane {
    let share = (angle - low.0) / (high.0 - low.0);
    (angle, low.1.iter().zip(&high.1).map(|(a, b)| a + share * (b - a)).collect())
}

/// Planes without symmetry, closed to a full circle: plane C360 is plane C0. `index` is the line that lists
/// the last plane.
fn closed(mut planes: Vec<Plane>, index: usize, remarks: &mut Vec<String>) -> Checked<Vec<Plane>> {
    let (Some(first), Some(last)) = (planes.first().cloned(), planes.last_mut()) else { return Ok(planes) };
    if last.0 == 360.0 {
        if last.1 != first.1 {
            remarks.push(
                "the planes C0 and C360 differ, though they are one plane: C0 was taken for both".into(),
            );
        }
        last.1 = first.1;
        return Ok(planes);
    }
    let end = last.0;
    let widest = planes.windows(2).map(|pair| pair[1].0 - pair[0].0).fold(0.0, f64::max);
    if end <= 180.0 || 360.0 - end > 1.5 * widest {
        let problem =
            format!("planes end at {end:?} deg, and neither symmetry nor the next plane fills the circle");
        return Err(at_line(
            index,
            problem,
            "state planes from 0 to 90, 180 or 360 degrees, or from 90 to 270",
        ));
    }
    planes.push((360.0, first.1));
    Ok(planes)
}

/// Of an opening in which both extents matter to a file \[mm\].
fn rectangle(width: f64, height: f64) -> Opening {
    if width == 0.0 && height == 0.0 { Opening::Point } else { Opening::Rectangle { width, height } }
}

/// A number in the fewest digits that give it back.
fn digits(number: f64) -> String {
    let number = number + 0.0;
    match number.abs() {
        0.0 => "0".into(),
        size if (1e-5..1e16).contains(&size) => format!("{number}"),
        _ => format!("{number:e}"),
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    fn lamp(polar: Vec<f64>, azimuth: Vec<f64>, intensity: impl Fn(f64, f64) -> f64) -> Lamp {
        let row = |c: &f64| polar.iter().map(|gamma| intensity(*gamma, *c)).collect();
        Lamp {
            intensity: azimuth.iter().map(row).collect(),
            polar_angles_deg: polar,
            azimuth_angles_deg: azimuth,
            opening: Opening::Point,
            keywords: Vec::new(),
            lamp_lumens: None,
            watts: None,
            remarks: Vec::new(),
        }
    }

    fn steps(first: f64, last: f64, count: usize) -> Vec<f64> {
        (0..=count).map(|i| first + (last - first) * i as f64 / count as f64).collect()
    }

    #[test]
    fn a_candela_in_all_directions_is_4_pi_lumens() {
        for polar in [vec![0.0, 180.0], steps(0.0, 180.0, 7), steps(0.0, 180.0, 5000)] {
            for azimuth in [vec![0.0], vec![0.0, 33.0, 300.0, 360.0], steps(0.0, 360.0, 24)] {
                let lumens = lamp(polar.clone(), azimuth, |_, _| 1.0).lumens();
                assert!((lumens / (4.0 * PI) - 1.0).abs() < 1e-13, "{lumens}");
            }
        }
        let upper = lamp(vec![90.0, 135.0, 180.0], vec![0.0], |_, _| 1.0).lumens();
        assert!((upper / (2.0 * PI) - 1.0).abs() < 1e-14, "{upper}");
    }

    /// I = gamma / (pi / 2) up to 90 degrees: the integral of gamma sin(gamma) is 1.
    #[test]
    fn an_intensity_linear_in_gamma_is_integrated_exactly() {
        for count in [1, 2, 9, 90] {
            let lumens = lamp(steps(0.0, 90.0, count), vec![0.0], |gamma, _| gamma / 90.0).lumens();
            assert!((lumens - 4.0).abs() < 1e-13, "{count}: {lumens}");
        }
    }

    /// I = C / 360 over planes at uneven steps is half of I = 1.
    #[test]
    fn an_intensity_linear_in_c_is_integrated_exactly() {
        let uneven = vec![0.0, 1.0, 50.0, 200.0, 360.0];
        let lumens = lamp(vec![0.0, 40.0, 180.0], uneven, |_, c| c / 360.0).lumens();
        assert!((lumens - 2.0 * PI).abs() < 1e-13, "{lumens}");
    }

    /// A Lambertian lamp of 1 cd gives pi lumens; the table of chords falls short by the square of its step.
    #[test]
    fn a_lambertian_table_converges_by_the_square_of_its_step() {
        let short = |count: usize| {
            let cosine = |gamma: f64, _| gamma.to_radians().cos().max(0.0);
            let once = lamp(steps(0.0, 90.0, count), vec![0.0], cosine).lumens();
            let around = lamp(steps(0.0, 90.0, count), steps(0.0, 360.0, 24), cosine).lumens();
            assert!((once - around).abs() < 1e-13);
            PI - once
        };
        for count in [18, 36, 90] {
            let ratio = short(count) / short(2 * count);
            assert!((ratio - 4.0).abs() < 0.01, "{count}: {ratio}");
        }
        assert!(short(90) < 1e-4);
    }

    /// A table whose row says its plane, so that the source of each row shows.
    fn unfolded(symmetry: Symmetry, stored: &[f64]) -> Vec<(f64, f64)> {
        let planes: Vec<Plane> = stored.iter().map(|&angle| (angle, vec![angle])).collect();
        let all = symmetry.unfold(planes);
        assert!(all.len() <= symmetry.unfolded(stored.len()));
        all.into_iter().map(|(angle, row)| (angle, row[0])).collect()
    }

    #[test]
    fn symmetries_unfold_to_the_full_circle() {
        let both = unfolded(Symmetry::Both, &[0.0, 40.0, 90.0]);
        let expected = [(0.0, 0.0), (40.0, 40.0), (90.0, 90.0), (140.0, 40.0), (180.0, 0.0)];
        assert_eq!(both[..5], expected);
        assert_eq!(both[5..], [(220.0, 40.0), (270.0, 90.0), (320.0, 40.0), (360.0, 0.0)]);
        let about_c0 = unfolded(Symmetry::AboutC0, &[0.0, 70.0, 180.0]);
        assert_eq!(about_c0, [(0.0, 0.0), (70.0, 70.0), (180.0, 180.0), (290.0, 70.0), (360.0, 0.0)]);
        // C0 is the image of C180, C30 of C150, C330 of C210.
        let about_c90 = unfolded(Symmetry::AboutC90, &[90.0, 150.0, 180.0, 210.0, 270.0]);
        let expected =
            [(0.0, 180.0), (30.0, 150.0), (90.0, 90.0), (150.0, 150.0), (180.0, 180.0), (210.0, 210.0)];
        assert_eq!(about_c90[..6], expected);
        assert_eq!(about_c90[6..], [(270.0, 270.0), (330.0, 210.0), (360.0, 180.0)]);
        // Without C180: half way between 170 and 200 lies 185, and at 180 a third of the way 180.
        let without = unfolded(Symmetry::AboutC90, &[90.0, 170.0, 200.0, 270.0]);
        assert_eq!(
            without.iter().map(|plane| plane.0).collect::<Vec<_>>(),
            [0.0, 10.0, 90.0, 170.0, 180.0, 200.0, 270.0, 340.0, 360.0]
        );
        assert!((without[0].1 - 180.0).abs() < 1e-12 && without[0].1 == without[8].1);
    }

    #[test]
    fn circles_close_where_the_next_plane_is_near() {
        let planes = |angles: &[f64]| angles.iter().map(|&c| (c, vec![c])).collect::<Vec<Plane>>();
        let mut remarks = Vec::new();
        let all = closed(planes(&[0.0, 120.0, 240.0]), 6, &mut remarks).unwrap();
        assert_eq!(all.last(), Some(&(360.0, vec![0.0])));
        assert!(remarks.is_empty());
        let err = closed(planes(&[0.0, 30.0, 60.0, 270.0, 300.0, 0.5]), 6, &mut remarks).unwrap_err();
        assert_eq!(err.place, "line 7");
        assert!(closed(planes(&[0.0, 10.0, 200.0, 210.0]), 0, &mut remarks).is_ok());
        for open in [&[0.0, 10.0, 20.0][..], &[0.0, 40.0, 80.0, 120.0, 160.0, 200.0]] {
            assert!(closed(planes(open), 0, &mut remarks).is_err());
        }
        let all = closed(planes(&[0.0, 180.0, 360.0]), 6, &mut remarks).unwrap();
        assert_eq!((all[2].1[0], remarks.len()), (0.0, 1));
    }

    #[test]
    fn numbers_are_finite() {
        for word in ["nan", "inf", "-infinity", "1e400", "", "1 2", "0x10", "1,5"] {
            assert_eq!(number_of(word), None, "{word}");
        }
        assert_eq!(["1e3", "+5", ".5", "7."].map(number_of), [Some(1e3), Some(5.0), Some(0.5), Some(7.0)]);
        assert!(number_of("-0").is_some_and(f64::is_sign_positive));
    }

    #[test]
    fn digits_give_numbers_back() {
        for number in [0.0, -0.0, 1.0, 0.1, 1.0 / 3.0, 1e-9, 123_456.789, 1e300, f64::MIN_POSITIVE, 90.0] {
            assert_eq!(digits(number).parse::<f64>().unwrap(), number);
            assert!(digits(number).len() < 26);
        }
        assert_eq!([digits(-0.0), digits(90.0), digits(1e20)], ["0", "90", "1e20"]);
    }
}
