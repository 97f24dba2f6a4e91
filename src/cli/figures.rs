//! `nsq-gpu figures`: says how even, how wide and how strong the light of a result is.

use crate::error::{Error, Result};
use crate::format::{pretty_json, shown};
use crate::result::figures::region::{Region, RegionOutline};
use crate::result::figures::{Asked, judge, text};
use crate::result::{Detector, DetectorData, TraceResult};
use serde_json::json;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Arguments of `nsq-gpu figures`.
#[derive(clap::Args)]
#[command(after_help = "Example: nsq-gpu figures results --detector desk --region=-200,200,-100,100")]
pub struct Args {
    /// Folder that `trace -o` or `merge -o` wrote.
    result: PathBuf,
    /// The detector. Without it, all that have a map.
    #[arg(long, value_name = "NAME")]
    detector: Option<String>,
    /// Also judge this rectangle of the detector [mm]. May be given again.
    #[arg(long, value_name = "X0,X1,Y0,Y1", allow_hyphen_values = true, value_parser = numbers::<4>)]
    region: Vec<[f64; 4]>,
    /// Also judge this circle of the detector [mm]. May be given again.
    #[arg(long, value_name = "X,Y,R", allow_hyphen_values = true, value_parser = numbers::<3>)]
    circle: Vec<[f64; 3]>,
    /// Also judge the cone of this half angle about the axis of a far field [deg]. May be given again.
    #[arg(long, value_name = "DEG", value_parser = numbers::<1>)]
    cone: Vec<[f64; 1]>,
    /// Find figures over so many cells, columns and rows, which are made of whole pixels. Without it, over the finest whose
    /// errors are 1 % on average.
    #[arg(long, value_name = "NX,NY", value_parser = cells)]
    cells: Option<[usize; 2]>,
    /// Print JSON instead of the text.
    #[arg(long)]
    json: bool,
}

fn numbers<const N: usize>(text: &str) -> std::result::Result<[f64; N], String> {
    let found: Option<Vec<f64>> = text
        .split(',')
        .map(|part| part.trim().parse().ok().filter(|number: &f64| number.is_finite()))
        .collect();
    let problem = || format!("give {N} number{}, separated by commas", if N == 1 { "" } else { "s" });
    found.and_then(|found| found.try_into().ok()).ok_or_else(problem)
}

fn cells(text: &str) -> std::result::Result<[usize; 2], String> {
    let found: Option<Vec<usize>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
    found.and_then(|found| found.try_into().ok()).ok_or_else(|| "give two whole numbers, such as 16,8".into())
}

/// Returns the figures of a result.
pub fn run(args: &Args) -> Result<String> {
    let result = TraceResult::read(&args.result)?;
    let detectors: Vec<&Detector> =
        result.detectors.iter().filter(|detector| args.is_asked_for(detector)).collect();
    if detectors.is_empty() {
        let names: Vec<String> = result.detectors.iter().map(|detector| shown(&detector.name)).collect();
        let missing = match &args.detector {
            Some(name) => format!("no detector is called `{}`", shown(name)),
            None => "no detector has a map of which this can be asked".into(),
        };
        return Err(Error::Usage(format!("{missing}; there are {}", names.join(", "))));
    }
    let mut found = BTreeMap::new();
    for detector in detectors {
        let asked = Asked { regions: args.regions_of(detector)?, cells: args.cells };
        found.insert(detector.name.clone(), judge(&result, detector, &asked)?);
    }
    if args.json {
        let document = json!({"detectors": found});
        return pretty_json(&document).map_err(|error| Error::internal("figures as JSON", &error));
    }
    Ok(text(&found))
}

impl Args {
    /// True of a detector of the name that was given. Without a name, of all whose maps such regions belong to.
    fn is_asked_for(&self, detector: &Detector) -> bool {
        let on_planes = !(self.region.is_empty() && self.circle.is_empty());
        let has_any = on_planes || !self.cone.is_empty();
        match (&self.detector, &detector.data) {
            (Some(name), _) => detector.name == *name,
            (None, DetectorData::Irradiance(_)) => on_planes || !has_any,
            (None, DetectorData::FarField(_)) => !self.cone.is_empty() || !has_any,
            (None, DetectorData::Spectral(_) | DetectorData::RayDatabase(_)) => false,
        }
    }

    /// The regions of a detector's kind.
    fn regions_of(&self, detector: &Detector) -> Result<Vec<Region>> {
        let is_far_field = matches!(detector.data, DetectorData::FarField(_));
        let refused = match is_far_field {
            true if !(self.region.is_empty() && self.circle.is_empty()) => {
                Some("a far field has cones; give --cone")
            }
            false if !self.cone.is_empty() => Some("a cone is of a far field; give --region or --circle"),
            true | false => None,
        };
        if let Some(remedy) = refused.filter(|_| self.detector.is_some()) {
            return Err(Error::Usage(format!("{}: {remedy}", shown(&detector.name))));
        }
        if is_far_field {
            return sized(self.cone.iter().map(|[angle]| Region::cone(*angle)).collect());
        }
        let rectangles = self
            .region
            .iter()
            .map(|[x0, x1, y0, y1]| Region::between(RegionOutline::Rectangle, (*x0, *y0), (*x1, *y1)));
        let circles = self.circle.iter().map(|[x, y, radius]| Region {
            outline: RegionOutline::Ellipse,
            centre: (*x, *y),
            half: (*radius, *radius),
        });
        sized(rectangles.chain(circles).collect())
    }
}

/// Refuses a region without a size.
fn sized(regions: Vec<Region>) -> Result<Vec<Region>> {
    match regions.iter().all(|region| region.half.0 > 0.0 && region.half.1 > 0.0) {
        true => Ok(regions),
        false => Err(Error::Usage(
            "a region has no size; give it a width and a height, a radius, or an angle above 0".into(),
        )),
    }
}
