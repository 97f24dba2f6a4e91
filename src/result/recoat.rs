//! What another coating of a face would do to light by its path, without a second trace.
//!
//! Example: `L1.back` reflects 0.01 and transmits 0.99. A ghost that it reflects once and lets pass twice has 1e-4 W. With
//! R = 0.002 and T = 0.998 the ghost has 1e-4 W times 0.002/0.01 times (0.998/0.99)^2 = 2.03e-5 W.
//!
//! The new flux is exact, not an estimate to first order. The light of one sequence is a product, in which each
//! reflection at the face has a factor R and each passage a factor T. The product holds where R and T are the same for
//! every angle and wavelength. So bare faces and coatings by a table are refused.
//!
//! **Scattering.** A refractive face draws reflection or transmission first, and scatters then. A step of a sequence says to
//! which side the light was scattered. A Lambertian lobe takes no notice of the branch: such light has R + T. A lobe about the
//! drawn ray has R or T, if all of it lies on one side. Elsewhere both branches are one step, and the step is refused.
//!
//! **Total reflection.** No coating changes total reflection, and a sequence shows it as it shows a drawn reflection.
//! So sequences in which total reflection is possible are named ([`total_reflection`]).

use crate::error::{Error, Result};
use crate::format::{significant, thousands};
use crate::model::key_path::did_you_mean;
use crate::model::{Bsdf, Coating, End, Interaction, SceneIr, Sequence, Step, StepKind, Surface};
use crate::result::total_reflection;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::str::FromStr;

/// R + T may exceed 1 by the rounding of decimal fractions.
const ROUNDING: f64 = 1e-12;

/// Another coating that a user asks for: `L1.back=0.002` or `L1.back=0.002,0.99`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NewCoating {
    /// The name of the face.
    pub face: String,
    /// Reflectance.
    pub reflectance: f64,
    /// Transmittance; by default what the reflectance and the face's own absorption leave of 1.
    #[serde(default)]
    pub transmittance: Option<f64>,
}

/// How a face was coated, and how it is coated now.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Recoated {
    /// The name of the face.
    pub face: String,
    /// Reflectance in the trace.
    pub old_reflectance: f64,
    /// Transmittance in the trace; null of a mirror.
    pub old_transmittance: Option<f64>,
    /// The new reflectance.
    pub reflectance: f64,
    /// The new transmittance; null of a mirror.
    pub transmittance: Option<f64>,
}

/// Other coatings of some faces of a scene; by default of none.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Recoating {
    /// By the number of the surface.
    faces: BTreeMap<u32, Change>,
}

/// A face whose reflectance and transmittance are the same at every angle and wavelength.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Constants {
    pub(crate) reflectance: f64,
    /// None: a mirror.
    transmittance: Option<f64>,
    through: Share,
    back: Share,
}

/// Why a face has no such constants.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Unfit {
    Absorbs,
    Bare,
    ByAngle,
    ByWavelength,
}

/// By what share of the light that arrives a step goes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Share {
    Reflected,
    Transmitted,
    /// The sum of both.
    Either,
    /// Some of each, and nobody knows how much.
    Mixed,
}

/// How often a sequence has each share at a face.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Uses {
    pub(crate) reflected: i32,
    transmitted: i32,
    either: i32,
    pub(crate) mixed: i32,
}

/// Another coating of a face.
#[derive(Debug, Clone, PartialEq)]
struct Change {
    name: String,
    before: Constants,
    reflectance: f64,
    transmittance: f64,
}

impl FromStr for NewCoating {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let problem = || {
            Error::Usage(format!("{text:?} is no coating; write FACE=R or FACE=R,T, such as L1.back=0.002"))
        };
        // A name may hold the sign, and a number does not.
        let (face, numbers) = text.rsplit_once('=').ok_or_else(problem)?;
        let number = |text: &str| text.trim().parse::<f64>().map_err(|_| problem());
        let (reflectance, transmittance) = match numbers.split_once(',') {
            Some((reflectance, transmittance)) => (reflectance, Some(number(transmittance)?)),
            None => (numbers, None),
        };
        Ok(NewCoating { face: face.trim().to_string(), reflectance: number(reflectance)?, transmittance })
    }
}

impl Unfit {
    /// What the face is, behind its name.
    pub(crate) fn text(self) -> &'static str {
        match self {
            Unfit::Absorbs => "absorbs all light",
            Unfit::Bare => "is bare: what it reflects depends on the angle",
            Unfit::ByAngle => "has a coating by the angle",
            Unfit::ByWavelength => "has a coating by the wavelength",
        }
    }

    fn advice(self) -> &'static str {
        match self {
            Unfit::Absorbs => "name a face that reflects",
            Unfit::Bare => {
                "trace it with a constant coating first, {\"type\": \"simple\", \"reflectance\": ..., \"transmittance\": ...}, \
                 or compare two scenes with `nsq-gpu diff A B`"
            }
            Unfit::ByAngle | Unfit::ByWavelength => "compare two scenes with `nsq-gpu diff A B`",
        }
    }
}

impl Constants {
    /// The constants of a surface.
    pub(crate) fn of(surface: &Surface) -> std::result::Result<Self, Unfit> {
        let [through, back] = scattered_shares(surface);
        match (&surface.interaction, &surface.coating) {
            (Interaction::Absorbing, _) => Err(Unfit::Absorbs),
            (_, Some(Coating::Tabulated(_))) => Err(Unfit::ByAngle),
            (Interaction::Reflective { reflectance }, _) => {
                let reflectance = constant(reflectance)?;
                Ok(Constants { reflectance, transmittance: None, through, back })
            }
            (Interaction::Refractive, None) => Err(Unfit::Bare),
            (Interaction::Refractive, Some(Coating::Simple(coating))) => {
                let reflectance = constant(&coating.reflectance)?;
                let transmittance = Some(constant(&coating.transmittance)?);
                Ok(Constants { reflectance, transmittance, through, back })
            }
        }
    }

    fn share(&self, kind: StepKind) -> Share {
        match kind {
            StepKind::Reflected => Share::Reflected,
            // A mirror has no such step.
            StepKind::Transmitted => Share::Transmitted,
            StepKind::ScatteredThrough => self.through,
            StepKind::ScatteredBack => self.back,
        }
    }

    /// How often a sequence has each share at this surface.
    pub(crate) fn uses(&self, sequence: &Sequence, surface: u32) -> Uses {
        let mut uses = Uses::default();
        for Step { kind, .. } in sequence.steps.iter().filter(|step| step.surface == surface) {
            match self.share(*kind) {
                Share::Reflected => uses.reflected += 1,
                Share::Transmitted => uses.transmitted += 1,
                Share::Either => uses.either += 1,
                Share::Mixed => uses.mixed += 1,
            }
        }
        uses
    }

    /// What absorbs of the light that is not totally reflected.
    fn absorptance(&self) -> f64 {
        (1.0 - self.reflectance - self.transmittance.unwrap_or(0.0)).max(0.0)
    }
}

/// A number that is the same at every wavelength.
fn constant(values: &[f64]) -> std::result::Result<f64, Unfit> {
    match values {
        [first, rest @ ..] if rest.iter().all(|value| value == first) => Ok(*first),
        _ => Err(Unfit::ByWavelength),
    }
}

/// The shares of light that a surface scatters through and back (shaders/stages/scatter.on.wgsl).
fn scattered_shares(surface: &Surface) -> [Share; 2] {
    let is_mirror = matches!(surface.interaction, Interaction::Reflective { .. });
    match surface.scatter.as_ref().map(|scatter| &scatter.bsdf) {
        // A mirror takes its part before it scatters.
        _ if is_mirror => [Share::Reflected; 2],
        Some(Bsdf::Lambertian(_)) => [Share::Either; 2],
        None => [Share::Mixed; 2],
        // A table is read at the angle of the drawn ray, and its lobe is about the normal.
        Some(lobe) if lobe.is_about_normal() => [Share::Mixed; 2],
        // About the drawn ray, or about its mirror image on the other side.
        Some(lobe) if lobe.transmissive_fraction() >= 1.0 => [Share::Transmitted, Share::Reflected],
        Some(lobe) if lobe.transmissive_fraction() <= 0.0 => [Share::Reflected, Share::Transmitted],
        Some(_) => [Share::Mixed; 2],
    }
}

impl Change {
    /// The new coating of a surface, if the trace has all light that the coating would send on.
    fn new(ir: &SceneIr, surface: usize, wanted: &NewCoating) -> Result<Self> {
        let name = ir.surface_name(surface);
        let refuse = |problem: String, advice: &str| {
            Err(Error::Usage(format!("recoat {name}: the face {problem}; {advice}")))
        };
        let before = match Constants::of(&ir.surfaces[surface]) {
            Ok(before) => before,
            Err(unfit) => return refuse(unfit.text().into(), unfit.advice()),
        };
        let reflectance = wanted.reflectance;
        if !(0.0..=1.0).contains(&reflectance) {
            return refuse(format!("cannot reflect {reflectance}"), "give a reflectance from 0 to 1");
        }
        if before.reflectance == 0.0 {
            let problem = "reflects nothing, so the light that it would reflect was not traced";
            return refuse(problem.into(), "trace it with a reflectance above 0 first");
        }
        let transmittance = match (before.transmittance, wanted.transmittance) {
            (None, None) => 0.0,
            (None, Some(_)) => return refuse("is a mirror, and transmits nothing".into(), "give R alone"),
            (Some(_), Some(transmittance)) if (0.0..=1.0).contains(&transmittance) => transmittance,
            (Some(_), Some(transmittance)) => {
                return refuse(
                    format!("cannot transmit {transmittance}"),
                    "give a transmittance from 0 to 1",
                );
            }
            (Some(_), None) => {
                let left = 1.0 - reflectance - before.absorptance();
                if left < -ROUNDING {
                    let problem = format!(
                        "absorbs {}, which leaves less than R = {reflectance}",
                        significant(before.absorptance(), 4)
                    );
                    return refuse(problem, "give R and T, as FACE=R,T");
                }
                if left < ROUNDING { 0.0 } else { left }
            }
        };
        if reflectance + transmittance > 1.0 + ROUNDING {
            let problem =
                format!("would give more light than it gets: R = {reflectance} and T = {transmittance}");
            return refuse(problem, "give R + T <= 1; what is left of 1 is absorbed");
        }
        if before.transmittance == Some(0.0) && transmittance > 0.0 {
            let problem = format!("transmits nothing, so the light of T = {transmittance} was not traced");
            return refuse(
                problem,
                "give T = 0, as FACE=R,0, or trace it with a transmittance above 0 first",
            );
        }
        Ok(Change { name, before, reflectance, transmittance })
    }

    /// R'/R, T'/T and (R' + T')/(R + T).
    fn ratios(&self) -> [f64; 3] {
        let (r, t) = (self.before.reflectance, self.before.transmittance.unwrap_or(0.0));
        // Where T is 0, no light passed.
        let of_transmitted = if t > 0.0 { self.transmittance / t } else { 1.0 };
        [self.reflectance / r, of_transmitted, (self.reflectance + self.transmittance) / (r + t)]
    }

    /// What the flux of such a sequence is multiplied by.
    fn factor(&self, uses: Uses) -> f64 {
        let [r, t, either] = self.ratios();
        r.powi(uses.reflected) * t.powi(uses.transmitted) * either.powi(uses.either)
    }

    /// The derivative of the factor by R, where T falls as R rises: R + T does not change.
    fn slope(&self, uses: Uses) -> f64 {
        let [r, t, either] = self.ratios();
        let Uses { reflected: k, transmitted: m, .. } = uses;
        // k r^(k - 1), and no quotient: the new R may be 0.
        let power = |ratio: f64, exponent: i32| {
            if exponent == 0 { 0.0 } else { f64::from(exponent) * ratio.powi(exponent - 1) }
        };
        let of_r = power(r, k) / self.before.reflectance * t.powi(m);
        let of_t = match self.before.transmittance.filter(|t| *t > 0.0) {
            Some(before) => r.powi(k) * power(t, m) / before,
            None => 0.0,
        };
        (of_r - of_t) * either.powi(uses.either)
    }

    /// True if light that was totally reflected would get a wrong factor.
    fn changes_reflection(&self, uses: Uses) -> bool {
        let [r, _, either] = self.ratios();
        (uses.reflected > 0 && r != 1.0) || (uses.either > 0 && (either - 1.0).abs() > ROUNDING)
    }

    fn recoated(&self) -> Recoated {
        let transmittance = self.before.transmittance.map(|_| self.transmittance);
        Recoated {
            face: self.name.clone(),
            old_reflectance: self.before.reflectance,
            old_transmittance: self.before.transmittance,
            reflectance: self.reflectance,
            transmittance,
        }
    }
}

impl Recoating {
    /// The new coatings of a scene.
    ///
    /// # Errors
    /// [`Error::Usage`] if there is no such face, or its trace does not say what another coating would do.
    pub fn new(ir: &SceneIr, wanted: &[NewCoating]) -> Result<Self> {
        let mut faces = BTreeMap::new();
        for coating in wanted {
            let surface = surface_of(ir, &coating.face)?;
            if faces.insert(surface as u32, Change::new(ir, surface, coating)?).is_some() {
                let face = &coating.face;
                return Err(Error::Usage(format!("recoat {face}: the face is named twice; name it once")));
            }
        }
        Ok(Recoating { faces })
    }

    /// True if no face is changed.
    pub fn is_empty(&self) -> bool {
        self.faces.is_empty()
    }

    /// The changed faces.
    pub fn recoated(&self) -> Vec<Recoated> {
        self.faces.values().map(Change::recoated).collect()
    }

    /// What the flux of a sequence is multiplied by.
    pub fn factor(&self, sequence: &Sequence) -> f64 {
        self.factor_without(sequence, None)
    }

    fn factor_without(&self, sequence: &Sequence, left_out: Option<u32>) -> f64 {
        let others = self.faces.iter().filter(|(surface, _)| Some(**surface) != left_out);
        others.map(|(surface, change)| change.factor(change.before.uses(sequence, *surface))).product()
    }

    /// The derivative of [`Recoating::factor`] by the reflectance of a face, changed or not, with its absorption held.
    pub(crate) fn slope(&self, sequence: &Sequence, surface: u32, constants: Constants) -> f64 {
        let unchanged = || Change {
            name: String::new(),
            before: constants,
            reflectance: constants.reflectance,
            transmittance: constants.transmittance.unwrap_or(0.0),
        };
        let change = self.faces.get(&surface).cloned().unwrap_or_else(unchanged);
        change.slope(constants.uses(sequence, surface)) * self.factor_without(sequence, Some(surface))
    }

    /// The reflectance of a changed face.
    pub(crate) fn reflectance(&self, surface: u32) -> Option<f64> {
        self.faces.get(&surface).map(|change| change.reflectance)
    }

    /// Checks that the factor of each sequence is known.
    ///
    /// # Errors
    /// [`Error::Usage`] if a changed face scatters light of both of its branches into one step of a sequence.
    pub fn check<'a>(&self, ir: &SceneIr, sequences: impl Iterator<Item = &'a Sequence>) -> Result<()> {
        let mut refused: BTreeMap<u32, (u64, &Sequence)> = BTreeMap::new();
        for sequence in sequences {
            let mixed = self
                .faces
                .iter()
                .filter(|(surface, change)| change.before.uses(sequence, **surface).mixed > 0);
            mixed.for_each(|(surface, _)| refused.entry(*surface).or_insert((0, sequence)).0 += 1);
        }
        let Some((surface, (count, sequence))) = refused.pop_first() else { return Ok(()) };
        let name = &self.faces[&surface].name;
        Err(Error::Usage(format!(
            "recoat {name}: {} scattered there after reflection or after transmission, and no path says after which, such \
             as {:?}; leave such light out by --where 'not scattered({name:?})', or compare two scenes with \
             `nsq-gpu diff A B`",
            if count == 1 { "1 path is".into() } else { format!("{} paths are", thousands(count)) },
            sequence.text(ir),
        )))
    }

    /// What the user should know of sequences, each with its flux in the trace \[W\].
    pub fn warnings<'a>(
        &self,
        ir: &SceneIr,
        paths: impl Iterator<Item = (&'a Sequence, f64)>,
    ) -> Vec<String> {
        let mut found: BTreeMap<u32, (u64, f64)> = BTreeMap::new();
        for (sequence, flux) in paths.filter(|_| !self.is_empty()) {
            let is_concerned = |surface: &u32| {
                let change = self.faces.get(surface);
                change.is_some_and(|change| change.changes_reflection(change.before.uses(sequence, *surface)))
            };
            if !sequence.steps.iter().any(|step| is_concerned(&step.surface)) {
                continue;
            }
            let total = total_reflection::possible(ir, sequence);
            for surface in total.into_iter().filter(is_concerned) {
                let (count, sum) = found.entry(surface).or_default();
                (*count, *sum) = (*count + 1, *sum + flux);
            }
        }
        let text = |(surface, (count, flux)): (u32, (u64, f64))| {
            format!(
                "{}: in {}, with {} W in the trace, light may have been totally reflected there. No coating changes such \
                 light, but the table does; `nsq-gpu diff A B` does not",
                self.faces[&surface].name,
                if count == 1 { "1 path".into() } else { format!("{} paths", thousands(count)) },
                significant(flux, 4),
            )
        };
        found.into_iter().map(text).collect()
    }
}

/// The surface of this name.
fn surface_of(ir: &SceneIr, face: &str) -> Result<usize> {
    let names: Vec<String> = (0..ir.surfaces.len()).map(|surface| ir.surface_name(surface)).collect();
    let mut found = (0..).zip(&names).filter(|(_, name)| *name == face).map(|(surface, _)| surface);
    match (found.next(), found.next()) {
        (Some(surface), None) => Ok(surface),
        (Some(_), Some(_)) => Err(Error::Usage(format!(
            "recoat {face}: several faces have this name; give each face a name of its own"
        ))),
        (None, _) => {
            let parts: Vec<&str> = names
                .iter()
                .filter(|name| name.strip_prefix(face).is_some_and(|rest| rest.starts_with('.')))
                .map(String::as_str)
                .collect();
            let known = if parts.is_empty() { names.iter().map(String::as_str).collect() } else { parts };
            let advice = did_you_mean(face, known.iter().copied());
            Err(Error::Usage(format!("recoat {face:?}: the scene has no face of this name; {advice}")))
        }
    }
}

/// The sequence of a row, as a table has it: its text, its steps, and its detector.
///
/// # Errors
/// [`Error::Usage`] if the row stands for several sequences, or is not one of this scene.
pub fn sequence_of(
    ir: &SceneIr,
    text: &str,
    steps: &[[String; 2]],
    detector: Option<&str>,
) -> Result<Sequence> {
    let found = read_sequence(ir, text, steps, detector).filter(|sequence| sequence.text(ir) == text);
    found.ok_or_else(|| {
        let is_group = text.starts_with("* > ") || (steps.is_empty() && text.contains(" scattering"));
        Error::Usage(match is_group {
            true => format!(
                "recoat: the row {text:?} stands for several paths, which another coating may change differently; trace \
                 with group=\"sequence\", where each path is a row, or recoat by `nsq-gpu paths --recoat`"
            ),
            false => format!("recoat: the row {text:?} is no path to a detector of this scene; give its own scene"),
        })
    })
}

fn read_sequence(
    ir: &SceneIr,
    text: &str,
    steps: &[[String; 2]],
    detector: Option<&str>,
) -> Option<Sequence> {
    let begins = |source: &str| text.strip_prefix(source).is_some_and(|rest| rest.starts_with(" > "));
    let sources = (0..).zip(&ir.sources).filter(|(_, source)| begins(&source.name));
    let (source, _) = sources.max_by_key(|(_, source)| source.name.len())?;
    let number = ir.detectors.iter().position(|known| Some(known.name.as_str()) == detector)?;
    let names: BTreeMap<String, u32> =
        (0..ir.surfaces.len()).rev().map(|surface| (ir.surface_name(surface), surface as u32)).collect();
    let step = |[letters, name]: &[String; 2]| {
        let kind = StepKind::ALL.into_iter().find(|kind| kind.letters() == letters)?;
        Some(Step { kind, surface: *names.get(name)? })
    };
    let steps = steps.iter().map(step).collect::<Option<Vec<Step>>>()?;
    Some(Sequence { source, steps, end: End::Detector(number as u32) })
}
