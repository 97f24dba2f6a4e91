//! Zemax tabular BSDF files, `.bsdf` (R. Rykowski, Zemax tabular BSDF data file format, 2008).

use crate::model::bsdfs::measured::csv::type_of;
use crate::model::bsdfs::measured::grid::Grid;
use crate::model::checks;
use crate::model::key_path::quoted;
use crate::{Error, Result};
use std::str::FromStr;

/// Most angles of a kind.
const MAX_ANGLES: usize = 1 << 16;

/// Words of a file, and the line that each stands in.
struct Words<'a> {
    words: Vec<(usize, &'a str)>,
    next: usize,
    place: &'a str,
}

impl<'a> Words<'a> {
    fn new(place: &'a str, text: &'a str) -> Self {
        let lines = (1..).zip(text.lines()).filter(|(_, line)| !line.trim_start().starts_with('#'));
        let words = lines.flat_map(|(number, line)| line.split_whitespace().map(move |word| (number, word)));
        Words { words: words.collect(), next: 0, place }
    }

    /// Where the next word stands.
    fn at(&self) -> String {
        let line = self.words.get(self.next).or(self.words.last()).map_or(1, |(line, _)| *line);
        format!("{}, line {line}", self.place)
    }

    fn word(&mut self, wanted: &str) -> Result<&'a str> {
        let Some((_, word)) = self.words.get(self.next) else {
            return Err(Error::scene(self.at(), format!("the file ends before {wanted}"), "is it whole?"));
        };
        self.next += 1;
        Ok(word)
    }

    fn is_next(&self, keyword: &str) -> bool {
        self.words.get(self.next).is_some_and(|(_, word)| word.eq_ignore_ascii_case(keyword))
    }

    /// Passes over a word that has to stand here.
    fn pass(&mut self, keyword: &str) -> Result<()> {
        let at = self.at();
        let found = self.word(keyword)?;
        match found.eq_ignore_ascii_case(keyword) {
            true => Ok(()),
            false => Err(Error::scene(
                at,
                format!("{} stands where `{keyword}` is to stand", quoted(found)),
                "write the lines of a Zemax tabular BSDF in their order",
            )),
        }
    }

    fn number<T: FromStr>(&mut self, wanted: &str) -> Result<T> {
        let at = self.at();
        let word = self.word(wanted)?;
        word.parse()
            .map_err(|_| Error::scene(at, format!("{} is not {wanted}", quoted(word)), "give a number"))
    }

    /// A keyword with a value.
    fn value(&mut self, keyword: &str) -> Result<(String, &'a str)> {
        self.pass(keyword)?;
        Ok((self.at(), self.word(keyword)?))
    }

    /// A keyword, a count, and so many numbers.
    fn numbers(&mut self, keyword: &str) -> Result<Vec<f64>> {
        self.pass(keyword)?;
        let at = self.at();
        match self.number("a count")? {
            count @ 1..=MAX_ANGLES => (0..count).map(|_| self.number("an angle")).collect(),
            count => Err(Error::scene(
                at,
                format!("{keyword} has {count} angles"),
                format!("give from 1 to {MAX_ANGLES}"),
            )),
        }
    }
}

/// Reads the text of a file; `place` is where the scene names it.
pub(super) fn parse(place: &str, text: &str) -> Result<Grid> {
    let mut words = Words::new(place, text);
    words.value("Source")?;
    let (symmetry_at, symmetry) = words.value("Symmetry")?;
    let (content_at, content) = words.value("SpectralContent")?;
    if !content.eq_ignore_ascii_case("Monochrome") {
        let problem = format!("the spectral content is {}", quoted(content));
        return Err(Error::scene(
            content_at,
            problem,
            "give a file of the content Monochrome for each wavelength",
        ));
    }
    let (at, scatter_type) = words.value("ScatterType")?;
    let scatter_type = type_of(&at, scatter_type)?;
    let at = words.at();
    let rotations = words.numbers("SampleRotation")?;
    if rotations.len() > 1 {
        let problem = format!("the sample was turned to {} angles: it has a grain", rotations.len());
        return Err(Error::scene(
            at,
            problem,
            "give a file of one SampleRotation: surfaces here have no grain",
        ));
    }
    let incidence = words.numbers("AngleOfIncidence")?;
    let azimuth = words.numbers("ScatterAzimuth")?;
    let radial = words.numbers("ScatterRadial")?;
    // A whole turn is said by the symmetry, so that half a turn is not taken for one.
    let is_half = azimuth.last().is_some_and(|last| *last <= 180.0);
    match symmetry.to_ascii_lowercase().as_str() {
        "planesymmetrical" => {}
        "asymmetrical" | "asymmetrical4d" if !is_half => {}
        "asymmetrical" | "asymmetrical4d" => {
            let problem = "the sample is asymmetrical, and the azimuths end at 180 degrees or before";
            return Err(Error::scene(symmetry_at, problem, "write PlaneSymmetrical, or azimuths up to 360"));
        }
        _ => {
            let problem = format!("the symmetry is {}", quoted(symmetry));
            return Err(Error::scene(
                symmetry_at,
                problem,
                "write PlaneSymmetrical, ASymmetrical or ASymmetrical4D",
            ));
        }
    }
    words.pass("Monochrome")?;
    words.pass("DataBegin")?;
    let (mut values, mut tis) = (Vec::new(), Vec::new());
    let has_tis = words.is_next("TIS");
    for _ in &incidence {
        if has_tis {
            words.pass("TIS")?;
            let at = words.at();
            let share = words.number("a share")?;
            checks::fraction(at, share)?;
            tis.push(share);
        }
        let mut row = || radial.iter().map(|_| words.number("a value")).collect::<Result<Vec<f64>>>();
        values.push(azimuth.iter().map(|_| row()).collect::<Result<Vec<_>>>()?);
    }
    words.pass("DataEnd")?;
    Ok(Grid { scatter_type, incidence, azimuth, radial, values, tis: has_tis.then_some(tis) })
}
