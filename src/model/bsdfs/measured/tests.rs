use super::*;
use crate::random::Draw;
use std::f64::consts::PI;

fn written(text: serde_json::Value) -> Result<(MeasuredTable, Vec<String>)> {
    let written: Written = serde_json::from_value(text).unwrap();
    let (mut warnings, surface) = (Vec::new(), Labelled { name: "wall", place: "surfaces[0].bsdf" });
    let mut reading = BsdfContext { folder: Path::new("."), warnings: &mut warnings };
    let Bsdf::Measured(measured) = written.bsdf(&surface, &mut reading)? else { panic!() };
    Ok((MeasuredTable::clone(&measured.table), warnings))
}

/// A Lambertian surface of 0.5 is 0.5 / pi in all directions, whatever they are measured from.
#[test]
fn the_share_is_the_integral_over_the_hemisphere() {
    let even = vec![vec![vec![0.5 / PI; 2]; 2]; 3];
    let (table, warnings) = written(serde_json::json!({"angle_of_incidence_deg": [0, 40, 80],
        "scatter_azimuth_deg": [0, 180], "scatter_radial_deg": [0, 180], "values": even}))
    .unwrap();
    for row in &table.rows {
        assert!((row.scattered - 0.5).abs() < 1e-12, "{} at {}", row.scattered, row.incidence_deg);
    }
    assert!(warnings.iter().any(|warning| warning.contains("from 0 to 80 degrees")), "{warnings:?}");
}

#[test]
fn the_share_of_the_file_counts() {
    let even = vec![vec![vec![1.0; 2]]];
    let (table, warnings) =
        written(serde_json::json!({"angle_of_incidence_deg": [20], "scatter_azimuth_deg": [0],
        "scatter_radial_deg": [0, 30], "values": even, "tis": [0.25], "scatter_type": "BTDF"}))
        .unwrap();
    assert!(table.transmits && table.rows[0].scattered == 0.25);
    // The cone lies above the surface, so that its cosines add up to pi sin(30)^2 cos(20).
    let height = 0.25 / (PI * 0.25 * 20.0_f64.to_radians().cos());
    let value = table.rows[0].values.rows[0][0];
    assert!((value - height).abs() < 1e-12 * height, "{value} and {height}");
    for said in ["its TIS says 0.25", "ends 30 degrees from the specular direction"] {
        assert!(warnings.iter().any(|warning| warning.contains(said)), "{warnings:?}");
    }
}

const ZEMAX: &str = "# made up\nSource  Measured\nSymmetry\tPlaneSymmetrical\nSpectralContent Monochrome\nScatterType BRDF\n\
    SampleRotation 1\n0\nAngleOfIncidence 2\n10 50\nScatterAzimuth 3\n0 90 180\nScatterRadial 3\n0 10 20\n\nMonochrome\nDataBegin\n\
    TIS 0.1\n3 2 1\n3 1 0\n3 0.5 0\nTIS 0.2\n5 2 1\n5 1 0\n5 0.5 0\nDataEnd\n";

#[test]
fn both_files_say_the_same() {
    let of_zemax = zemax::parse("p", ZEMAX).unwrap();
    let mut lines = vec!["bsdf, scatter_azimuth_deg,scatter_radial_deg ,angle_of_incidence_deg".to_owned()];
    for (i, incidence) in of_zemax.incidence.iter().enumerate() {
        for (j, azimuth) in of_zemax.azimuth.iter().enumerate() {
            for (k, radial) in of_zemax.radial.iter().enumerate() {
                lines.push(format!("{}, {azimuth}, {radial}, {incidence}", of_zemax.values[i][j][k]));
            }
        }
    }
    lines[1..].reverse();
    let of_csv = csv::parse("p", &lines.join("\n")).unwrap();
    assert_eq!(of_zemax.values, of_csv.values);
    assert_eq!((of_zemax.tis.clone(), of_csv.tis), (Some(vec![0.1, 0.2]), None));
    let table = of_zemax.table(&|key| key.to_owned()).unwrap();
    assert_eq!(table.rows[1].values.azimuth.len(), 5);
    assert_eq!(table.rows[1].values.rows[4], table.rows[1].values.rows[0]);
}

#[test]
fn files_are_refused_by_line_and_cure() {
    let broken = [
        ("SampleRotation 1\n0", "SampleRotation 2\n0 90", "line 6", "grain"),
        ("Monochrome\nS", "XYZ\nS", "line 4", "Monochrome for each wavelength"),
        ("PlaneSymmetrical", "ASymmetrical", "line 3", "azimuths up to 360"),
        ("3 0.5 0\nTIS", "3 0.5\nTIS", "line 21", "\"TIS\" is not a value"),
        ("DataEnd", "", "line 24", "ends before DataEnd"),
        ("0 10 20", "0 10 1e400", "scatter_radial_deg[2]", "180"),
        ("5 2 1", "5 -2 1", "values[1][0][1]", "0"),
        ("TIS 0.2", "TIS 1.2", "line 21", "1"),
        ("0 90 180", "0 90 170", "scatter_azimuth_deg", "end them at 360"),
        ("ScatterAzimuth 3", "ScatterAzimuth 99999999999", "line 10", "from 1 to"),
    ];
    for (before, after, place, cure) in broken {
        let text = ZEMAX.replacen(before, after, 1);
        assert_ne!(text, ZEMAX, "{before}");
        let read = zemax::parse("p", &text).and_then(|grid| grid.table(&|key| format!("p, {key}")));
        let error = read.unwrap_err().to_string();
        assert!(error.contains(place) && error.contains(cure), "{before} -> {after}: {error}");
    }
    for (text, said) in [
        ("1, 2, 3, 4", "begin the table with a line"),
        ("angle_of_incidence_deg,scatter_azimuth_deg,scatter_radial_deg,bsdf\n0,0,0,1\n0,0,10", "line 3"),
        (
            "angle_of_incidence_deg,scatter_azimuth_deg,scatter_radial_deg,bsdf\n0,0,0,1\n0,0,0,1",
            "occur twice",
        ),
        (
            "angle_of_incidence_deg,scatter_azimuth_deg,scatter_radial_deg,bsdf\n0,0,0,1\n9,0,1,1",
            "2 lines for 2 x 1 x 2",
        ),
        ("# scatter_type: both", "write BRDF or BTDF"),
        ("", "0 lines"),
    ] {
        let error = csv::parse("p", text).unwrap_err().to_string();
        assert!(error.contains(said), "{text:?}: {error}");
    }
}

/// 2,000 files with a few bytes changed: each is read or refused.
#[test]
fn no_file_breaks_the_reader() {
    let csv =
        "angle_of_incidence_deg,scatter_azimuth_deg,scatter_radial_deg,bsdf\n0,0,0,1\n0,0,10,0.5 # last\n";
    let mut dice = Draw::new(1);
    for (text, parse) in [(ZEMAX, zemax::parse as fn(&str, &str) -> Result<Grid>), (csv, csv::parse)] {
        let mut num_read = 0;
        for _ in 0..2000 {
            let mut bytes = text.as_bytes().to_vec();
            for _ in 0..1 + dice.roll(3) {
                let at = dice.roll(bytes.len().max(1)).min(bytes.len().saturating_sub(1));
                match dice.roll(3) {
                    0 => bytes[at] = b"0123456789.-e#, \n\tXT"[dice.roll(20)],
                    1 => drop(bytes.remove(at)),
                    _ => bytes.truncate(at + 1),
                }
            }
            let read = parse("p", &String::from_utf8_lossy(&bytes));
            if let Ok(table) = read.and_then(|grid| grid.table(&|key| key.to_owned())) {
                let numbers = table.numbers(1.0);
                assert!(
                    numbers.iter().all(|number| number.is_finite()),
                    "{}",
                    String::from_utf8_lossy(&bytes)
                );
                num_read += 1;
            }
        }
        assert!((40..1960).contains(&num_read), "{num_read} were read");
    }
}
