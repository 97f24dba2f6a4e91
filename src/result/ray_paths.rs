//! Recorded paths: one row per event, with the columns of Optiland's event log.

use ndarray::Array1;

use crate::error::Result;
use crate::ir::{SceneIr, ray_id};
use crate::result::npz::NpzFile;
use crate::result::{FluxUnit, PathEvent, PathEventKind};

/// Events of recorded rays, by launched ray and id ([`ray_id::order`]), then in the order in which they happened. A child
/// begins with the hit at which it was split off. All columns have shape (n,).
#[derive(Debug, Clone, PartialEq)]
pub struct RayPaths {
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
    pub(crate) fn new(ir: &SceneIr, unit: FluxUnit, events: &[PathEvent]) -> Option<Self> {
        if events.is_empty() {
            return None;
        }
        let mut events: Vec<&PathEvent> = events.iter().collect();
        events.sort_by_key(|event| (ray_id::order(event.ray.ray_id), event.ray.bounce, rank(event.kind)));
        let column = |value: &dyn Fn(&PathEvent) -> f64| events.iter().map(|event| value(event)).collect();
        Some(RayPaths {
            ray_id: events.iter().map(|event| event.ray.ray_id as i64).collect(),
            event_type: events.iter().map(|event| event_type(event.kind)).collect(),
            position: [0, 1, 2].map(|axis| column(&|event| event.ray.position[axis])),
            direction: [0, 1, 2].map(|axis| column(&|event| event.ray.direction[axis])),
            flux: column(&|event| unit.watts_of_weight(event.ray.weight)),
            wavelength: column(&|event| ir.wavelengths[event.ray.wavelength as usize]),
            bounce: events.iter().map(|event| event.ray.bounce as i32).collect(),
            component_name: events.iter().map(|event| component_name(ir, event.kind)).collect(),
        })
    }

    /// Number of events.
    pub fn len(&self) -> usize {
        self.event_type.len()
    }

    /// True if there is no event.
    pub fn is_empty(&self) -> bool {
        self.event_type.is_empty()
    }

    pub(crate) fn write(&self, file: &mut NpzFile) -> Result<()> {
        file.add("ray_id", &self.ray_id)?;
        file.add_text("event_type", &self.event_type)?;
        for (name, column) in ["x", "y", "z"].iter().zip(&self.position) {
            file.add(name, column)?;
        }
        for (name, column) in ["L", "M", "N"].iter().zip(&self.direction) {
            file.add(name, column)?;
        }
        file.add("flux", &self.flux)?;
        file.add("wavelength", &self.wavelength)?;
        file.add("bounce", &self.bounce)?;
        file.add_text("component_name", &self.component_name)
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

/// A birth and a first hit carry the same count of events, as may a birth and an escape.
fn rank(kind: PathEventKind) -> u8 {
    match event_type(kind) {
        "birth" => 0,
        "hit" => 1,
        _ => 2,
    }
}

fn event_type(kind: PathEventKind) -> &'static str {
    match kind {
        PathEventKind::Birth(_) => "birth",
        PathEventKind::Surface(_) | PathEventKind::Sensor(_) => "hit",
        PathEventKind::Escaped | PathEventKind::DepthKilled | PathEventKind::FluxKilled => "death",
    }
}

fn component_name(ir: &SceneIr, kind: PathEventKind) -> String {
    match kind {
        PathEventKind::Birth(index) => ir.emitters[index].name.clone(),
        PathEventKind::Surface(index) => ir.surfaces[index].name.clone(),
        PathEventKind::Sensor(index) => ir.sensors[index].name.clone(),
        PathEventKind::Escaped => "escaped".into(),
        PathEventKind::DepthKilled => "depth_killed".into(),
        PathEventKind::FluxKilled => "flux_killed".into(),
    }
}
