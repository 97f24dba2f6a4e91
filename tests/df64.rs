//! The tier of pairs of f32: how far it is from f64, its ledgers, its bits, and what it refuses.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "a test fails by panicking")]

mod zoo;

use nsq_gpu::model::SceneIr;
use nsq_gpu::program::Precision;
use nsq_gpu::program::layout::reals::{literal, put_real};
use nsq_gpu::program::rewrite::df64;
use nsq_gpu::result::{DetectorData, Tally};
use nsq_gpu::{Error, Scene, StandardError, TraceOptions};

/// Mirrors with roulette, absorption, Gaussian beams and splats, scattering, a mesh, split rays, faces in contact.
const DIVERSE: [&str; 7] = [
    "kaleidoscope",
    "filter_stack",
    "tessar_gaussian_beams",
    "scattering_telescope",
    "mesh_prism",
    "split_ghosts",
    "cemented_achromat_auto",
];

fn trace(name: &str, precision: Precision) -> (SceneIr, TraceOptions, Tally) {
    let ir = zoo::load(name);
    let options = zoo::options(4_000, 5, precision);
    let tally = zoo::trace(&ir, &options);
    (ir, options, tally)
}

#[test]
fn a_pair_is_the_nearest_number_and_what_is_left() {
    for value in [0.0, 1.0, -1.0, 0.1, 1e30, -1e-20, std::f64::consts::PI, 16_777_217.0] {
        let [high, low] = df64::split(value);
        assert_eq!(high, value as f32);
        assert!(f64::from(low.abs()) <= 0.5 * f64::from(high.next_up() - high).abs(), "{value:e}");
        assert!((df64::rounded(value) - value).abs() <= value.abs() * 2_f64.powi(-48), "{value:e}");
        assert_eq!(df64::split(df64::rounded(value)), [high, low]);
    }
}

#[test]
fn this_device_passes_the_test_and_tells_what_fails() {
    let gpu = zoo::gpu();
    gpu.check_df64().unwrap();
    // A fused or simplified sum, as a compiler that reorders makes it.
    let wrong = zoo::replaced(df64::LIBRARY, "df64_rounded(b - taken)", "0.0");
    let Err(Error::Usage(message)) = gpu.test_df64(&wrong) else { panic!("sums without their error pass") };
    for part in ["cannot trace in df64, because", "is off by", "use --precision f32"] {
        assert!(message.contains(part), "{message}");
    }
}

/// Six surfaces over 200 mm: three lenses, and a detector that records positions.
const RELAY: &str = r#"{
    "nsq_schema_version": 1,
    "components": [
        {"name": "L1", "type": "lens", "cs": {"z": 20.0},
         "config": {"r1": 61.7, "r2": -403.0, "thickness": 9.3, "material": "N-BK7", "front_aperture_radius": 20.0}},
        {"name": "L2", "type": "lens", "cs": {"z": 90.0, "rx": 0.013, "ry": -0.021},
         "config": {"r1": -47.1, "r2": 83.9, "thickness": 3.1, "material": "N-SF11", "front_aperture_radius": 15.0}},
        {"name": "L3", "type": "lens", "cs": {"z": 140.0, "x": 0.37},
         "config": {"r1": 71.3, "r2": -58.7, "thickness": 8.9, "material": "N-LAK9", "front_aperture_radius": 22.0}}
    ],
    "sources": [
        {"name": "lamp", "type": "point", "cs": {"x": 1.7}, "half_angle_deg": 9.0, "total_flux": 1.0,
         "spectrum": {"wavelengths": [0.4861, 0.5876, 0.6563], "weights": [1, 1, 1]}}
    ],
    "detectors": [
        {"name": "image", "type": "ray_database", "cs": {"z": 200.0}, "width": 400.0, "height": 400.0}
    ]
}"#;

/// Positions and directions of the rays on the detector.
fn arrivals(ir: &SceneIr, precision: Precision) -> Vec<[f64; 6]> {
    let result = zoo::result(ir, &zoo::options(20_000, 3, precision));
    let DetectorData::RayDatabase(database) = &result.detectors[0].data else { panic!("no ray database") };
    let rows = database.columns().unwrap();
    let columns = rows.position.iter().chain(&rows.direction);
    let columns: Vec<Vec<f64>> = columns.map(|column| column.to_vec()).collect();
    (0..columns[0].len()).map(|i| std::array::from_fn(|column| columns[column][i])).collect()
}

#[test]
fn positions_over_six_surfaces_and_200_mm_are_within_1e_10_mm() {
    if !zoo::gpu().f64 {
        zoo::skip("df64 beside f64", "the adapter has no 64-bit floats");
        return;
    }
    let ir = Scene::from_json(RELAY).unwrap().lower().unwrap();
    let [exact, paired, single] =
        [Precision::F64, Precision::Df64, Precision::F32].map(|precision| arrivals(&ir, precision));
    assert!(exact.len() > 10_000, "{} rays arrive", exact.len());
    assert_eq!((paired.len(), single.len()), (exact.len(), exact.len()));
    let largest = |rows: &[[f64; 6]], columns: std::ops::Range<usize>| {
        let errors = rows
            .iter()
            .zip(&exact)
            .flat_map(|(row, exact)| columns.clone().map(move |column| (row[column] - exact[column]).abs()));
        errors.fold(0.0, f64::max)
    };
    let (position, direction) = (largest(&paired, 0..3), largest(&paired, 3..6));
    println!("df64: {position:.1e} mm, {direction:.1e}; f32: {:.1e} mm", largest(&single, 0..3));
    assert!(position < 1e-10, "positions differ by {position:e} mm");
    assert!(direction < 1e-12, "direction cosines differ by {direction:e}");
}

#[test]
fn every_ledger_closes_in_df64() {
    for name in zoo::in_turn(DIVERSE) {
        let (ir, options, tally) = trace(name, Precision::Df64);
        let ledger = zoo::result_of(&ir, &options, &tally).ledger;
        assert_eq!((ledger.imbalance_quanta, ledger.invalid_deposits), (0, 0), "{name}");
    }
}

#[test]
fn df64_gives_the_same_bits_whatever_the_batch_and_the_integers() {
    let others: [fn(&mut TraceOptions); 2] = [
        |options| options.batch_size = Some(777),
        |options| (options.workgroup_size, options.events_per_dispatch) = (128, 3),
    ];
    for name in ["kaleidoscope", "bench_lens"] {
        let ir = zoo::load(name);
        let whole =
            TraceOptions { standard_error: StandardError::Off, ..zoo::options(4_000, 5, Precision::Df64) };
        let tally = zoo::trace(&ir, &whole);
        for (i, change) in others.iter().enumerate() {
            let mut options = whole.clone();
            change(&mut options);
            assert!(zoo::trace(&ir, &options) == tally, "{name}, change {i}");
        }
        assert!(zoo::trace_on(zoo::portable_gpu(), &ir, &whole) == tally, "{name}, pairs of integers");
    }
}

#[test]
fn a_number_beyond_the_range_of_f32_is_refused() {
    let refused = literal(1e39, Precision::Df64);
    let message = "1e39 does not fit df64; use --precision f64".to_string();
    assert_eq!(refused, Err(Error::Usage(message.clone())));
    assert_eq!(put_real(&mut [0; 8], 1e39, Precision::Df64), Err(Error::Usage(message)));
    assert!(literal(1e38, Precision::Df64).is_ok());
}

#[test]
fn no_f64_is_left_in_the_shader() {
    for name in ["filter_stack", "kaleidoscope"] {
        let ir = zoo::load(name);
        let tracer = zoo::tracer(&ir, &zoo::options(10, 0, Precision::Df64)).unwrap();
        let source = tracer.program().device_wgsl().replace("df64", "");
        assert!(!source.contains("f64"), "{name}");
    }
}
