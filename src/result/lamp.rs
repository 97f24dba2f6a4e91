//! A far field as a lamp: the luminaire that a design gives, for other programs.

use crate::error::{Error, Result};
use crate::format::{shown, significant};
use crate::result::figures::field::Field;
use crate::result::{Detector, DetectorData, FarFieldPattern, TraceResult};
use crate::scene::lamps::{Lamp, Opening, azimuths_of};
use ndarray::{Array2, ArrayView1};

/// The lamp that a far field is. `is_forward` says that no light comes from behind, which a far field without `sphere` adds to the
/// light forwards.
///
/// Intensities come from cells of equal solid angle ([`Field::of_equal_solid_angles`]). They stand at the middles of
/// the bins. At the ends of gamma, and in plane C0, stand means of the bins beside.
///
/// # Errors
/// [`Error::Usage`] if the detector is no far field, was not traced in photometric units, or folds light from behind.
pub fn lamp_of(result: &TraceResult, detector: &Detector, is_forward: bool) -> Result<Lamp> {
    let name = shown(&detector.name);
    let refused = |problem: &str| Err(Error::Usage(format!("{name} {problem}")));
    let DetectorData::FarField(pattern) = &detector.data else {
        return refused("is no far field; name a detector of this kind with --detector");
    };
    let Some(seen) = &detector.luminous else {
        return refused("has no candela: trace with --photometric");
    };
    if pattern.reach() < 180.0 && !is_forward {
        return refused(
            "has light from behind in the same bins as light forwards. Trace it with \"sphere\": true, or give --forward if none \
             comes from behind",
        );
    }
    let field =
        Field::of_detector(detector).ok_or_else(|| Error::Internal("a far field without a map".into()))?;
    let (polar_angles_deg, azimuths, rows) = table(pattern, &field.of_equal_solid_angles().values);
    let (azimuth_angles_deg, intensity) = azimuths_of(&azimuths, &rows);
    let flux = match seen.flux_lm_standard_error {
        Some(error) => format!("{} lm +- {} lm", significant(seen.flux_lm, 6), significant(error, 2)),
        None => format!("{} lm", significant(seen.flux_lm, 6)),
    };
    let rays = format!("{} rays, seed {}, {}", result.num_rays_total, result.run.seed, result.run.precision);
    let keywords = [
        ("TEST", "Monte Carlo simulation".to_string()),
        ("TESTLAB", format!("nsq-gpu {}", env!("CARGO_PKG_VERSION"))),
        ("MANUFAC", "not stated".into()),
        ("LUMINAIRE", name),
        ("OTHER", format!("luminous flux {flux}; {rays}; cells of equal solid angle")),
        ("_FILEGENTYPE", "1.0001".into()),
    ];
    let mut lamp = Lamp {
        polar_angles_deg,
        azimuth_angles_deg,
        intensity,
        opening: Opening::Point,
        keywords: keywords.map(|(key, value)| (key.to_string(), value)).into(),
        lamp_lumens: None,
        watts: None,
        remarks: Vec::new(),
    };
    // Bins are means, and programs join the table's points by lines: narrow beams would gain light.
    let scale = seen.flux_lm / lamp.lumens();
    if scale.is_finite() {
        lamp.intensity.iter_mut().flatten().for_each(|candela| *candela *= scale);
    }
    Ok(lamp)
}

/// Polar angles, azimuths, and intensities: a row for each azimuth.
fn table(pattern: &FarFieldPattern, candela: &Array2<f64>) -> (Vec<f64>, Vec<f64>, Vec<Vec<f64>>) {
    let (num_theta, num_phi) = candela.dim();
    let mean = |row: ArrayView1<'_, f64>| row.sum() / num_phi as f64;
    // All planes meet at a pole. At 90 degrees light ends where only one hemisphere was asked for.
    let is_sphere = pattern.reach() > 90.0;
    let [at_pole, at_end] = [mean(candela.row(0)), mean(candela.row(num_theta - 1))];
    let polar = std::iter::once(0.0).chain(pattern.theta.iter().copied()).chain([pattern.reach()]).collect();
    let plane = |of: &dyn Fn(usize) -> f64| -> Vec<f64> {
        let end = if is_sphere { at_end } else { of(num_theta - 1) };
        std::iter::once(at_pole).chain((0..num_theta).map(of)).chain([end]).collect()
    };
    // A lamp of revolution: one plane stands for all.
    if num_phi == 1 {
        return (polar, vec![0.0], vec![plane(&|row| candela[(row, 0)])]);
    }
    // Bins begin at -180 degrees, and planes at 0.
    let column = |number: usize| (number + num_phi / 2) % num_phi;
    let width = 360.0 / num_phi as f64;
    let offset = if num_phi.is_multiple_of(2) { 0.5 } else { 0.0 };
    let middles = (0..num_phi).map(|number| (number as f64 + offset) * width);
    let rows = (0..num_phi).map(|number| plane(&|row| candela[(row, column(number))]));
    let mut planes: Vec<(f64, Vec<f64>)> = middles.zip(rows).collect();
    if offset > 0.0 {
        let at_zero = plane(&|row| (candela[(row, column(0))] + candela[(row, column(num_phi - 1))]) / 2.0);
        planes.insert(0, (0.0, at_zero.clone()));
        planes.push((360.0, at_zero));
    } else {
        planes.push((360.0, planes[0].1.clone()));
    }
    let (azimuth, intensity) = planes.into_iter().unzip();
    (polar, azimuth, intensity)
}
