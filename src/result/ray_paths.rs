//! Recorded paths: one row per event, with the columns of Optiland's event log.

use std::collections::BTreeMap;
use std::sync::Arc;

use ndarray::Array1;

use crate::error::Result;
use crate::model::SceneIr;
use crate::result::npz::{ArrayWriter, Column};
use crate::result::ray_rows::{self, Rows};
use crate::result::{FluxUnit, PathEventKind};

/// Events of recorded rays, by launched ray and id ([`crate::model::ray_id::order`]), then in the order in which they happened.
/// A child begins with the hit at which it was split off. The rows may lie on disk; [`RayPaths::columns`] brings them into
/// memory.
#[derive(Debug, Clone, PartialEq)]
pub struct RayPaths {
    rows: Arc<Rows>,
    unit: FluxUnit,
    wavelengths: Vec<f64>,
    sources: Vec<String>,
    surfaces: Vec<String>,
    detectors: Vec<String>,
}

/// Recorded events in memory. All columns have shape (n,).
#[derive(Debug, Clone, PartialEq)]
pub struct PathColumns {
    /// Ray ids.
    pub ray_id: Array1<i64>,
    /// `birth`, `hit` or `death`.
    pub event_type: Vec<&'static str>,
    /// Positions \[mm\]: x, y, z.
    pub position: [Array1<f64>; 3],
    /// Direction cosines before the event: L, M, N.
    pub direction: [Array1<f64>; 3],
    /// Flux before the event \[W\].
    pub flux: Array1<f64>,
    /// Wavelength \[um\].
    pub wavelength: Array1<f64>,
    /// Events of the ray before this one.
    pub bounce: Array1<i32>,
    /// The source, surface or detector, or the cause of death: `escaped`, `depth_killed`, `flux_killed`.
    pub component_name: Vec<String>,
}

impl RayPaths {
    /// None if nothing was recorded.
    pub(crate) fn new(ir: &SceneIr, unit: FluxUnit, rows: Arc<Rows>) -> Option<Self> {
        (!rows.is_empty()).then(|| RayPaths {
            rows,
            unit,
            wavelengths: ir.wavelengths.clone(),
            sources: ir.sources.iter().map(|source| source.name.clone()).collect(),
            surfaces: ir.surfaces.iter().map(|surface| surface.name.clone()).collect(),
            detectors: ir.detectors.iter().map(|detector| detector.name.clone()).collect(),
        })
    }

    /// Number of events.
    pub fn len(&self) -> u64 {
        self.rows.len()
    }

    /// True if there is no event.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// All events in memory at once.
    ///
    /// # Errors
    /// The errors of [`Rows::for_each`].
    pub fn columns(&self) -> Result<PathColumns> {
        let events = self.rows.to_vec()?;
        let reals = |value: &dyn Fn(usize) -> f64| (0..events.len()).map(value).collect::<Array1<f64>>();
        Ok(PathColumns {
            ray_id: events.iter().map(|event| event.ray.ray_id as i64).collect(),
            event_type: events.iter().map(|event| event.kind.event_type()).collect(),
            position: [0, 1, 2].map(|axis| reals(&|i| events[i].ray.position[axis])),
            direction: [0, 1, 2].map(|axis| reals(&|i| events[i].ray.direction[axis])),
            flux: reals(&|i| self.unit.watts_of_weight(events[i].ray.weight)),
            wavelength: reals(&|i| self.wavelengths[events[i].ray.wavelength as usize]),
            bounce: events.iter().map(|event| event.ray.bounce as i32).collect(),
            component_name: events.iter().map(|event| self.name(event.kind).into()).collect(),
        })
    }

    pub(crate) fn write(&self, file: &mut ArrayWriter) -> Result<()> {
        let rows = &self.rows;
        let kinds = self.kinds()?;
        let id = |word: u64, bytes: &mut Vec<u8>| bytes.extend((word as i64).to_le_bytes());
        file.add_column("ray_id", &Column::new(rows, ray_rows::RAY_ID, "<i8", 8, id))?;
        self.add_text(file, "event_type", &kinds, |kind| kind.event_type())?;
        for (word, name) in (ray_rows::POSITION..).zip(["x", "y", "z", "L", "M", "N"]) {
            file.add_column(name, &Column::real(rows, word, |x| x))?;
        }
        let flux = |weight| self.unit.watts_of_weight(weight);
        file.add_column("flux", &Column::real(rows, ray_rows::WEIGHT, flux))?;
        file.add_column("wavelength", &Column::wavelength(rows, &self.wavelengths))?;
        let bounce =
            |word, bytes: &mut Vec<u8>| bytes.extend((ray_rows::bounce_of(word) as i32).to_le_bytes());
        file.add_column("bounce", &Column::new(rows, ray_rows::BOUNCE_AND_WAVELENGTH, "<i4", 4, bounce))?;
        self.add_text(file, "component_name", &kinds, |kind| self.name(kind))
    }

    /// What happened at all, by the words of the rows.
    fn kinds(&self) -> Result<BTreeMap<u64, PathEventKind>> {
        let mut kinds = BTreeMap::new();
        self.rows.for_each_block(ray_rows::KIND, |words| {
            words.iter().for_each(|&word| {
                kinds.entry(word).or_insert_with(|| ray_rows::kind_of(word));
            });
            Ok(())
        })?;
        Ok(kinds)
    }

    /// Adds a column of words for what happened.
    fn add_text<'a>(
        &self,
        file: &mut ArrayWriter,
        name: &str,
        kinds: &BTreeMap<u64, PathEventKind>,
        text_of: impl Fn(PathEventKind) -> &'a str,
    ) -> Result<()> {
        let texts: BTreeMap<u64, &str> = kinds.iter().map(|(&word, &kind)| (word, text_of(kind))).collect();
        file.add_text_column(name, &self.rows, ray_rows::KIND, &texts)
    }

    fn name(&self, kind: PathEventKind) -> &str {
        match kind {
            PathEventKind::Birth(index) => &self.sources[index],
            PathEventKind::Surface(index) => &self.surfaces[index],
            PathEventKind::Detector(index) => &self.detectors[index],
            PathEventKind::Escaped => "escaped",
            PathEventKind::DepthKilled => "depth_killed",
            PathEventKind::FluxKilled => "flux_killed",
        }
    }

    /// Units of the columns.
    pub(crate) const UNITS: &'static [(&'static str, &'static str)] = &[
        ("x", "mm"),
        ("y", "mm"),
        ("z", "mm"),
        ("L", "1"),
        ("M", "1"),
        ("N", "1"),
        ("flux", "W"),
        ("wavelength", "um"),
        ("bounce", "1"),
    ];
}

impl PathEventKind {
    /// A birth and a first hit carry the same count of events, as may a birth and an escape.
    pub(crate) fn rank(self) -> u8 {
        match self.event_type() {
            "birth" => 0,
            "hit" => 1,
            _ => 2,
        }
    }

    /// Optiland's word for it: `birth`, `hit` or `death`.
    pub fn event_type(self) -> &'static str {
        match self {
            PathEventKind::Birth(_) => "birth",
            PathEventKind::Surface(_) | PathEventKind::Detector(_) => "hit",
            PathEventKind::Escaped | PathEventKind::DepthKilled | PathEventKind::FluxKilled => "death",
        }
    }
}
