//! A scene written in Rust, traced once for each of several numbers: where is the focus of a lens?
//!
//! `cargo run --example scene_in_code`

#![allow(clippy::print_stdout, reason = "an example shows what it found")]

use nsq_gpu::gpu::{AdapterChoice, Gpu};
use nsq_gpu::result::DetectorData;
use nsq_gpu::{Error, Result, Run, Scene};
use serde_json::{Value, json};

/// A biconvex lens in a beam 20 mm wide, and a detector behind it; lengths in mm, wavelengths in um.
fn scene(detector_z: f64) -> Value {
    let at = |z: f64| json!({"x": 0, "y": 0, "z": z, "rx": 0, "ry": 0, "rz": 0, "reference_cs": null});
    let lens = json!({"r1": 52, "r2": -52, "thickness": 6, "material": "N-BK7", "front_aperture_radius": 12});
    let line = json!({"wavelengths": [0.5876], "weights": [1]});
    json!({
        "nsq_schema_version": 1,
        "components": [{"name": "L1", "type": "lens", "cs": at(0.0), "config": lens}],
        "sources": [{"name": "beam", "type": "collimated", "total_flux": 1.0, "aperture_radius": 10,
                     "cs": at(-10.0), "spectrum": line}],
        "detectors": [{"name": "image", "type": "irradiance", "width": 2, "height": 2,
                       "num_pixels_x": 64, "num_pixels_y": 64, "cs": at(detector_z)}],
    })
}

fn main() -> Result<()> {
    let gpu = Gpu::open(&AdapterChoice::default())?;
    println!("z [mm]  flux [W]  peak [W/mm^2]");
    for z in [48.0, 50.0, 52.0, 53.0, 54.0, 55.0, 56.0] {
        let scene = Scene::from_json(&scene(z).to_string())?;
        let result = Run::new(scene)?.on(&gpu).rays(1e5)?.go()?.result;
        let image = result.detector("image").ok_or_else(|| Error::Usage("no such detector".into()))?;
        if let DetectorData::Irradiance(map) = &image.data {
            let peak = map.irradiance.iter().copied().fold(0.0, f64::max);
            println!("{z:6.1}  {:8.4}  {peak:13.3}", image.total_flux);
        }
    }
    Ok(())
}
