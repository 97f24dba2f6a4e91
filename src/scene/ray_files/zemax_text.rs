//! Text source files of Zemax OpticStudio, read.
//!
//! Source of the layout: the help of OpticStudio, "Source File", section "Text Source File format".
//!
//! The first line has the number of rays and the number of the unit of length. Then each line is a ray:
//! x y z L M N flux, and on request its wavelength in um. The flux is in the units of the scene's sources,
//! which the file does not name.
//!
//! Lines have no fixed length. So the reader keeps the place of one line in thousands, and finds any ray
//! from there.

use std::io::{BufRead, BufReader, Read, Seek, SeekFrom};
use std::ops::Range;

use super::ray::{Error, Format, Header, LengthUnit, Ray, Result, Wavelengths};

/// Longest line that is read \[bytes\].
const MAX_LINE: u64 = 4096;
/// Rays between two lines whose places are kept.
const STEP: u64 = 4096;
/// Fewest bytes of a ray: seven digits and what parts them.
const MIN_LINE: u64 = 13;

/// The rays of a text file.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Lines {
    num_rays: u64,
    num_items: usize,
    millimetres: f64,
    /// Where the rays 0, `STEP`, 2 `STEP`... are, as far as they are known.
    marks: Vec<Mark>,
}

/// The start of a line.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Mark {
    byte: u64,
    /// Lines before it.
    line: u64,
}

pub(super) fn open(reader: &mut (impl Read + Seek), length: u64) -> Result<(Header, Lines)> {
    let mut lines = LineReader::at(reader, Mark { byte: 0, line: 0 })?;
    let remedy = "the first line is the number of rays and the unit of length: 0 m, 1 in, 2 cm, 3 ft, 4 mm";
    let first = lines.next()?.map(|line| numbers(line).unwrap_or_default());
    let place = lines.place();
    let refused = |problem: &str| Err(Error::new(place.clone(), problem, remedy));
    // Some programs pad it with zeros to the width of a ray.
    let (count, unit) = match first.as_deref() {
        None => return refused("the file is empty"),
        Some([count, unit, rest @ ..]) if rest.iter().all(|&number| number == 0.0) => (*count, *unit),
        Some(_) => return refused("this is no header of a text source file"),
    };
    let Some(num_rays) = whole(count).filter(|num_rays| num_rays.saturating_mul(MIN_LINE) <= length + 1)
    else {
        return refused(&format!("{count} rays cannot be, in a file of {length} bytes"));
    };
    let Some(unit) = whole(unit).and_then(LengthUnit::of_zemax) else {
        return refused(&format!("the unit of length is {unit}"));
    };
    let rays = lines.mark;
    let num_items = match lines.next()?.map(numbers) {
        Some(Some(items)) if items.len() == 8 => 8,
        // What else is wrong with this line is said when it is read.
        _ => 7,
    };
    let header = Header {
        format: Format::ZemaxText,
        num_rays,
        unit,
        flux_kind: None,
        total_flux: None,
        wavelengths: if num_items == 8 { Wavelengths::PerRay } else { Wavelengths::None },
        description: String::new(),
        remarks: vec!["a text source file does not say whether its flux is in W or in lm".into()],
    };
    Ok((header, Lines { num_rays, num_items, millimetres: unit.millimetres, marks: vec![rays] }))
}

impl Lines {
    /// Appends the rays of a range. Whoever reads the last one also learns whether more lines follow.
    pub(super) fn read(
        &mut self,
        reader: &mut (impl Read + Seek),
        range: Range<u64>,
        rays: &mut Vec<Ray>,
    ) -> Result<()> {
        let nearest = (range.start / STEP).min(self.marks.len() as u64 - 1);
        let mut lines = LineReader::at(reader, self.marks[nearest as usize])?;
        for ray in nearest * STEP..range.end {
            if ray == self.marks.len() as u64 * STEP {
                self.marks.push(lines.mark);
            }
            if lines.next()?.is_none() {
                let problem = format!("the file ends after {ray} of {} rays", self.num_rays);
                return Err(Error::new(
                    lines.place(),
                    problem,
                    "fetch or export it again, or correct its first line",
                ));
            }
            if ray >= range.start {
                let place = || format!("ray {ray}, {}", lines.place());
                rays.push(self.ray(&lines.text, place)?);
            }
        }
        if range.end == self.num_rays && lines.next()?.is_some() {
            let problem = format!("more lines follow the {} rays of the first line", self.num_rays);
            return Err(Error::new(
                lines.place(),
                problem,
                "correct the number of rays, or remove the lines",
            ));
        }
        Ok(())
    }

    fn ray(&self, line: &str, place: impl Fn() -> String) -> Result<Ray> {
        let items = numbers(line).filter(|items| items.len() == self.num_items);
        let Some([x, y, z, l, m, n, flux, rest @ ..]) = items.as_deref() else {
            let problem = format!(
                "{:?} is not {} numbers",
                line.trim().chars().take(80).collect::<String>(),
                self.num_items
            );
            let remedy = "a ray is x y z L M N flux, and all rays or none have a wavelength in um";
            return Err(Error::new(place(), problem, remedy));
        };
        let ray = Ray {
            position: [x, y, z].map(|x| x * self.millimetres),
            direction: [*l, *m, *n],
            flux: *flux,
            wavelength: rest.first().copied(),
        };
        ray.checked(place)
    }
}

/// The numbers of a line, if it has nothing else.
fn numbers(line: &str) -> Option<Vec<f64>> {
    line.split_whitespace().map(|word| word.parse().ok()).collect()
}

/// A count that f64 holds exactly.
fn whole(number: f64) -> Option<u64> {
    (number.fract() == 0.0 && (0.0..=2f64.powi(53)).contains(&number)).then_some(number as u64)
}

/// Reads lines that are not blank, and knows where it is.
struct LineReader<'a, R> {
    reader: BufReader<&'a mut R>,
    /// The end of the last line read.
    mark: Mark,
    text: String,
}

impl<'a, R: Read + Seek> LineReader<'a, R> {
    fn at(reader: &'a mut R, mark: Mark) -> Result<Self> {
        let sought = reader.seek(SeekFrom::Start(mark.byte));
        sought.map_err(|error| Error::io(format!("byte {}", mark.byte), &error))?;
        Ok(LineReader { reader: BufReader::with_capacity(1 << 16, reader), mark, text: String::new() })
    }

    /// The last line read.
    fn place(&self) -> String {
        format!("line {}", self.mark.line.max(1))
    }

    /// The next line that is not blank.
    fn next(&mut self) -> Result<Option<&str>> {
        loop {
            let mut bytes = std::mem::take(&mut self.text).into_bytes();
            bytes.clear();
            let read = (&mut self.reader).take(MAX_LINE).read_until(b'\n', &mut bytes);
            let place = format!("line {}", self.mark.line + 1);
            let num_bytes = read.map_err(|error| Error::io(place.clone(), &error))?;
            if num_bytes == 0 {
                return Ok(None);
            }
            if num_bytes as u64 == MAX_LINE && bytes.last() != Some(&b'\n') {
                let problem = format!("the line has {MAX_LINE} bytes or more");
                return Err(Error::new(place, problem, "a line is one ray and ends in a line feed"));
            }
            self.mark = Mark { byte: self.mark.byte + num_bytes as u64, line: self.mark.line + 1 };
            self.text = String::from_utf8(bytes).map_err(|_| {
                Error::new(place, "the line is no text", "a text source file holds numbers alone")
            })?;
            // The mark for the end of a file, of old systems.
            if !self.text.trim_matches(|c: char| c == '\u{1a}' || c.is_whitespace()).is_empty() {
                return Ok(Some(&self.text));
            }
        }
    }
}
