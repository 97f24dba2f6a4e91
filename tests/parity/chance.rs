//! Compares means over independent runs: Welch's t of every figure, with a Sidak bound over all of them.

use nsq_gpu::TraceResult;
use statrs::distribution::{ContinuousCDF, StudentsT};

use crate::agreement::{MapView, counts, fluxes, totals_of};
use crate::oracle::{Means, Statistics};

/// Probability that a correct tracer fails the comparison of a scene.
const SIGNIFICANCE: f64 = 1e-3;
/// Bins with fewer hits over all of the reference's runs are left to the detector's total: t needs means that are
/// normal.
const MIN_HITS: f64 = 100.0;
/// Relative difference of figures that never vary.
const CONSTANT: f64 = 1e-11;

/// One figure: its name, our value in each run, and the reference's mean and standard error.
struct Figure {
    name: String,
    ours: Vec<f64>,
    mean: f64,
    standard_error: f64,
}

/// What differs by more than chance, and the number of figures compared.
pub fn differences(ours: &[TraceResult], theirs: &Statistics) -> (Vec<String>, usize) {
    let figures = figures(ours, theirs);
    let level = 1.0 - (1.0 - SIGNIFICANCE).powf(1.0 / figures.len() as f64);
    let differ = figures.iter().filter_map(|figure| {
        let p = figure.probability(theirs.runs);
        (p.is_nan() || p < level).then(|| format!("{}: p = {p:.2e} < {level:.2e}", figure.name))
    });
    (differ.collect(), figures.len())
}

fn figures(ours: &[TraceResult], theirs: &Statistics) -> Vec<Figure> {
    let mut figures = totals(ours, theirs);
    for (name, detector) in &theirs.detectors {
        let mine: Vec<_> = ours.iter().map(|run| run.detector(name).expect("the detector is ours")).collect();
        let hits = mine.iter().map(|detector| detector.num_rays_hit as f64).collect();
        figures.push(figure(&format!("{name}: num_rays_hit"), hits, &detector.num_rays_hit, 0));
        let flux = mine.iter().map(|detector| detector.total_flux).collect();
        figures.push(figure(&format!("{name}: total_flux"), flux, &detector.total_flux, 0));
        let Some(map) = &detector.map else { continue };
        let views: Vec<MapView> = mine.iter().map(|detector| MapView::of(&detector.data)).collect();
        let hits_per_value =
            detector.num_rays_hit.mean[0] * theirs.runs as f64 / map.mean.iter().sum::<f64>().max(1e-300);
        let lit = (0..map.mean.len()).filter(|&bin| map.mean[bin] * hits_per_value >= MIN_HITS);
        figures.extend(lit.map(|bin| {
            let values = views.iter().map(|view| view.values[bin]).collect();
            figure(&format!("{name}: bin {bin}"), values, map, bin)
        }));
    }
    figures
}

fn totals(ours: &[TraceResult], theirs: &Statistics) -> Vec<Figure> {
    let ours: Vec<Vec<(&str, f64)>> = ours
        .iter()
        .map(|run| {
            let totals = totals_of(run);
            let counts = counts(&totals).map(|(name, count)| (name, count as f64));
            counts.into_iter().chain(fluxes(&totals)).collect()
        })
        .collect();
    let names = ours[0].iter().map(|(name, _)| *name).enumerate();
    names
        .map(|(i, name)| figure(name, ours.iter().map(|run| run[i].1).collect(), &theirs.totals[name], 0))
        .collect()
}

fn figure(name: &str, ours: Vec<f64>, means: &Means, i: usize) -> Figure {
    Figure { name: name.to_string(), ours, mean: means.mean[i], standard_error: means.standard_error[i] }
}

impl Figure {
    /// Probability of a difference as large as this by chance.
    fn probability(&self, their_runs: usize) -> f64 {
        let runs = self.ours.len() as f64;
        let mean = self.ours.iter().sum::<f64>() / runs;
        let squares: f64 = self.ours.iter().map(|value| (value - mean).powi(2)).sum();
        let (mine, other) = (squares / (runs - 1.0) / runs, self.standard_error.powi(2));
        let scale = self.mean.abs().max(1e-300);
        if mine + other <= (1e-12 * scale).powi(2) {
            return if (mean - self.mean).abs() <= CONSTANT * scale { 1.0 } else { 0.0 };
        }
        let t = (mean - self.mean) / (mine + other).sqrt();
        let freedom = (mine + other).powi(2)
            / (mine.powi(2) / (runs - 1.0) + other.powi(2) / (their_runs as f64 - 1.0));
        let distribution = StudentsT::new(0.0, 1.0, freedom).expect("the degrees of freedom are positive");
        2.0 * distribution.sf(t.abs())
    }
}
