//! The table that is traced: what was measured at each angle of incidence, with the energy that it has.

use crate::model::PolarTable;
use crate::model::key_path::quoted;

/// Values of a BSDF about the specular direction.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredTable {
    /// True of a BTDF: the specular direction is the straight one.
    pub transmits: bool,
    /// By angle of incidence.
    pub rows: Vec<MeasuredRow>,
}

/// What was measured at one angle of incidence.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredRow {
    /// The angle of incidence \[deg\].
    pub incidence_deg: f64,
    /// The BSDF about the specular direction \[1/sr\].
    pub values: PolarTable,
    /// The share of the light that scatters: the integral of the BSDF times the cosine over the hemisphere.
    pub scattered: f64,
    /// What that integral was before the values were scaled to a share that the file states.
    pub measured: f64,
}

impl MeasuredTable {
    /// The table of shaders/bsdfs/measured.wgsl. Angles of incidence \[deg\] come first. Then each angle has the light
    /// of its row over all directions, which no cosine lessens, and where its [`PolarTable::numbers`] begin. There are
    /// two rows at least.
    pub(super) fn numbers(&self, level: f64) -> Vec<f64> {
        /// Any angle beyond the only one of a table.
        const BEYOND: f64 = 1.0;
        let mut rows: Vec<(f64, &PolarTable)> =
            self.rows.iter().map(|row| (row.incidence_deg, &row.values)).collect();
        if let [(only, values)] = rows[..] {
            rows.push((only + BEYOND, values));
        }
        let mut numbers: Vec<f64> = rows.iter().map(|(angle, _)| *angle).collect();
        let mut start = 3 * rows.len();
        let mut tables: Vec<f64> = Vec::new();
        for (_, values) in &rows {
            let light = values.flux();
            numbers.extend([level * light, start as f64]);
            // Nothing is drawn from a dark row.
            if light > 0.0 {
                let table = values.numbers();
                start += table.len();
                tables.extend(table);
            }
        }
        numbers.extend(tables);
        numbers
    }

    /// What the user should know. Shares may differ from what the values add up to. Angles of incidence may not have
    /// been measured. Rows may give more light than they get.
    pub(super) fn warnings(&self, name: &str) -> Vec<String> {
        /// Measured tables exceed 1 by their own errors.
        const TOLERANCE: f64 = 1e-3;
        /// Shares that differ by more deserve a word.
        const NOTICED: f64 = 0.05;
        let name = quoted(name);
        let mut warnings = Vec::new();
        let differs = |row: &&MeasuredRow| (row.measured - row.scattered).abs() > NOTICED * row.scattered;
        if let Some(MeasuredRow { incidence_deg, scattered, measured, .. }) = self.rows.iter().find(differs) {
            warnings.push(format!(
                "the values of {name} at an incidence of {incidence_deg} degrees add up to {measured:.4}, and its TIS says \
                 {scattered:.4}: the TIS counts"
            ));
        }
        let (first, last) = (self.rows[0].incidence_deg, self.rows[self.rows.len() - 1].incidence_deg);
        if self.rows.len() > 1 && (first > 0.0 || last < 90.0) {
            warnings.push(format!(
                "the BSDF of {name} was measured at angles of incidence from {first} to {last} degrees; beyond them the nearest \
                 one counts"
            ));
        }
        let brightest = self.rows.iter().max_by(|a, b| a.scattered.total_cmp(&b.scattered));
        if let Some(row) = brightest.filter(|row| row.scattered > 1.0 + TOLERANCE) {
            warnings.push(format!(
                "the BSDF of {name} scatters {:.4} times what it gets at an incidence of {} degrees",
                row.scattered, row.incidence_deg
            ));
        }
        warnings
    }
}
