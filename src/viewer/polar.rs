//! Polar diagrams, as people know them of lamps: intensity over the polar angle. One is of a far field that was traced,
//! others are of the lamps of a scene, before a ray is traced.

use crate::model::photometry::is_visible;
use crate::model::{PolarTable, SceneIr, Source, SourceKind};
use crate::result::figures::field::Field;
use crate::result::photometry::efficacy_of;
use crate::result::png::diagram::{Curve, PLANES, curves, top};
use crate::result::{Detector, DetectorData};

/// A diagram of two planes through the axis.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Diagram {
    /// The largest polar angle: 90 or 180 \[deg\].
    pub reach: f64,
    /// Unit of the intensities: cd or W/sr.
    pub unit: &'static str,
    /// A curve for each plane.
    pub curves: Vec<Curve>,
}

impl Diagram {
    /// The largest intensity.
    pub fn top(&self) -> f64 {
        top(&self.curves)
    }
}

/// The diagram of a far field; `None` of any other detector.
pub(crate) fn of_far_field(detector: &Detector) -> Option<Diagram> {
    let DetectorData::FarField(pattern) = &detector.data else { return None };
    let field = Field::of_detector(detector)?;
    let (field, reach) = (field.of_equal_solid_angles(), pattern.reach());
    let curves = curves(&field.values, reach);
    Some(Diagram { reach, unit: field.labels.value.1, curves: curves.into() })
}

/// The diagrams of the lamps of a scene, as their tables say: of lamps that are alike, one, with all of their names.
pub(crate) fn of_lamps(ir: &SceneIr) -> Vec<(Vec<String>, Diagram)> {
    let mut found: Vec<(Vec<String>, Diagram)> = Vec::new();
    for source in &ir.sources {
        let SourceKind::Tabulated(lamp) = &source.kind else { continue };
        let diagram = of_lamp(ir, source, &lamp.table);
        match found.iter_mut().find(|(_, known)| *known == diagram) {
            Some((names, _)) => names.push(source.name.clone()),
            None => found.push((vec![source.name.clone()], diagram)),
        }
    }
    found
}

fn of_lamp(ir: &SceneIr, source: &Source, table: &PolarTable) -> Diagram {
    let lumens_per_watt = efficacy_of(ir, source);
    let (unit, factor) = if is_visible(lumens_per_watt) { ("cd", lumens_per_watt) } else { ("W/sr", 1.0) };
    let scale = factor * source.total_flux / table.flux();
    let half = |azimuth: f64| {
        let angles = table.polar.iter().map(|angle| angle.to_degrees());
        let values = table.plane_at(azimuth.rem_euclid(360.0).to_radians());
        angles.zip(values.into_iter().map(|value| scale * value)).collect()
    };
    let is_of_revolution = table.rows.windows(2).all(|rows| rows[0] == rows[1]);
    let num = if is_of_revolution { 1 } else { PLANES.len() };
    let curves = PLANES.iter().take(num).map(|&(name, halves, color)| {
        let name = if is_of_revolution { "all planes" } else { name };
        Curve::of_halves(name, color, halves.map(half))
    });
    let last = table.polar.last().map_or(0.0, |angle| angle.to_degrees());
    Diagram { reach: if last > 90.0 + 1e-9 { 180.0 } else { 90.0 }, unit, curves: curves.collect() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Scene;
    use serde_json::{Value, json};

    fn lamps(sources: &[Value]) -> Vec<(Vec<String>, Diagram)> {
        let floor = json!({"type": "irradiance", "name": "floor", "cs": {"z": 9}, "width": 9, "height": 9, "num_pixels_x": 4,
            "num_pixels_y": 4});
        let text =
            json!({"nsq_schema_version": 1, "components": [], "detectors": [floor], "sources": sources});
        of_lamps(&Scene::from_json(&text.to_string()).unwrap().lower().unwrap())
    }

    fn lamp(name: &str, wavelength: f64) -> Value {
        json!({"type": "tabulated", "name": name, "cs": {}, "polar_angles_deg": [0, 45, 90],
            "azimuth_angles_deg": [0, 90, 180, 270, 360], "intensity_units": if wavelength < 0.7 { "cd" } else { "W/sr" },
            "intensity": [[100, 80, 0], [100, 60, 10], [100, 40, 0], [100, 20, 0], [100, 80, 0]],
            "spectrum": {"wavelengths": [wavelength], "weights": [1]}})
    }

    #[test]
    fn a_lamp_has_the_planes_of_its_table() {
        let found = lamps(&[lamp("one", 0.555), lamp("two", 0.555), lamp("warm", 0.9)]);
        let names: Vec<&[String]> = found.iter().map(|(names, _)| names.as_slice()).collect();
        assert_eq!(names, [["one", "two"].map(String::from).as_slice(), ["warm".to_string()].as_slice()]);
        assert_eq!([found[0].1.unit, found[1].1.unit], ["cd", "W/sr"]);
        for (_, Diagram { reach, curves, .. }) in &found {
            assert_eq!(*reach, 90.0);
            let near = |curve: &Curve, expected: [f64; 6]| {
                let angles = [-90.0, -45.0, 0.0, 0.0, 45.0, 90.0];
                assert_eq!(curve.points.len(), 6);
                for ((found, angle), value) in curve.points.iter().zip(angles).zip(expected) {
                    assert!((found.0 - angle).abs() < 1e-9 && (found.1 - value).abs() < 1e-9, "{curve:?}");
                }
            };
            // C180 to the left and C0 to the right; then C270, which is the azimuth 90, and C90.
            near(&curves[0], [0.0, 40.0, 100.0, 100.0, 80.0, 0.0]);
            near(&curves[1], [10.0, 60.0, 100.0, 100.0, 20.0, 0.0]);
        }
    }

    #[test]
    fn a_lamp_of_revolution_has_one_curve() {
        let mut even = lamp("even", 0.555);
        (even["azimuth_angles_deg"], even["intensity"]) = (json!([0]), json!([3, 2, 1]));
        even["polar_angles_deg"] = json!([0, 90, 180]);
        let found = lamps(&[even]);
        assert_eq!(
            (found[0].1.reach, found[0].1.curves.len(), found[0].1.curves[0].name),
            (180.0, 1, "all planes")
        );
        assert!((found[0].1.top() - 3.0).abs() < 1e-9);
    }
}
