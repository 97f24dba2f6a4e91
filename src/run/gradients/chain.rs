//! From sums of tangents to derivatives of fluxes and maps.

use crate::error::Result;
use crate::model::SceneIr;
use crate::result::{Detector, DetectorTally, FluxUnit, Tally};
use crate::run::gradients::scaled::Scaled;

/// The weight of a quantum.
pub(super) const QUANTUM: f64 = 1.0 / (1_u64 << 52) as f64;

/// From sums of tangents to derivatives in the units of maps. A flux is the total flux times a share, and a map's value
/// is a flux over the size of a cell. The parameter may change all three.
pub(super) struct Chain {
    /// What a unit of weight is worth, and its derivative \[W, W per unit of the parameter\].
    pub(super) unit: [f64; 2],
    /// The natural size of the parameter.
    size: f64,
    /// Sizes of the cells by detector, and their derivatives.
    cells: Vec<Option<[Vec<f64>; 2]>>,
    /// Shapes of maps by detector.
    pub(super) shapes: Vec<Option<ndarray::IxDyn>>,
}

impl Chain {
    pub(super) fn of(ir: &SceneIr, scaled: &Scaled, num_rays: u64) -> Result<Self> {
        let flux = |ir: &SceneIr| ir.emitted_flux() / num_rays as f64;
        // Less the value of the scene itself: what does not change has a derivative of 0 exactly.
        let derivative = |value: &dyn Fn(&SceneIr) -> f64| {
            let changes =
                scaled.parameter.stencil.iter().map(|(factor, scene)| factor * (value(scene) - value(ir)));
            changes.sum::<f64>() / scaled.size
        };
        let (mut cells, mut shapes) = (Vec::new(), Vec::new());
        for number in 0..ir.detectors.len() {
            let Some((here, shape)) = sizes(ir, number)? else {
                cells.push(None);
                shapes.push(None);
                continue;
            };
            let mut slopes = vec![0.0; here.len()];
            for (factor, scene) in &scaled.parameter.stencil {
                let there = sizes(scene, number)?.map(|(sizes, _)| sizes).unwrap_or_default();
                let changes =
                    there.iter().zip(&here).map(|(there, here)| factor * (there - here) / scaled.size);
                slopes.iter_mut().zip(changes).for_each(|(slope, change)| *slope += change);
            }
            cells.push(Some([here, slopes]));
            shapes.push(Some(shape));
        }
        Ok(Chain { unit: [flux(ir), derivative(&flux)], size: scaled.size, cells, shapes })
    }

    /// True if the parameter changes neither fluxes of sources nor sizes of cells.
    pub(super) fn is_constant(&self) -> bool {
        self.unit[1] == 0.0
            && self.cells.iter().flatten().all(|[_, slopes]| slopes.iter().all(|slope| *slope == 0.0))
    }

    /// The derivative of a flux \[W per unit of the parameter\].
    fn of_flux(&self, tangent: i128, quanta: u128) -> f64 {
        let [unit, slope] = self.unit;
        unit * (tangent as f64 * QUANTUM) / self.size + slope * (quanta as f64 * QUANTUM)
    }

    /// What a loss gains by a unit of the parameter of this number, from what the loss gains by a watt in each cell.
    pub(super) fn of_loss(&self, tally: &Tally, number: usize, adjoints: &[Vec<f64>]) -> f64 {
        let mut gain = 0.0;
        for (detector, adjoints) in tally.detectors.iter().zip(adjoints) {
            let quanta = detector.quanta_of_cells();
            let tangents = detector.tangents_by(number);
            for ((tangent, quanta), adjoint) in tangents.iter().zip(quanta.iter()).zip(adjoints) {
                gain += adjoint * self.of_flux(*tangent, *quanta);
            }
        }
        gain
    }

    /// The derivatives of a detector's fluxes, then of all cells of maps, by the parameter of this number.
    pub(super) fn derivatives(&self, tally: &Tally, number: usize) -> Vec<f64> {
        let [unit, _] = self.unit;
        let (mut fluxes, mut values) = (Vec::new(), Vec::new());
        for (detector, cells) in tally.detectors.iter().zip(&self.cells) {
            let tangents = detector.tangents_by(number);
            fluxes.push(self.of_flux(tangents.iter().sum(), detector.total().quanta));
            let Some([sizes, slopes]) = cells else { continue };
            let per_size = detector.quanta.len().max(1) / sizes.len().max(1);
            for (cell, (&tangent, &quanta)) in tangents.iter().zip(&detector.quanta).enumerate() {
                let (size, slope_of_size) = (sizes[cell / per_size], slopes[cell / per_size]);
                let value = unit * (quanta as f64 * QUANTUM) / size;
                values.push((self.of_flux(tangent, quanta) - value * slope_of_size) / size);
            }
        }
        fluxes.extend(values);
        fluxes
    }
}

/// The sizes of a map's cells, row by row, and the map's shape. `None` if the detector has no map.
pub(super) fn sizes(ir: &SceneIr, number: usize) -> Result<Option<(Vec<f64>, ndarray::IxDyn)>> {
    let detector = &ir.detectors[number];
    if detector.num_cells() == 0 {
        return Ok(None);
    }
    let zeros = DetectorTally {
        quanta: vec![0; detector.num_cells()],
        hits: vec![0; detector.num_cells()],
        ..DetectorTally::default()
    };
    let empty = Detector::of_part(ir, &Tally::zeros(ir), FluxUnit::new(1.0, 1), detector, &zeros)?;
    Ok(empty.data.result().map().map(|map| (map.sizes.clone(), map.values.raw_dim())))
}
