//! Which coatings matter most: how much the flux of the ghosts changes with the reflectance of each face.
//!
//! A ghost is a path of at least two reflections. Take a ghost of flux F that a face reflects k times and lets pass m
//! times. With the absorption held, T falls as R rises, so dF/dR = F (k/R - m/T).

use crate::format::{listed, plain, shown, significant, thousands};
use crate::model::{Interaction, SceneIr, Sequence, StepKind};
use crate::result::recoat::{Constants, Recoating};
use crate::result::total_reflection;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt::Write;

/// Reflections along a path that make it a ghost.
pub const GHOST_REFLECTIONS: usize = 2;

/// Faces that a terminal shows.
const MOST_FACES: usize = 50;

/// A face, and what its coating does to the ghosts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CoatingRank {
    /// The name of the face.
    pub face: String,
    /// Its reflectance; null where that is no constant.
    pub reflectance: Option<f64>,
    /// The derivative of the flux of all listed ghosts by the reflectance \[W\]; null where `reason` says why.
    pub derivative: Option<f64>,
    /// Its standard error \[W\]; null where it is not known. Where a ray can bring several ghosts, it is an upper bound.
    pub standard_error: Option<f64>,
    /// The share of the ghosts' flux that the face reflects at least once.
    pub share: f64,
    /// The derivative of the highest peak among the ghosts \[W/mm^2\]; null where no ghost has a map.
    pub peak_derivative: Option<f64>,
    /// Why there is no derivative.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}

/// A ghost as it was traced.
#[derive(Debug, Clone)]
pub struct Ghost<'a> {
    /// Its sequence.
    pub sequence: &'a Sequence,
    /// Its flux \[W\].
    pub flux: f64,
    /// The standard error of that \[W\], if it is known.
    pub standard_error: Option<f64>,
}

/// The ghost of the highest peak.
#[derive(Debug, Clone)]
pub struct BrightestGhost<'a> {
    /// Its sequences, which the new coatings change alike.
    pub sequences: Vec<&'a Sequence>,
    /// Its peak with the new coatings \[W/mm^2\].
    pub peak_irradiance: f64,
}

/// Whose flux is differentiated.
#[derive(Debug, Clone)]
pub struct Ghosts<'a> {
    /// The ghosts, as they were traced.
    pub all: Vec<Ghost<'a>>,
    /// True if a ray brings light to one of them at most.
    pub are_exclusive: bool,
    /// The one of the highest peak, if some have maps.
    pub brightest: Option<BrightestGhost<'a>>,
}

impl<'a> Ghosts<'a> {
    /// The ghosts among paths, of which none has a map.
    pub fn among(ir: &SceneIr, paths: impl Iterator<Item = Ghost<'a>>) -> Self {
        let all: Vec<Ghost> = paths.filter(|path| is_ghost(path.sequence)).collect();
        let are_exclusive = all.iter().all(|ghost| ghost.sequence.end.is_exclusive(ir));
        Ghosts { all, are_exclusive, brightest: None }
    }
}

/// True for a path that counts as a ghost.
fn is_ghost(sequence: &Sequence) -> bool {
    sequence.end.detector().is_some() && sequence.reflections() >= GHOST_REFLECTIONS
}

/// The faces that ghosts meet, those first whose removal takes most flux: |dF/dR| R.
pub fn rank(ir: &SceneIr, recoating: &Recoating, ghosts: &Ghosts) -> Vec<CoatingRank> {
    let mut faces: Vec<u32> =
        ghosts.all.iter().flat_map(|ghost| ghost.sequence.steps.iter().map(|step| step.surface)).collect();
    faces.sort_unstable();
    faces.dedup();
    let mut ranks: Vec<CoatingRank> =
        faces.into_iter().map(|surface| of_face(ir, recoating, ghosts, surface)).collect();
    let gain = |rank: &CoatingRank| {
        let product = rank.derivative.zip(rank.reflectance).map(|(slope, r)| slope.abs() * r);
        // Faces without a derivative come last.
        (product.unwrap_or(-1.0), rank.share)
    };
    ranks.sort_by(|a, b| {
        let ((a_gain, a_share), (b_gain, b_share)) = (gain(a), gain(b));
        b_gain.total_cmp(&a_gain).then(b_share.total_cmp(&a_share))
    });
    ranks
}

fn of_face(ir: &SceneIr, recoating: &Recoating, ghosts: &Ghosts, surface: u32) -> CoatingRank {
    let constants = Constants::of(&ir.surfaces[surface as usize]);
    let reason = match constants {
        Err(unfit) => Some(unfit.text().to_string()),
        Ok(constants) => no_derivative(ghosts, surface, constants).map(str::to_string),
    };
    let known = constants.ok().filter(|_| reason.is_none());
    let (derivative, standard_error) = match known {
        Some(constants) => sum_of_slopes(recoating, ghosts, surface, constants),
        None => (None, None),
    };
    let before = constants.ok().map(|constants| constants.reflectance);
    CoatingRank {
        face: ir.surface_name(surface as usize),
        reflectance: recoating.reflectance(surface).or(before),
        derivative,
        standard_error,
        share: share(recoating, ghosts, surface),
        peak_derivative: known
            .and_then(|constants| peak_slope(recoating, ghosts.brightest.as_ref()?, surface, constants)),
        reason,
    }
}

/// Why the derivative by a constant reflectance is not known.
fn no_derivative(ghosts: &Ghosts, surface: u32, constants: Constants) -> Option<&'static str> {
    let is_mixed = |ghost: &Ghost| constants.uses(ghost.sequence, surface).mixed > 0;
    match () {
        () if constants.reflectance == 0.0 => {
            Some("reflects nothing, so the ghosts that it would make were not traced")
        }
        () if ghosts.all.iter().any(is_mixed) => {
            Some("scatters after reflection or after transmission, and no path says after which")
        }
        () => None,
    }
}

fn sum_of_slopes(
    recoating: &Recoating,
    ghosts: &Ghosts,
    surface: u32,
    constants: Constants,
) -> (Option<f64>, Option<f64>) {
    let slope = |ghost: &Ghost| recoating.slope(ghost.sequence, surface, constants);
    let derivative = ghosts.all.iter().map(|ghost| slope(ghost) * ghost.flux).sum();
    // The error of the sum is known only where the error of each ghost is.
    let errors = ghosts.all.iter().map(|ghost| Some((slope(ghost) * ghost.standard_error?).abs()));
    let errors: Option<Vec<f64>> = errors.collect();
    let joint = |errors: Vec<f64>| match ghosts.are_exclusive {
        true => errors.iter().map(|error| error * error).sum::<f64>().sqrt(),
        false => errors.iter().sum(),
    };
    (Some(derivative), errors.map(joint))
}

/// The share of the ghosts' flux that a face reflects.
fn share(recoating: &Recoating, ghosts: &Ghosts, surface: u32) -> f64 {
    let flux = |ghost: &Ghost| recoating.factor(ghost.sequence) * ghost.flux;
    let total: f64 = ghosts.all.iter().map(flux).sum();
    let reflects = |ghost: &&Ghost| {
        ghost.sequence.steps.iter().any(|step| step.surface == surface && step.kind == StepKind::Reflected)
    };
    let own: f64 = ghosts.all.iter().filter(reflects).map(flux).sum();
    if total > 0.0 { own / total } else { 0.0 }
}

/// The derivative of a peak, where all paths of its ghost have one relative derivative.
fn peak_slope(
    recoating: &Recoating,
    brightest: &BrightestGhost,
    surface: u32,
    constants: Constants,
) -> Option<f64> {
    let relative = |sequence: &&Sequence| {
        let factor = recoating.factor(sequence);
        (factor > 0.0).then(|| recoating.slope(sequence, surface, constants) / factor)
    };
    let first = brightest.sequences.first().and_then(relative)?;
    let is_alike = |slope: f64| (slope - first).abs() <= 1e-12 * first.abs();
    let are_alike = brightest.sequences.iter().all(|sequence| relative(sequence).is_some_and(is_alike));
    are_alike.then_some(first * brightest.peak_irradiance)
}

/// What the user should know: ghosts whose reflections may be total, which no coating changes.
pub fn warnings(ir: &SceneIr, ghosts: &Ghosts) -> Vec<String> {
    let mut found: BTreeMap<u32, u64> = BTreeMap::new();
    let is_ranked = |surface: &u32| {
        let surface = &ir.surfaces[*surface as usize];
        surface.interaction == Interaction::Refractive && Constants::of(surface).is_ok()
    };
    for ghost in &ghosts.all {
        if ghost.sequence.steps.iter().any(|step| is_ranked(&step.surface)) {
            let total = total_reflection::possible(ir, ghost.sequence);
            total.into_iter().filter(is_ranked).for_each(|face| *found.entry(face).or_default() += 1);
        }
    }
    if found.is_empty() {
        return Vec::new();
    }
    let names: Vec<String> = found
        .iter()
        .map(|(face, count)| format!("{} ({})", ir.surface_name(*face as usize), thousands(*count)))
        .collect();
    vec![format!(
        "light of ghosts may have been totally reflected at {}, by the number of their paths. No coating changes such light, \
         but dF/dR takes it for what the coating reflects",
        listed(names.iter())
    )]
}

/// The faces for a terminal, and why some have no derivative.
pub fn text(ranks: &[CoatingRank]) -> String {
    let shown_ranks = &ranks[..MOST_FACES.min(ranks.len())];
    let widest = shown_ranks.iter().map(|rank| shown(&rank.face).chars().count()).max().unwrap_or(0);
    let width = widest.max(4) + 2;
    let has_peaks = shown_ranks.iter().any(|rank| rank.peak_derivative.is_some());
    let mut text =
        format!("{:<width$}{:>12}{:>12}{:>12}{:>14}", "face", "R", "dF/dR W", "std. error", "% of ghosts");
    text.push_str(if has_peaks { "   dpeak/dR W/mm2\n" } else { "\n" });
    let known = |value: Option<f64>, digits| value.map_or("-".into(), |value| significant(value, digits));
    for rank in shown_ranks {
        let _ = write!(
            text,
            "{:<width$}{:>12}{:>12}{:>12}{:>14}",
            shown(&rank.face),
            known(rank.reflectance, 4),
            known(rank.derivative, 5),
            known(rank.standard_error, 2),
            significant(100.0 * rank.share, 4),
        );
        if has_peaks {
            let _ = write!(text, "{:>17}", known(rank.peak_derivative, 4));
        }
        text.push('\n');
    }
    let hidden = ranks.len() - shown_ranks.len();
    if hidden > 0 {
        let _ = writeln!(text, "{} more faces", thousands(hidden as u64));
    }
    text + &reasons(shown_ranks)
}

/// A line a reason, with the faces that have it.
fn reasons(ranks: &[CoatingRank]) -> String {
    let mut by_reason: BTreeMap<&str, Vec<String>> = BTreeMap::new();
    for rank in ranks {
        if let Some(reason) = &rank.reason {
            by_reason.entry(reason).or_default().push(plain(&rank.face));
        }
    }
    by_reason.iter().fold(String::new(), |mut text, (reason, faces)| {
        let _ = writeln!(text, "-: no dF/dR, as the face {reason}: {}", listed(faces.iter()));
        text
    })
}
