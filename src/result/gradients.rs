//! Derivatives of what detectors recorded, by parameters.

use crate::format::{score, shown, significant};
use crate::result::{Detector, FewRays, few_rays};
use ndarray::ArrayD;
use serde::{Deserialize, Serialize};
use std::fmt::Write;

/// The derivatives of one detector by one parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Gradient {
    /// What users call the parameter, such as `L1.r1`.
    pub parameter: String,
    /// The detector's name.
    pub detector: String,
    /// Derivative of the detector's flux, in W per unit of the parameter: mm, um, rad, W or 1, and degrees where the file has
    /// degrees.
    pub flux: f64,
    /// Its standard error; none from too few rays.
    pub standard_error: Option<f64>,
    /// Derivative of the detector's map, in the shape and order of its array, in the map's unit per unit of the
    /// parameter. `None` for a ray database.
    #[serde(skip)]
    pub map: Option<ArrayD<f64>>,
    /// Standard errors of `map`.
    #[serde(skip)]
    pub map_errors: Option<ArrayD<f64>>,
    /// Derivatives of deposits that were no number, or too large to be summed: they are missing.
    pub num_lost: u64,
    /// The same derivative by a difference of two traces, edges included; where that was asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub with_edges: Option<WithEdges>,
}

/// A derivative by a difference of two traces, which sees what moves across edges, too.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WithEdges {
    /// Derivative of the detector's flux, as in [`Gradient`].
    pub flux: f64,
    /// Its standard error; none from too few rays.
    pub standard_error: Option<f64>,
    /// Derivative of the detector's map, as in [`Gradient`].
    #[serde(skip)]
    pub map: Option<ArrayD<f64>>,
    /// Standard errors of `map`.
    #[serde(skip)]
    pub map_errors: Option<ArrayD<f64>>,
    /// What is known of a derivative that rests on few rays. The bound is one of its size.
    #[serde(flatten)]
    pub few_rays: Option<FewRays>,
}

/// What a table of derivatives lacks, unless a difference of two traces stands beside them.
pub const WITHOUT_EDGES: &str =
    "light that crosses edges, such as a lens's rim, is not in these: --gradient-edges says how much\n";

/// Derivatives of fluxes as a table for a terminal, of a trace that launched a flux \[W\] and found these detectors.
pub fn table(gradients: &[Gradient], found: &[Detector], launched: f64) -> String {
    let width = |name: fn(&Gradient) -> &String, title: &str| {
        gradients.iter().map(|row| shown(name(row)).chars().count()).max().unwrap_or(0).max(title.len()) + 2
    };
    let (parameters, detectors) =
        (width(|row| &row.parameter, "parameter"), width(|row| &row.detector, "detector"));
    let mut text = format!(
        "{:<parameters$}{:<detectors$}{:>15}{:>11}{:>9}",
        "parameter", "detector", "d flux [W/.]", "error", "sigmas"
    );
    if gradients.iter().any(|row| row.with_edges.is_some()) {
        let _ = write!(text, "{:>15}{:>11}", "with edges", "error");
    }
    text.push('\n');
    for row in gradients {
        let of_detector = found.iter().find(|detector| detector.name == row.detector);
        let few = of_detector.and_then(|detector| detector.few_rays);
        // What few rays scatter by says nothing of the others.
        let standard_error = row.standard_error.filter(|_| few.is_none());
        let error = standard_error.map_or("-".into(), |error| significant(error, 2));
        let score = if few.is_some() { "-".into() } else { score(row.flux, standard_error, launched) };
        let (parameter, detector) = (shown(&row.parameter), shown(&row.detector));
        let flux = significant(row.flux, 5);
        let _ = write!(text, "{parameter:<parameters$}{detector:<detectors$}{flux:>15}{error:>11}{score:>9}");
        if let Some(WithEdges { flux, standard_error, few_rays, .. }) = &row.with_edges {
            let error = few_rays::error_or_bound(*few_rays, *standard_error);
            let _ = write!(text, "{:>15}{error:>11}", significant(*flux, 5));
        }
        text += &few_rays::remark(row.with_edges.as_ref().map_or(few, |edges| edges.few_rays.or(few)));
        if row.num_lost > 0 {
            let _ = write!(
                text,
                "  {} derivatives were no numbers, or too large: they are missing",
                row.num_lost
            );
        }
        text.push('\n');
    }
    text
}
