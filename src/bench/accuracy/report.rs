//! The files of `nsq-gpu bench --accuracy`.

use crate::bench::accuracy::claims::{Verdict, at_least};
use crate::bench::accuracy::curves::{Curve, FIRST_RAYS, Point, SceneCurves};
use crate::bench::accuracy::numerical::Numerical;
use crate::bench::accuracy::variances::Ratio;
use crate::bench::machine;
use crate::error::{Error, Result};
use crate::gpu::AdapterInfo;
use crate::placing::replace_file;
use crate::result::png::curves::{Curves, Panel, Quantity, write_curves};
use std::fmt::{Display, Formatter, Write};
use std::path::{Path, PathBuf};

/// All measurements.
#[derive(Debug, Clone, PartialEq)]
pub struct AccuracyReport {
    /// The adapter's name and driver.
    pub adapter: String,
    /// The time of the measurement, in UTC.
    pub date: String,
    /// A note for the reader, such as who else used the machine.
    pub note: Option<String>,
    /// Error against time, by scene.
    pub scenes: Vec<SceneCurves>,
    /// The error of arithmetic alone.
    pub numerical: Vec<Numerical>,
    /// The measured claims about Sobol points.
    pub verdicts: Vec<Verdict>,
}

/// Columns of `accuracy.csv`. Errors of maps are in units of the mean pixel, and those of fluxes in units of the flux.
pub const CURVE_COLUMNS: [&str; 12] = [
    "scene",
    "detector",
    "engine",
    "method",
    "num_rays",
    "median_seconds",
    "min_seconds",
    "max_seconds",
    "map_rms_error",
    "flux_error",
    "answer_map_error",
    "answer_flux_error",
];

/// Columns of `numerical.csv`.
pub const NUMERICAL_COLUMNS: [&str; 11] = [
    "scene",
    "shader",
    "against",
    "num_rays",
    "ns_per_ray",
    "num_arrivals",
    "position_rms_mm",
    "position_max_mm",
    "flux_rms",
    "flux_max",
    "share_of_other_fate",
];

/// Columns of `sobol.csv`.
pub const CLAIM_COLUMNS: [&str; 15] = [
    "scene",
    "detector",
    "split_depth",
    "num_rays",
    "pcg_traces",
    "sobol_traces",
    "map_pcg_error",
    "map_ratio",
    "map_ratio_low",
    "map_ratio_high",
    "map_least",
    "flux_ratio",
    "flux_ratio_low",
    "flux_ratio_high",
    "flux_least",
];

impl AccuracyReport {
    /// An empty report.
    pub fn new(info: &AdapterInfo, note: Option<String>) -> Self {
        AccuracyReport {
            adapter: info.name.clone(),
            date: machine::utc_now(),
            note,
            scenes: Vec::new(),
            numerical: Vec::new(),
            verdicts: Vec::new(),
        }
    }

    /// Writes the files of the measurements into `dir`, which is created if it does not exist. Returns their paths.
    ///
    /// # Errors
    /// [`Error::File`] with the file or folder that could not be written.
    pub fn write_all(&self, dir: &Path) -> Result<Vec<PathBuf>> {
        std::fs::create_dir_all(dir).map_err(|error| Error::file(dir, error))?;
        let mut texts = vec![("accuracy.txt", self.table())];
        let mut charts = Vec::new();
        if !self.scenes.is_empty() {
            texts.push(("accuracy.csv", self.curves_csv()));
            charts.extend([("accuracy.png", self.map_chart()), ("accuracy_flux.png", self.flux_chart())]);
        }
        if !self.numerical.is_empty() {
            texts.push(("numerical.csv", self.numerical_csv()));
            charts.push(("numerical.png", self.numerical_chart()));
        }
        if !self.verdicts.is_empty() {
            texts.push(("sobol.csv", self.claims_csv()));
        }
        for (name, text) in &texts {
            replace_file(&dir.join(name), text.as_bytes())
                .map_err(|error| Error::file(dir.join(name), error))?;
        }
        for (name, chart) in &charts {
            write_curves(&dir.join(name), chart)?;
        }
        let names = texts.iter().map(|(name, _)| name).chain(charts.iter().map(|(name, _)| name));
        Ok(names.map(|name| dir.join(name)).collect())
    }

    fn curves_csv(&self) -> String {
        let mut text = CURVE_COLUMNS.join(",") + "\n";
        for scene in &self.scenes {
            for curve in &scene.curves {
                for point in &curve.points {
                    text += &curve_line(scene, curve, point);
                }
            }
        }
        text
    }

    fn numerical_csv(&self) -> String {
        let mut text = NUMERICAL_COLUMNS.join(",") + "\n";
        for row in &self.numerical {
            let Numerical { scene, shader, against, num_rays, ns_per_ray, same, .. } = row;
            let _ = writeln!(
                text,
                "{scene},{shader},{against},{num_rays},{ns_per_ray:.1},{},{:e},{:e},{:e},{:e},{:e}",
                same.num_arrivals,
                same.position_rms,
                same.position_max,
                same.flux_rms,
                same.flux_max,
                row.other_fate()
            );
        }
        text
    }

    fn claims_csv(&self) -> String {
        let mut text = CLAIM_COLUMNS.join(",") + "\n";
        for Verdict { claim, map, flux, map_error } in &self.verdicts {
            let [pcg_traces, sobol_traces] = claim.num_traces();
            let split = claim.split.map_or(0, |split| split.0);
            let ratio = |ratio: &Option<Ratio>| match ratio {
                Some(Ratio { low, value, high }) => format!("{value:.3},{low:.3},{high:.3}"),
                None => ",,".into(),
            };
            let least = |least: Option<f64>| least.map_or(String::new(), |least| least.to_string());
            let _ = writeln!(
                text,
                "{},{},{split},{},{pcg_traces},{sobol_traces},{map_error:.4e},{},{},{},{}",
                claim.scene.name,
                claim.scene.detector,
                claim.num_rays,
                ratio(map),
                least(claim.map),
                ratio(flux),
                least(claim.flux)
            );
        }
        text
    }

    /// The tables for people.
    pub fn table(&self) -> String {
        let mut text = format!(
            "{} {} on {}, {}\n",
            env!("CARGO_PKG_NAME"),
            env!("CARGO_PKG_VERSION"),
            self.adapter,
            self.date
        );
        if !self.scenes.is_empty() {
            self.curves_table(&mut text);
        }
        if !self.numerical.is_empty() {
            self.numerical_table(&mut text);
        }
        if !self.verdicts.is_empty() {
            self.claims_table(&mut text);
        }
        text
    }

    fn curves_table(&self, text: &mut String) {
        *text += "\nError and time with the most rays of each method\n";
        let _ = writeln!(
            text,
            "{:<22}{:<16}{:<22}{:>10}{:>12}{:>12}{:>12}",
            "scene", "engine", "method", "rays", "time", "map", "flux"
        );
        for scene in &self.scenes {
            for curve in &scene.curves {
                *text += &table_line(scene, curve);
            }
        }
    }

    fn numerical_table(&self, text: &mut String) {
        *text += "\nArithmetic alone: the same draws along the same paths\n";
        let _ = writeln!(
            text,
            "{:<22}{:<16}{:<16}{:>10}{:>14}{:>14}{:>12}{:>12}",
            "scene", "shader", "against", "ns/ray", "position rms", "greatest", "flux rms", "other fate"
        );
        for row in &self.numerical {
            let _ = writeln!(
                text,
                "{:<22}{:<16}{:<16}{:>10.1}{:>11.1e} mm{:>11.1e} mm{:>12.1e}{:>12.1e}",
                row.scene,
                row.shader,
                row.against,
                row.ns_per_ray,
                row.same.position_rms,
                row.same.position_max,
                row.same.flux_rms,
                row.other_fate()
            );
        }
    }

    fn claims_table(&self, text: &mut String) {
        *text += "\nRandom numbers that a Sobol point is worth, between its bounds at 99 %\n";
        let _ = writeln!(
            text,
            "{:<26}{:<8}{:>9}{:>8}{:>30}{:>6}{:>30}{:>6}",
            "scene", "split", "rays", "traces", "by the map", "least", "by the flux", "least"
        );
        for verdict in &self.verdicts {
            let _ = writeln!(text, "{verdict}");
        }
    }

    /// The claims that do not hold.
    pub fn faults(&self) -> Vec<String> {
        let broken = self.verdicts.iter().filter(|verdict| !verdict.holds());
        broken.map(Verdict::to_string).collect()
    }

    fn map_chart(&self) -> Curves {
        let quantity = Quantity { name: "RMS error of a pixel, of the mean pixel".into(), unit: "%" };
        self.chart(
            "Error of the map against time",
            quantity,
            |point| point.errors.cells,
            |s| s.answer_errors.cells,
        )
    }

    fn flux_chart(&self) -> Curves {
        let quantity = Quantity { name: "error of the detected flux".into(), unit: "%" };
        self.chart(
            "Error of the flux against time",
            quantity,
            |point| point.errors.total,
            |s| s.answer_errors.total,
        )
    }

    fn chart(
        &self,
        title: &str,
        y: Quantity,
        error: fn(&Point) -> f64,
        floor: fn(&SceneCurves) -> f64,
    ) -> Curves {
        let mut series: Vec<String> = Vec::new();
        for curve in self.scenes.iter().flat_map(|scene| &scene.curves) {
            if !series.contains(&curve.label()) {
                series.push(curve.label());
            }
        }
        let panel = |scene: &SceneCurves| {
            let points = |label: &String| {
                let curve = scene.curves.iter().find(|curve| curve.label() == *label);
                let points = curve.iter().flat_map(|curve| &curve.points);
                points.map(|p| (p.seconds.median, error(p))).filter(|p| p.1 > 0.0).collect()
            };
            Panel {
                title: format!("{}: {}", scene.scene.title, scene.scene.detector),
                y: y.clone(),
                curves: series.iter().map(points).collect(),
                floor: Some(floor(scene)).filter(|floor| *floor > 0.0),
            }
        };
        let panels = self.scenes.iter().map(panel).collect();
        Curves {
            title: title.into(),
            numbers: self.subtitle(&format!(
                "points: {FIRST_RAYS} rays and four times as many each; dashed: the error of the answer itself"
            )),
            x: Quantity { name: "time from the first ray to the map".into(), unit: "s" },
            series,
            panels,
        }
    }

    /// The chart of arithmetic, with a point a shader: the time of a ray, and its error.
    fn numerical_chart(&self) -> Curves {
        let mut scenes: Vec<&'static str> = self.numerical.iter().map(|row| row.scene).collect();
        scenes.dedup();
        let panel = |title: &str, y: Quantity, value: fn(&Numerical) -> f64| {
            let points = |scene: &&'static str| {
                let rows = self.numerical.iter().filter(|row| row.scene == *scene);
                rows.map(|row| (1e-9 * row.ns_per_ray, value(row))).filter(|p| p.1 > 0.0).collect()
            };
            Panel { title: title.into(), y, curves: scenes.iter().map(points).collect(), floor: None }
        };
        let position = Quantity { name: "RMS distance".into(), unit: "m" };
        let flux = Quantity { name: "RMS of the relative difference".into(), unit: "" };
        let greatest = Quantity { name: "greatest distance".into(), unit: "m" };
        Curves {
            title: "Error of arithmetic against time".into(),
            numbers: self.subtitle("each curve from the coarsest tier to the finest, which is held against another shader of its own"),
            x: Quantity { name: "time of a ray".into(), unit: "s" },
            series: scenes.iter().map(|name| (*name).to_string()).collect(),
            panels: vec![
                panel("Where a ray meets a detector", position, |row| 1e-3 * row.same.position_rms),
                panel("The worst of them", greatest, |row| 1e-3 * row.same.position_max),
                panel("Flux of a ray", flux, |row| row.same.flux_rms),
            ],
        }
    }

    fn subtitle(&self, what: &str) -> String {
        let day = self.date.split('T').next().unwrap_or("");
        let note = self.note.as_ref().map_or(String::new(), |note| format!("; {note}"));
        format!(
            "{} {} on {}, {day}; {what}{note}",
            env!("CARGO_PKG_NAME"),
            env!("CARGO_PKG_VERSION"),
            self.adapter
        )
    }
}

impl Curve {
    fn label(&self) -> String {
        if self.engine == env!("CARGO_PKG_NAME") { self.method.clone() } else { self.engine.clone() }
    }
}

fn curve_line(scene: &SceneCurves, curve: &Curve, point: &Point) -> String {
    let Point { num_rays, seconds, errors } = point;
    format!(
        "{},{},{},\"{}\",{num_rays},{:.6},{:.6},{:.6},{:.6e},{:.6e},{:.6e},{:.6e}\n",
        scene.scene.name,
        scene.scene.detector,
        curve.engine,
        curve.method,
        seconds.median,
        seconds.min,
        seconds.max,
        errors.cells,
        errors.total,
        scene.answer_errors.cells,
        scene.answer_errors.total
    )
}

fn table_line(scene: &SceneCurves, curve: &Curve) -> String {
    let Some(last) = curve.points.last() else { return String::new() };
    format!(
        "{:<22}{:<16}{:<22}{:>10}{:>10.3} s{:>10.3} %{:>10.4} %\n",
        scene.scene.name,
        curve.engine,
        curve.method,
        last.num_rays,
        last.seconds.median,
        100.0 * last.errors.cells,
        100.0 * last.errors.total
    )
}

impl Display for Verdict {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        let Verdict { claim, map, flux, .. } = self;
        let ratio = |ratio: &Option<Ratio>| match ratio {
            Some(Ratio { low, value, high }) => format!("{value:.3} ({low:.3} to {high:.3})"),
            None => "no error".into(),
        };
        let least = |ratio: Option<Ratio>, least: Option<f64>| match least {
            Some(value) => format!("{value}{}", if at_least(ratio, least) { " " } else { "!" }),
            None => "- ".into(),
        };
        let split = claim.split.map_or("-".into(), |split| split.0.to_string());
        write!(
            f,
            "{:<26}{split:<8}{:>9}{:>8}{:>30}{:>6}{:>30}{:>6}",
            claim.scene.name,
            claim.num_rays,
            claim.num_traces()[1],
            ratio(map),
            least(*map, claim.map),
            ratio(flux),
            least(*flux, claim.flux),
        )
    }
}
