//! EULUMDAT: lamp files of Europe, by A. W. Stockmar, 1990 and 1998. Each number has a line of its own.
//!
//! The length of an opening lies along the plane C90-C270, which is y here, and the width along C0-C180: that
//! plane cuts a tube across. In IES LM-63 it is the other way round.

use super::{
    Checked, Lamp, MAX_DIMENSION, Malformed, Opening, Plane, ROUNDED_ANGLE, SMALL_DIFFERENCE, Symmetry,
    at_line, check_rising, check_size, checked_intensity, closed, count_of, dark_directions, digits,
    lines_of, number_of, quoted, rectangle,
};

/// Significant digits of intensities that are written, so that files read and written again stay the same to
/// the letter.
const DIGITS: usize = 14;
/// Room indices for which a file lists direct ratios, which are not used.
const DIRECT_RATIOS: usize = 10;
/// What is right where planes do not suit a symmetry.
const ALL_PLANES: &str = "list all planes from C0 to below C360, each with its mirror images";
/// Our keywords for what IES LM-63 has no keyword for.
const FILE_NAME: &str = "_FILENAME";
const LAMP_COLOUR: &str = "_LAMPCOLOR";
const LAMP_RENDERING: &str = "_LAMPCRI";

/// Reads a EULUMDAT file. Intensities are multiplied by the lumens of the first set of lamps and by the
/// conversion factor.
///
/// Negative numbers of lamps mark absolute photometry, by an agreement of the makers of programs in 2009. The lumens
/// are then the luminaire's. Intensities are for 1000 lumens, as ever.
///
/// # Errors
///
/// The line, what is wrong there, and what would be right.
pub fn read_eulumdat(text: &str) -> Result<Lamp, Malformed> {
    let mut lines = Lines::new(lines_of(text)?);
    let mut keywords = Vec::new();
    lines.keyword("MANUFAC", &mut keywords)?;
    let grid = Grid::read(&mut lines)?;
    for key in ["TEST", "LUMINAIRE", "LUMCAT", FILE_NAME, "ISSUEDATE"] {
        lines.keyword(key, &mut keywords)?;
    }
    let mut remarks = Vec::new();
    let opening = opening(&mut lines, &mut remarks)?;
    lines.optional("downward flux fraction")?;
    let output_ratio = lines.optional("light output ratio")?;
    let conversion = lines.positive("conversion factor")?;
    let tilt = lines.optional("tilt during measurement")?.filter(|tilt| *tilt != 0.0);
    remarks.extend(tilt.map(|tilt| {
        format!("the lamp was tilted by {} deg when it was measured; it is not turned back", digits(tilt))
    }));
    let lamps = Lamps::read(&mut lines, &mut keywords, &mut remarks)?;
    for _ in 0..DIRECT_RATIOS {
        lines.optional("direct ratio")?;
    }
    let (polar, planes) = grid.table(&mut lines, lamps.lumens, conversion, &mut remarks)?;
    lines.end()?;
    remarks.extend(dark_directions(&polar));
    remarks.extend(lines.read_commas.then(|| "decimal commas were read as decimal points".to_owned()));
    let (azimuth_angles_deg, intensity) = planes.into_iter().unzip();
    let mut lamp = Lamp {
        polar_angles_deg: polar,
        azimuth_angles_deg,
        intensity,
        opening,
        keywords,
        lamp_lumens: (!lamps.is_absolute).then_some(lamps.lumens),
        watts: lamps.watts.filter(|watts| *watts > 0.0),
        remarks,
    };
    let difference = difference(&lamp, lamps.lumens, output_ratio);
    lamp.remarks.extend(difference);
    Ok(lamp)
}

/// Says how far the intensities are from the lumens that the file states of the luminaire.
fn difference(lamp: &Lamp, lumens: f64, output_ratio: Option<f64>) -> Option<String> {
    let stated = lumens * output_ratio.filter(|ratio| *ratio > 0.0)? / 100.0;
    let given = lamp.lumens();
    let is_far = (given / stated - 1.0).abs() > SMALL_DIFFERENCE;
    is_far.then(|| {
        format!("the intensities add up to {given:.1} lm, the file states {stated:.1} lm of the luminaire")
    })
}

/// The lines of a file in turn.
struct Lines<'a> {
    lines: Vec<&'a str>,
    next: usize,
    /// True if a number shows that commas of this file are decimal ones.
    has_decimal_commas: bool,
    read_commas: bool,
}

impl<'a> Lines<'a> {
    fn new(lines: Vec<&'a str>) -> Self {
        let has_decimal_commas = lines.iter().any(|line| comma(line.trim()) == Some(Comma::Decimal));
        Lines { lines, next: 0, has_decimal_commas, read_commas: false }
    }

    /// The next line without blanks at its ends, and its index.
    fn line(&mut self, what: &str) -> Checked<(usize, &'a str)> {
        let Some(line) = self.lines.get(self.next) else {
            let index = self.lines.len().saturating_sub(1);
            let remedy = "add the missing lines, or correct the numbers of planes and angles";
            return Err(at_line(index, format!("the file ends before the {what}"), remedy));
        };
        self.next += 1;
        Ok((self.next - 1, line.trim()))
    }

    /// A line of text as a keyword, if it is not empty.
    fn keyword(&mut self, key: &str, keywords: &mut Vec<(String, String)>) -> Checked<()> {
        let (_, text) = self.line(key)?;
        if !text.is_empty() {
            keywords.push((key.into(), text.into()));
        }
        Ok(())
    }

    fn number(&mut self, what: &str) -> Checked<f64> {
        let (index, word) = self.line(what)?;
        self.number_in(word, index, what)
    }

    fn number_in(&mut self, word: &str, index: usize, what: &str) -> Checked<f64> {
        if let Some(number) = number_of(word) {
            return Ok(number);
        }
        match comma(word) {
            Some(Comma::Either) if !self.has_decimal_commas => Err(at_line(
                index,
                format!("the {what} {} may have a decimal comma or thousands", quoted(word)),
                "write a decimal point, and nothing between thousands",
            )),
            Some(_) => {
                self.read_commas = true;
                number_of(&word.replace(',', ".")).ok_or_else(|| not_a_number(word, index, what))
            }
            None => Err(not_a_number(word, index, what)),
        }
    }

    /// A number that some files leave out.
    fn optional(&mut self, what: &str) -> Checked<Option<f64>> {
        let (index, word) = self.line(what)?;
        if word.is_empty() { Ok(None) } else { self.number_in(word, index, what).map(Some) }
    }

    fn positive(&mut self, what: &str) -> Checked<f64> {
        match self.number(what)? {
            value if value > 0.0 => Ok(value),
            value => {
                let problem = format!("the {what} is {value:?}");
                Err(at_line(self.next - 1, problem, "write a number above 0"))
            }
        }
    }

    fn count(&mut self, what: &str, least: usize) -> Checked<usize> {
        let number = self.number(what)?;
        count_of(number, least, self.next - 1, what)
    }

    /// One of the numbers from 0 to `most`.
    fn choice(&mut self, what: &str, most: usize) -> Checked<usize> {
        let number = self.number(what)?;
        if let Some(choice) = (0..=most).find(|choice| *choice as f64 == number) {
            return Ok(choice);
        }
        let problem = format!("the {what} cannot be {number:?}");
        Err(at_line(self.next - 1, problem, format!("write a whole number from 0 to {most}")))
    }

    /// Angles in rising order.
    fn angles(&mut self, count: usize, what: &str) -> Checked<Vec<f64>> {
        let first = self.next;
        let angles = (0..count).map(|_| self.number(what)).collect::<Checked<Vec<f64>>>()?;
        check_rising(&angles, what, |i| first + i)?;
        Ok(angles)
    }

    /// Nothing may follow the last intensity: a table of another size or symmetry would be misread.
    fn end(&self) -> Checked<()> {
        let Some(line) = self.lines.get(self.next) else { return Ok(()) };
        let problem = format!("{} comes after the last intensity", quoted(line.trim()));
        Err(at_line(self.next, problem, "check the symmetry and the numbers of planes and angles"))
    }
}

fn not_a_number(word: &str, index: usize, what: &str) -> Malformed {
    let problem = match word.is_empty() {
        true => format!("the line of the {what} is empty"),
        false => format!("the {what} cannot be {}", quoted(word)),
    };
    at_line(index, problem, "write a finite number, alone in its line")
}

/// What the comma of a number can be.
#[derive(PartialEq)]
enum Comma {
    Decimal,
    /// In `1,500`, decimals may follow, or hundreds.
    Either,
}

/// What the comma of a number may be. `None` unless the word is a number with one comma.
fn comma(word: &str) -> Option<Comma> {
    let (whole, decimals) = word.split_once(',')?;
    let are_digits = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    let whole = whole.trim_start_matches(['-', '+']);
    if !are_digits(whole) || !are_digits(decimals) {
        return None;
    }
    let may_be_thousands = decimals.len() == 3 && whole.len() <= 3 && !whole.starts_with('0');
    Some(if may_be_thousands { Comma::Either } else { Comma::Decimal })
}

/// The opening by its length, width and four heights.
fn opening(lines: &mut Lines<'_>, remarks: &mut Vec<String>) -> Checked<Opening> {
    for what in ["length of the luminaire", "width of the luminaire", "height of the luminaire"] {
        lines.optional(what)?;
    }
    let length = dimension(lines, "length of the luminous area")?;
    let width = dimension(lines, "width of the luminous area")?;
    let mut highest: f64 = 0.0;
    for what in ["C0", "C90", "C180", "C270"] {
        highest = lines
            .optional(&format!("luminous height in {what}"))?
            .map_or(highest, |height| height.max(highest));
    }
    if highest > 0.0 {
        let height = digits(highest);
        remarks
            .push(format!("the luminous height of {height} mm is ignored: light starts from a flat opening"));
    }
    if length == 0.0 && width > 0.0 {
        remarks.push("the luminous opening has no length: it was taken for a line".into());
    }
    match width {
        0.0 if length > 0.0 => Ok(Opening::Disk { radius: length / 2.0 }),
        _ => Ok(rectangle(width, length)),
    }
}

fn dimension(lines: &mut Lines<'_>, what: &str) -> Checked<f64> {
    let size = lines.number(what)?;
    if (0.0..=MAX_DIMENSION).contains(&size) {
        return Ok(size);
    }
    let problem = format!("the {what} {size:?} mm is out of range");
    Err(at_line(lines.next - 1, problem, format!("write millimetres from 0 to {MAX_DIMENSION:e}")))
}

/// The first set of lamps: the others are sets that it may be exchanged for.
struct Lamps {
    is_absolute: bool,
    /// All lamps together, or the luminaire in absolute photometry \[lm\].
    lumens: f64,
    watts: Option<f64>,
}

impl Lamps {
    fn read(
        lines: &mut Lines<'_>,
        keywords: &mut Vec<(String, String)>,
        remarks: &mut Vec<String>,
    ) -> Checked<Lamps> {
        let sets = lines.count("number of sets of lamps", 1)?;
        let number = lines.number("number of lamps")?;
        lines.keyword("LAMP", keywords)?;
        let lumens = lines.positive("luminous flux of the lamps")?;
        lines.keyword(LAMP_COLOUR, keywords)?;
        lines.keyword(LAMP_RENDERING, keywords)?;
        let watts = lines.optional("power of the lamps")?;
        for _ in 0..(sets - 1).saturating_mul(6) {
            lines.line("next set of lamps")?;
        }
        if sets > 1 {
            remarks.push(format!("the file states {sets} sets of lamps: the first was taken"));
        }
        Ok(Lamps { is_absolute: number < 0.0, lumens, watts })
    }
}

/// How many planes and angles a file has.
struct Grid {
    symmetry: Symmetry,
    planes: usize,
    plane_step: f64,
    polar: usize,
    polar_step: f64,
}

impl Grid {
    fn read(lines: &mut Lines<'_>) -> Checked<Grid> {
        lines.choice("type of the luminaire", 3)?;
        let symmetry = match lines.choice("symmetry", 4)? {
            0 => Symmetry::None,
            1 => Symmetry::Revolution,
            2 => Symmetry::AboutC0,
            3 => Symmetry::AboutC90,
            _ => Symmetry::Both,
        };
        let planes = lines.count("number of planes", 1)?;
        check_parts(symmetry, planes, lines.next - 1)?;
        let plane_step = lines.number("step of the planes")?;
        let polar = lines.count("number of angles in a plane", 2)?;
        check_size(symmetry.unfolded(stored(symmetry, planes)), polar, lines.next - 1)?;
        let polar_step = lines.number("step of the angles in a plane")?;
        Ok(Grid { symmetry, planes, plane_step, polar, polar_step })
    }

    /// The polar angles, and the planes all around.
    fn table(
        &self,
        lines: &mut Lines<'_>,
        lumens: f64,
        conversion: f64,
        remarks: &mut Vec<String>,
    ) -> Checked<(Vec<f64>, Vec<Plane>)> {
        let first = lines.next;
        let angles = lines.angles(self.planes, "angle of a plane")?;
        let angles = self.stored_angles(&angles, first)?;
        let first_polar = lines.next;
        let polar = lines.angles(self.polar, "angle gamma")?;
        check_polar(&polar, first_polar)?;
        remarks.extend(step_remark("planes", self.plane_step, &angles));
        remarks.extend(step_remark("angles gamma", self.polar_step, &polar));
        let mut planes = Vec::new();
        for angle in angles {
            let mut row = Vec::new();
            for _ in 0..self.polar {
                let value = lines.number("intensity")?;
                row.push(checked_intensity(candela(value, lumens) * conversion + 0.0, lines.next - 1)?);
            }
            planes.push((angle, row));
        }
        match self.symmetry {
            Symmetry::None => Ok((polar, closed(planes, first + self.planes - 1, remarks)?)),
            // From -90 to 90: the mirror images go from 270 to 90.
            Symmetry::AboutC90 => {
                let images = planes.into_iter().rev().map(|(angle, row)| (180.0 - angle, row)).collect();
                Ok((polar, self.symmetry.unfold(images)))
            }
            Symmetry::Revolution | Symmetry::AboutC0 | Symmetry::Both => {
                Ok((polar, self.symmetry.unfold(planes)))
            }
        }
    }

    /// The angles of the planes whose intensities are stored, in their order. With C90-C270 as a mirror, the planes
    /// begin with C270, which is -90, and go on through C0 to C90. The other planes must be mirror images of these.
    fn stored_angles(&self, angles: &[f64], first: usize) -> Checked<Vec<f64>> {
        let count = angles.len();
        let kept: Vec<f64> = match self.symmetry {
            Symmetry::None => angles.to_vec(),
            Symmetry::Revolution => return Ok(vec![0.0]),
            Symmetry::AboutC0 => angles[..=count / 2].to_vec(),
            Symmetry::Both => angles[..=count / 4].to_vec(),
            Symmetry::AboutC90 => {
                let below = angles[count / 4 * 3..].iter().map(|angle| angle - 360.0);
                below.chain(angles[..=count / 4].iter().copied()).collect()
            }
        };
        let kept = self.with_exact_ends(kept, first)?;
        for (i, &angle) in angles.iter().enumerate() {
            let image = folded(self.symmetry, angle);
            let above = kept.partition_point(|other| *other < image);
            let mut near = kept[above.saturating_sub(1)..].iter().take(2);
            if !near.any(|other| (other - image).abs() <= ROUNDED_ANGLE) {
                let problem =
                    format!("the plane at {angle:?} deg is no mirror image of a plane with intensities");
                return Err(at_line(first + i, problem, ALL_PLANES));
            }
        }
        Ok(kept)
    }

    /// Refuses planes that do not reach from mirror to mirror; ends that are rounded are made exact. `first`
    /// is the index of the first plane's line.
    fn with_exact_ends(&self, mut kept: Vec<f64>, first: usize) -> Checked<Vec<f64>> {
        let last = kept.len().saturating_sub(1);
        let ends: &[(usize, f64, usize)] = match self.symmetry {
            Symmetry::None | Symmetry::Revolution => &[(0, 0.0, 0)],
            Symmetry::AboutC0 => &[(0, 0.0, 0), (last, 180.0, last)],
            Symmetry::AboutC90 => &[(0, -90.0, self.planes / 4 * 3), (last, 90.0, self.planes / 4)],
            Symmetry::Both => &[(0, 0.0, 0), (last, 90.0, last)],
        };
        for &(i, end, line) in ends {
            let Some(angle) = kept.get_mut(i) else { continue };
            if (*angle - end).abs() > ROUNDED_ANGLE {
                let [found, wanted] = [*angle, end].map(|angle| angle.rem_euclid(360.0));
                let problem = format!("a plane at {found:?} deg stands where {wanted:?} deg ought to be");
                return Err(at_line(first + line, problem, ALL_PLANES));
            }
            *angle = end;
        }
        Ok(kept)
    }
}

/// Number of planes whose intensities are stored.
fn stored(symmetry: Symmetry, planes: usize) -> usize {
    match symmetry {
        Symmetry::None => planes,
        Symmetry::Revolution => 1,
        Symmetry::AboutC0 | Symmetry::AboutC90 => planes / 2 + 1,
        Symmetry::Both => planes / 4 + 1,
    }
}

/// Refuses numbers of planes of which the mirrors take no whole part.
fn check_parts(symmetry: Symmetry, planes: usize, index: usize) -> Checked<()> {
    let parts = match symmetry {
        Symmetry::None if planes == 1 => {
            let problem = "one plane has no symmetry";
            return Err(at_line(index, problem, "state symmetry 1 if it stands for all planes"));
        }
        Symmetry::None | Symmetry::Revolution => return Ok(()),
        Symmetry::AboutC0 => 2,
        Symmetry::AboutC90 | Symmetry::Both => 4,
    };
    if planes.is_multiple_of(parts) {
        return Ok(());
    }
    let problem = format!("{planes} planes do not suit the symmetry");
    Err(at_line(index, problem, format!("state a multiple of {parts} planes, counted all around")))
}

/// The angle of a plane's mirror image among the stored planes.
fn folded(symmetry: Symmetry, angle: f64) -> f64 {
    let half = if angle > 180.0 { 360.0 - angle } else { angle };
    match symmetry {
        Symmetry::None | Symmetry::Revolution => angle,
        Symmetry::AboutC0 => half,
        Symmetry::Both if half > 90.0 => 180.0 - half,
        Symmetry::Both => half,
        Symmetry::AboutC90 if angle >= 270.0 => angle - 360.0,
        Symmetry::AboutC90 if angle > 90.0 => 180.0 - angle,
        Symmetry::AboutC90 => angle,
    }
}

/// The format has no rule where angles end; where they begin, light would be cut off unseen.
fn check_polar(polar: &[f64], first: usize) -> Checked<()> {
    match polar {
        [start, ..] if ![0.0, 90.0].contains(start) => Err(at_line(
            first,
            format!("the first angle gamma is {start:?} deg"),
            "begin at 0, or at 90 degrees if no light goes down",
        )),
        [.., end] if *end > 180.0 => Err(at_line(
            first + polar.len() - 1,
            format!("the last angle gamma is {end:?} deg"),
            "end at 180 degrees or before",
        )),
        _ => Ok(()),
    }
}

/// Says where a step is stated that the angles do not have.
fn step_remark(what: &str, step: f64, angles: &[f64]) -> Option<String> {
    let mut steps = angles.windows(2).map(|pair| pair[1] - pair[0]);
    let is_other = step != 0.0 && steps.any(|other| (other - step).abs() > 2.0 * ROUNDED_ANGLE);
    is_other.then(|| {
        format!(
            "the file states a step of {} deg for {what}, but lists others: the list was taken",
            digits(step)
        )
    })
}

/// An intensity \[cd\] of one for 1000 lumens.
fn candela(per_thousand: f64, lumens: f64) -> f64 {
    per_thousand * lumens / 1000.0
}

/// A EULUMDAT file of all planes.
///
/// Intensities are for 1000 of the lamps' lumens, or of the luminaire's own where the lamp states none, and
/// have 14 digits. Keywords of IES LM-63 for which the format has no line are left out.
///
/// # Errors
///
/// The format cannot hold a lamp that gives no light, nor one without two polar angles.
pub fn write_eulumdat(lamp: &Lamp) -> Result<String, Malformed> {
    let is_positive = |lumens: &f64| *lumens > 0.0 && lumens.is_finite();
    let stated = lamp.lamp_lumens.filter(is_positive).unwrap_or_else(|| lamp.lumens());
    if !is_positive(&stated) || lamp.polar_angles_deg.len() < 2 {
        return Err(not_for_eulumdat("a lamp that gives no light"));
    }
    let is_round = lamp.azimuth_angles_deg.len() == 1;
    // Plane C360 is not written.
    let planes = if is_round { 1 } else { lamp.azimuth_angles_deg.len().saturating_sub(1) };
    let azimuth: Vec<f64> = lamp.azimuth_angles_deg.iter().copied().take(planes).collect();
    let per_thousand = |row: &Vec<f64>| row.iter().map(|value| shortened(value / stated * 1000.0)).collect();
    let rows: Vec<Vec<f64>> = lamp.intensity.iter().map(per_thousand).collect();
    if !rows.iter().flatten().all(|value| value.is_finite()) {
        return Err(not_for_eulumdat("intensities so large for their lumens"));
    }
    let read_again = Lamp {
        intensity: rows.iter().map(|row| row.iter().map(|value| candela(*value, stated)).collect()).collect(),
        ..lamp.clone()
    };
    let mut lines = head(lamp, is_round, &azimuth);
    lines.extend(photometry(&read_again, stated));
    lines.extend(azimuth.iter().chain(&lamp.polar_angles_deg).map(|angle| digits(*angle)));
    lines.extend(rows.iter().take(planes).flatten().map(|value| digits(*value)));
    lines.push(String::new());
    Ok(lines.join("\r\n"))
}

fn not_for_eulumdat(what: &str) -> Malformed {
    Malformed {
        place: "the lamp".into(),
        problem: format!("EULUMDAT cannot hold {what}"),
        remedy: "write an IES file".into(),
    }
}

/// Lines 1 to 21.
fn head(lamp: &Lamp, is_round: bool, azimuth: &[f64]) -> Vec<String> {
    let [kind, symmetry] = if is_round { ["1", "1"] } else { ["3", "0"] };
    let around: Vec<f64> = azimuth.iter().copied().chain([360.0]).collect();
    let [length, width] = match lamp.opening {
        Opening::Point => [0.0; 2],
        Opening::Disk { radius } => [2.0 * radius, 0.0],
        Opening::Rectangle { width, height } => [height, width],
    };
    let mut lines = vec![
        text(lamp, "MANUFAC"),
        kind.into(),
        symmetry.into(),
        azimuth.len().to_string(),
        if is_round { "0".into() } else { digits(even_step(&around)) },
        lamp.polar_angles_deg.len().to_string(),
        digits(even_step(&lamp.polar_angles_deg)),
    ];
    lines.extend(["TEST", "LUMINAIRE", "LUMCAT", FILE_NAME, "ISSUEDATE"].map(|key| text(lamp, key)));
    lines.extend([length, width, 0.0, length, width, 0.0, 0.0, 0.0, 0.0].map(digits));
    lines
}

/// Lines 22 to 36, for a lamp as it is read again.
fn photometry(lamp: &Lamp, stated: f64) -> Vec<String> {
    let all = lamp.lumens();
    let below = if all > 0.0 { 100.0 * downward_lumens(lamp) / all } else { 0.0 };
    let ratio = Some(100.0 * all / stated).filter(|ratio| ratio.is_finite()).unwrap_or(0.0);
    let watts = lamp.watts.filter(|watts| *watts > 0.0 && watts.is_finite()).unwrap_or(0.0);
    let mut lines = vec![
        format!("{below:.1}"),
        format!("{ratio:.1}"),
        "1".into(),
        "0".into(),
        "1".into(),
        "1".into(),
        text(lamp, "LAMP"),
        digits(stated),
        text(lamp, LAMP_COLOUR),
        text(lamp, LAMP_RENDERING),
        digits(watts),
    ];
    lines.extend(vec!["0".into(); DIRECT_RATIOS]);
    lines
}

/// Lumens below 90 degrees.
fn downward_lumens(lamp: &Lamp) -> f64 {
    let split = lamp.polar_angles_deg.partition_point(|gamma| *gamma < 90.0);
    let (Some(before), Some(&end)) = (split.checked_sub(1), lamp.polar_angles_deg.get(split)) else {
        return if split == 0 { 0.0 } else { lamp.lumens() };
    };
    let mut below = lamp.clone();
    let start = lamp.polar_angles_deg[before];
    below.polar_angles_deg.truncate(split);
    below.polar_angles_deg.push(90.0);
    for row in &mut below.intensity {
        let (Some(&low), Some(&high)) = (row.get(before), row.get(split)) else { continue };
        row.truncate(split);
        row.push(low + (90.0 - start) / (end - start) * (high - low));
    }
    below.lumens()
}

/// The step of angles that have the same one all along, else 0.
fn even_step(angles: &[f64]) -> f64 {
    let (Some(first), Some(last)) = (angles.first(), angles.last()) else { return 0.0 };
    let step = (last - first) / (angles.len() - 1).max(1) as f64;
    let step = (step * 1e9).round() / 1e9;
    let is_even = angles.windows(2).all(|pair| (pair[1] - pair[0] - step).abs() < 1e-9);
    if is_even { step } else { 0.0 }
}

/// A keyword's value in one line.
fn text(lamp: &Lamp, key: &str) -> String {
    lamp.keyword(key).unwrap_or("").replace(char::is_control, " ").trim().to_owned()
}

fn shortened(value: f64) -> f64 {
    format!("{value:.*e}", DIGITS - 1).parse().unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    const POLAR: [f64; 3] = [0.0, 60.0, 120.0];

    /// A file of so many planes, whose stored ones have the intensities 1000 C + gamma for 1000 lumens.
    fn file(symmetry: usize, planes: &[f64], stored: &[f64]) -> Vec<String> {
        let head = format!(
            "Maker,3,{symmetry},{},0,{},60,17,Lamp,L-1,lamp.ldt,today/me,\
             1500,300,80,1400,200,0,0,0,0,50,100,1,0,1,2,T16,2000,830,1B,54,0,0,0,0,0,0,0,0,0,0",
            planes.len(),
            POLAR.len()
        );
        let mut lines: Vec<String> = head.split(',').map(str::to_owned).collect();
        lines.extend(planes.iter().chain(&POLAR).map(|angle| digits(*angle)));
        lines.extend(stored.iter().flat_map(|c| POLAR.map(|gamma| digits(1000.0 * c + gamma))));
        lines
    }

    fn read(lines: &[String]) -> Result<Lamp, Malformed> {
        read_eulumdat(&lines.join("\r\n"))
    }

    fn even(count: usize) -> Vec<f64> {
        (0..count).map(|i| 360.0 * i as f64 / count as f64).collect()
    }

    /// Each plane and the plane whose intensities it got; the flux of 2000 lm doubles them.
    fn sources(lamp: &Lamp) -> Vec<(f64, f64)> {
        lamp.azimuth_angles_deg
            .iter()
            .copied()
            .zip(lamp.intensity.iter().map(|row| row[0] / 2000.0))
            .collect()
    }

    #[test]
    fn all_symmetries_unfold_as_the_format_says() {
        let quarter = 45.0;
        let of = |symmetry, stored: &[f64]| sources(&read(&file(symmetry, &even(8), stored)).unwrap());
        let angles: Vec<f64> = even(8).into_iter().chain([360.0]).collect();
        let expect = |steps: [u32; 9]| {
            let steps = steps.map(|step| quarter * f64::from(step));
            angles.iter().copied().zip(steps).collect::<Vec<_>>()
        };
        assert_eq!(of(0, &even(8)), expect([0, 1, 2, 3, 4, 5, 6, 7, 0]));
        assert_eq!(of(1, &[135.0]), [(0.0, 135.0)]);
        assert_eq!(of(2, &[0.0, 45.0, 90.0, 135.0, 180.0]), expect([0, 1, 2, 3, 4, 3, 2, 1, 0]));
        // From C270 through C0 to C90.
        assert_eq!(of(3, &[270.0, 315.0, 0.0, 45.0, 90.0]), expect([0, 1, 2, 1, 0, 7, 6, 7, 0]));
        assert_eq!(of(4, &[0.0, 45.0, 90.0]), expect([0, 1, 2, 1, 0, 1, 2, 1, 0]));
        let uneven = [0.0, 20.0, 90.0, 160.0, 180.0, 200.0, 270.0, 340.0];
        let found = sources(&read(&file(4, &uneven, &[0.0, 20.0, 90.0])).unwrap());
        assert_eq!(found[6..], [(270.0, 90.0), (340.0, 20.0), (360.0, 0.0)]);
        let found = sources(&read(&file(3, &uneven, &[270.0, 340.0, 0.0, 20.0, 90.0])).unwrap());
        assert_eq!(
            found[3..8],
            [(160.0, 20.0), (180.0, 0.0), (200.0, 340.0), (270.0, 270.0), (340.0, 340.0)]
        );
    }

    #[test]
    fn lumens_and_factors_multiply() {
        let mut lines = file(1, &[0.0], &[0.0]);
        let lamp = read(&lines).unwrap();
        assert_eq!(lamp.intensity, [[0.0, 120.0, 240.0]]);
        assert_eq!((lamp.lamp_lumens, lamp.watts), (Some(2000.0), Some(54.0)));
        assert_eq!(lamp.opening, Opening::Rectangle { width: 200.0, height: 1400.0 });
        assert_eq!(lamp.keyword("MANUFAC"), Some("Maker"));
        assert_eq!(lamp.keyword(LAMP_RENDERING), Some("1B"));
        assert!(lamp.remarks.iter().any(|remark| remark.contains("beyond 120")));
        // Line 24 is the conversion factor, line 27 the number of lamps.
        lines[23] = "0.5".into();
        lines[26] = "-1".into();
        let lamp = read(&lines).unwrap();
        assert_eq!((lamp.intensity[0][2], lamp.lamp_lumens), (120.0, None));
        let stated = format!("{:.1} lm, the file states 2000.0 lm", lamp.lumens());
        assert!(lamp.remarks.iter().any(|remark| remark.contains(&stated)), "{:?}", lamp.remarks);
    }

    #[test]
    fn openings() {
        let mut lines = file(1, &[0.0], &[0.0]);
        for (length, width, height, expected, remarks) in [
            ("0", "0", "0", Opening::Point, 0),
            ("300", "0", "0", Opening::Disk { radius: 150.0 }, 0),
            ("300", "0", "20", Opening::Disk { radius: 150.0 }, 1),
            ("0", "300", "", Opening::Rectangle { width: 300.0, height: 0.0 }, 1),
        ] {
            (lines[15], lines[16], lines[19]) = (length.into(), width.into(), height.into());
            let lamp = read(&lines).unwrap();
            assert_eq!(lamp.opening, expected);
            // The table is dark beyond 120 degrees, and its lumens are made up.
            assert_eq!(lamp.remarks.len(), 2 + remarks, "{:?}", lamp.remarks);
        }
    }

    #[test]
    fn decimal_commas_are_read_unless_they_may_part_thousands() {
        let mut lines = file(1, &[0.0], &[0.0]);
        let last = lines.len() - 1;
        lines[last] = "12,5".into();
        let lamp = read(&lines).unwrap();
        assert_eq!(lamp.intensity[0][2], 25.0);
        assert!(lamp.remarks.iter().any(|remark| remark.contains("commas")));
        lines[last - 1] = "1,500".into();
        assert_eq!(read(&lines).unwrap().intensity[0][1], 3.0);
        lines[last] = "12.5".into();
        let err = read(&lines).unwrap_err();
        assert!(err.problem.contains("thousands") && err.place == format!("line {last}"), "{err:?}");
        lines[last - 1] = "0,500".into();
        assert_eq!(read(&lines).unwrap().intensity[0][1], 1.0);
        lines[last - 1] = "1,234.5".into();
        assert!(read(&lines).is_err());
    }

    #[test]
    fn further_sets_of_lamps_are_named_and_left() {
        let mut lines = file(1, &[0.0], &[0.0]);
        lines[25] = "2".into();
        lines.splice(32..32, ["1", "LED", "900", "840", "80", "9"].map(str::to_owned));
        let lamp = read(&lines).unwrap();
        assert_eq!((lamp.lamp_lumens, lamp.keyword("LAMP")), (Some(2000.0), Some("T16")));
        assert!(lamp.remarks.iter().any(|remark| remark.contains("2 sets")));
    }

    #[test]
    fn refusals_name_their_line() {
        let good = file(4, &even(8), &[0.0, 45.0, 90.0]);
        assert!(read(&good).is_ok());
        // Lines 43 to 50 are planes, 51 to 53 angles, 54 to 62 intensities.
        assert_eq!(good.len(), 62);
        for (line, new, place, word) in [
            (2, "4", 2, "type of the luminaire"),
            (3, "5", 3, "symmetry"),
            (4, "0", 4, "number of planes"),
            (4, "6", 4, "do not suit"),
            (4, "1000000000", 4, "number of planes"),
            (5, "x", 5, "step of the planes"),
            (6, "1", 6, "angles in a plane"),
            (6, "1000000", 6, "too many"),
            (16, "-3", 16, "luminous area"),
            (17, "", 17, "empty"),
            (24, "0", 24, "conversion factor"),
            (26, "0", 26, "sets of lamps"),
            (26, "1000000", 62, "ends before the next set"),
            (29, "0", 29, "luminous flux"),
            (29, "nan", 29, "luminous flux"),
            (40, "zero", 40, "direct ratio"),
            (43, "10", 43, "where 0.0 deg"),
            (44, "46", 46, "mirror image"),
            (44, "0", 44, "comes after"),
            (45, "89", 45, "where 90.0 deg"),
            (51, "10", 51, "first angle gamma"),
            (53, "190", 53, "last angle gamma"),
            (53, "60", 53, "comes after"),
            (54, "-1", 54, "negative"),
            (54, "1e400", 54, "intensity"),
            (54, "1 2", 54, "intensity"),
            (62, "1e290", 62, "out of range"),
            (62, "", 61, "ends before the intensity"),
            (62, "1\n1", 63, "after the last"),
        ] {
            let mut lines = good.clone();
            lines[line - 1] = new.into();
            let err = read(&lines).unwrap_err();
            assert_eq!(err.place, format!("line {place}"), "{new}: {err:?}");
            assert!(err.problem.contains(word) && !err.remedy.is_empty(), "{new}: {err:?}");
        }
        assert_eq!(read_eulumdat("").unwrap_err().place, "line 1");
        let err = read(&file(0, &[0.0, 30.0, 60.0], &[0.0, 30.0, 60.0])).unwrap_err();
        assert_eq!(err.place, "line 45");
        let err = read(&file(0, &[0.0], &[0.0])).unwrap_err();
        assert!(err.place == "line 4" && err.problem.contains("one plane"), "{err:?}");
        let err = read(&file(0, &[30.0, 150.0, 270.0], &[30.0, 150.0, 270.0])).unwrap_err();
        assert_eq!(err.place, "line 43");
    }

    #[test]
    fn what_is_written_is_read_to_the_digits_written() {
        for (symmetry, stored) in [(0, even(8)), (1, vec![5.0]), (3, vec![270.0, 315.0, 0.0, 45.0, 90.0])] {
            for absolute in [false, true] {
                let mut lines = file(symmetry, &even(8), &stored);
                if absolute {
                    lines[26] = "-3".into();
                }
                lines[28] = "1777.77".into();
                lines[23] = "0.37".into();
                let lamp = read(&lines).unwrap();
                let written = write_eulumdat(&lamp).unwrap();
                let again = read_eulumdat(&written).unwrap();
                let pairs = again.intensity.iter().flatten().zip(lamp.intensity.iter().flatten());
                assert!(pairs.into_iter().all(|(a, b)| (a - b).abs() <= 1e-13 * b));
                assert_eq!(again.intensity.len(), lamp.intensity.len());
                assert_eq!(again.polar_angles_deg, lamp.polar_angles_deg);
                assert_eq!(again.azimuth_angles_deg, lamp.azimuth_angles_deg);
                assert_eq!((again.opening, again.watts), (lamp.opening, lamp.watts));
                assert_eq!(again.keywords, lamp.keywords);
                assert_eq!(write_eulumdat(&again).unwrap(), written);
            }
        }
        let mut dark = read(&file(1, &[0.0], &[0.0])).unwrap();
        dark.intensity = vec![vec![0.0; 3]];
        dark.lamp_lumens = None;
        assert_eq!(write_eulumdat(&dark).unwrap_err().place, "the lamp");
    }

    #[test]
    fn lumens_below_the_horizon() {
        let mut lamp = read(&file(1, &[0.0], &[0.0])).unwrap();
        lamp.intensity = vec![vec![1.0; 3]];
        let half = downward_lumens(&lamp);
        assert!((half / std::f64::consts::TAU - 1.0).abs() < 1e-14);
        lamp.polar_angles_deg = vec![90.0, 100.0, 180.0];
        assert_eq!(downward_lumens(&lamp), 0.0);
        lamp.polar_angles_deg = vec![0.0, 10.0, 80.0];
        assert_eq!(downward_lumens(&lamp), lamp.lumens());
    }
}
