//! Where every quantum went: integers, so that the ledger closes to the last bit or shows that it does not.

use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::model::{Interaction, SceneIr};
use crate::result::{FluxSum, FluxUnit, Tally};

/// One line of the ledger.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct LedgerEntry {
    /// Rays or events.
    pub count: u64,
    /// Their quanta, exact.
    #[serde(serialize_with = "as_string", deserialize_with = "from_string")]
    pub quanta: u128,
    /// The same as flux \[W\].
    pub flux: f64,
}

/// launched + roulette_gain + importance_gain + bsdf_gain = detected + absorbed + surface + coating + bsdf + bulk
/// + escaped + depth + roulette_loss + importance_loss + filtered_out, in quanta.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Ledger {
    /// Rays launched.
    pub launched: LedgerEntry,
    /// Weight gained by survivors of roulette.
    pub roulette_gain: LedgerEntry,
    /// Weight gained where a branch was drawn less often than its share.
    pub importance_gain: LedgerEntry,
    /// Weight gained where rays were scattered less often than their share, or where a BSDF exceeds that which was drawn.
    pub bsdf_gain: LedgerEntry,
    /// Recorded by detectors that end rays; every ray, also those that a ray database did not keep.
    pub detected: LedgerEntry,
    /// Ended on absorbing surfaces.
    pub absorbed: LedgerEntry,
    /// Taken by mirrors.
    pub surface: LedgerEntry,
    /// Taken by coatings.
    pub coating: LedgerEntry,
    /// Taken by scattering surfaces.
    pub bsdf: LedgerEntry,
    /// Taken by absorbing media.
    pub bulk: LedgerEntry,
    /// Met nothing any more.
    pub escaped: LedgerEntry,
    /// Reached the largest number of events.
    pub depth: LedgerEntry,
    /// Ended by roulette.
    pub roulette_loss: LedgerEntry,
    /// Weight lost where a branch was drawn more often than its share.
    pub importance_loss: LedgerEntry,
    /// Recorded by no detector, because a filter of paths kept the rays that ended on detectors from maps.
    #[serde(default)]
    pub filtered_out: LedgerEntry,
    /// Read in passing by transmissive detectors: a memo, no part of the balance.
    pub tapped: LedgerEntry,
    /// Sources minus destinations \[quanta\]; anything but 0 is a defect of this program.
    #[serde(serialize_with = "as_string", deserialize_with = "from_string")]
    pub imbalance_quanta: i128,
    /// The same as flux \[W\].
    pub imbalance_flux: f64,
    /// Deposits that no sum can hold; anything but 0 is a defect of this program.
    pub invalid_deposits: u64,
}

impl LedgerEntry {
    /// The line of a sum.
    pub fn new(flux_sum: FluxSum, unit: FluxUnit) -> Self {
        LedgerEntry { count: flux_sum.count, quanta: flux_sum.quanta, flux: unit.watts(flux_sum.quanta) }
    }
}

impl Ledger {
    /// The ledger of a trace.
    pub fn new(ir: &SceneIr, tally: &Tally, unit: FluxUnit) -> Self {
        let entry = |flux_sum| LedgerEntry::new(flux_sum, unit);
        let detectors = |absorb: bool| {
            let detectors = ir
                .detectors
                .iter()
                .zip(&tally.detectors)
                .filter(move |(detector, _)| detector.absorb == absorb);
            total(detectors.map(|(_, sums)| sums.total()))
        };
        let surfaces = |absorbing: bool| {
            let surfaces = ir.surfaces.iter().zip(&tally.surfaces);
            total(
                surfaces
                    .filter(|(surface, _)| (surface.interaction == Interaction::Absorbing) == absorbing)
                    .map(|(_, sums)| sums.absorbed),
            )
        };
        let mut ledger = Ledger {
            launched: entry(tally.launched),
            roulette_gain: entry(tally.roulette_gain),
            importance_gain: entry(tally.importance_gain),
            bsdf_gain: entry(tally.bsdf_gain),
            detected: entry(detectors(true)),
            absorbed: entry(surfaces(true)),
            surface: entry(surfaces(false)),
            coating: entry(tally.coating),
            bsdf: entry(tally.bsdf_loss),
            bulk: entry(tally.bulk),
            escaped: entry(tally.escaped),
            depth: entry(tally.depth_killed),
            roulette_loss: entry(tally.roulette_loss),
            importance_loss: entry(tally.importance_loss),
            filtered_out: entry(tally.filtered_out),
            tapped: entry(detectors(false)),
            imbalance_quanta: 0,
            imbalance_flux: 0.0,
            invalid_deposits: tally.invalid_deposits,
        };
        ledger.imbalance_quanta = ledger.recomputed_imbalance();
        ledger.imbalance_flux = unit.watts(ledger.imbalance_quanta.unsigned_abs())
            * if ledger.imbalance_quanta < 0 { -1.0 } else { 1.0 };
        ledger
    }

    /// True if every quantum is accounted for and every deposit was valid.
    pub fn closes(&self) -> bool {
        self.imbalance_quanta == 0 && self.invalid_deposits == 0
    }

    /// What came in: launched, and gained by sampling.
    pub fn sources(&self) -> [(&'static str, LedgerEntry); 4] {
        [
            ("launched", self.launched),
            ("roulette gain", self.roulette_gain),
            ("importance gain", self.importance_gain),
            ("scatter gain", self.bsdf_gain),
        ]
    }

    /// Where it went.
    pub fn destinations(&self) -> [(&'static str, LedgerEntry); 11] {
        [
            ("detected", self.detected),
            ("absorbed", self.absorbed),
            ("mirror loss", self.surface),
            ("coating loss", self.coating),
            ("scatter loss", self.bsdf),
            ("bulk absorbed", self.bulk),
            ("escaped", self.escaped),
            ("depth limit", self.depth),
            ("roulette loss", self.roulette_loss),
            ("importance loss", self.importance_loss),
            ("filtered out", self.filtered_out),
        ]
    }

    /// Sources minus destinations, of the lines as they stand \[quanta\].
    pub fn recomputed_imbalance(&self) -> i128 {
        let sum = |lines: &[(&str, LedgerEntry)]| {
            lines.iter().map(|(_, entry)| entry.quanta).fold(0, u128::wrapping_add)
        };
        // Two's complement: the difference is right whichever sum is the larger.
        sum(&self.sources()).wrapping_sub(sum(&self.destinations())) as i128
    }
}

fn total(flux_sums: impl Iterator<Item = FluxSum>) -> FluxSum {
    flux_sums.fold(FluxSum::default(), |mut sum, flux_sum| {
        sum += flux_sum;
        sum
    })
}

/// Quanta go into JSON as decimal strings, because most readers of JSON keep 53 bits of a number.
fn as_string<S: Serializer>(value: &impl ToString, serializer: S) -> std::result::Result<S::Ok, S::Error> {
    serializer.serialize_str(&value.to_string())
}

fn from_string<'de, D: Deserializer<'de>, T: std::str::FromStr>(
    deserializer: D,
) -> std::result::Result<T, D::Error> {
    let text = String::deserialize(deserializer)?;
    text.parse().map_err(|_| serde::de::Error::custom(format!("`{text}` is not a number of quanta")))
}
