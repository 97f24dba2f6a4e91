//! Ten thousand damaged scenes: each is read or refused as a scene, and none panics. What is accepted is sane.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use nsq_gpu::Error;
use nsq_gpu::model::{Conic, DetectorKind, Interaction, SceneIr, Shape, Spectral};
use nsq_gpu::scene::Scene;
use serde_json::{Value, json};

const MUTATIONS: usize = 5000;

const SCENE: &str = r#"{
  "nsq_schema_version": 1,
  "components": [
    {"type": "lens", "name": "L1", "cs": {"z": 10.0, "reference_cs": {"x": 1.0, "ry": 0.5}},
     "config": {"r1": 50.0, "r2": -50.0, "thickness": 4.0, "material": "N-BK7", "front_aperture_radius": 10.0,
                "back_aperture_radius": 9.0, "conic1": -0.5}},
    {"type": "mirror", "name": "M", "cs": {"z": 60.0},
     "config": {"radius": -100.0, "reflectance": 0.9, "aperture_radius": 20.0}},
    {"type": "doublet", "name": "D", "cs": {"rx": 0.1},
     "config": {"r1": 61.0, "r2": -44.0, "r3": -130.0, "thickness1": 6.0, "thickness2": 2.5,
                "material1": {"type": "catalog", "name": "N-BK7"}, "material2": "N-SF5", "aperture_radius": 12.0}}
  ],
  "sources": [
    {"type": "collimated", "name": "S", "cs": {}, "total_flux": 2.0, "aperture_radius": 3.0, "profile": "gaussian",
     "spectrum": {"wavelengths": [0.4861, 0.5876], "weights": [1.0, 2.0]}, "medium": null},
    {"type": "point", "name": "P", "cs": {}, "total_flux": 1.0, "half_angle_deg": 30.0,
     "spectrum": {"wavelengths": [0.5876], "weights": [3.0]}},
    {"type": "extended", "name": "E", "cs": {}, "total_flux": 1.0, "width": 2, "height": 3, "aperture_radius": null,
     "spectrum": {"wavelengths": [0.5876], "weights": [1]}}
  ],
  "detectors": [
    {"type": "irradiance", "name": "I", "cs": {}, "width": 10.0, "height": 5.0, "num_pixels_x": 64, "splat": "hard"},
    {"type": "spectral", "name": "W", "cs": {}, "width": 11.0, "height": 5.0, "wl_min": 0.4, "wl_max": 0.7,
     "num_bins": 7, "splat": "gaussian", "splat_sigma": 1.5},
    {"type": "far_field", "name": "F", "cs": {}, "num_bins_theta": 9},
    {"type": "ray_database", "name": "R", "cs": {}, "width": 12.0, "height": 2.0}
  ],
  "nsq_gpu": {
    "version": 1,
    "media": {"glass": {"type": "constant", "n": 1.5},
              "tab": {"type": "table", "wavelengths": [0.4861, 0.5876], "n": [1.5, 1.6], "k": [0, 0]}},
    "surfaces": [{"name": "ball", "cs": {}, "shape": {"type": "sphere", "radius": 5.0}, "interaction": "refractive",
                  "material_back": {"type": "medium", "name": "glass"}, "bsdf": null, "coating": null},
                 {"name": "cone", "cs": {}, "shape": {"type": "frustum", "r_front": 5, "r_back": 0, "z_front": 0,
                  "z_back": 3}, "interaction": "reflective",
                  "reflectance": {"wavelengths": [0.4861, 0.5876], "values": [0.1, 0.9]}}],
    "overrides": {"L1.back": {"interaction": "reflective", "reflectance": 0.5}},
    "order": ["L1", "ball", "M", "D", "cone"],
    "detectors": {"R": {"max_rays": 10}},
    "sampling": {"reflect_prob": "auto", "split_depth": 2, "split_budget": 2.5}
  }
}"#;

/// xorshift64*: a fixed sequence, so that a failure repeats.
struct Rng(u64);

impl Rng {
    fn below(&mut self, count: usize) -> usize {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 33) as usize % count
    }
}

/// Reads a scene; true if it was accepted.
fn accepted(text: &str) -> bool {
    match Scene::from_json(text).and_then(|scene| scene.lower()) {
        Ok(ir) => {
            assert_sane(&ir, text);
            true
        }
        Err(Error::Scene { place, problem, remedy }) => {
            assert!(
                !place.is_empty() && !problem.is_empty() && !remedy.is_empty(),
                "empty message for {text}"
            );
            let clean = |words: &str| !words.chars().any(char::is_control);
            assert!(clean(&place) && clean(&problem) && clean(&remedy), "{place}: {problem}; {remedy}");
            assert!(place.len() + problem.len() + remedy.len() < 3000, "{place}: {problem}; {remedy}");
            false
        }
        Err(other) => panic!("{other:?} for {text}"),
    }
}

fn assert_sane(ir: &SceneIr, text: &str) {
    let unit = |value: &f64| (0.0..=1.0).contains(value);
    for surface in &ir.surfaces {
        assert!(surface.frame.origin.is_finite() && surface.frame.rotation.is_finite(), "{text}");
        assert!(surface.front < ir.media.len() && surface.back < ir.media.len(), "{text}");
        if let Interaction::Reflective { reflectance } = &surface.interaction {
            assert!(reflectance.len() == ir.wavelengths.len() && reflectance.iter().all(unit), "{text}");
        }
        if let Shape::Conic(Conic { curvature, conic, aperture_radius }) = surface.shape {
            assert!(curvature.is_finite() && conic.is_finite() && aperture_radius > 0.0, "{text}");
        }
    }
    for medium in &ir.media {
        assert!(medium.n.iter().all(|n| *n > 0.0 && n.is_finite()), "{text}");
        assert!(medium.k.iter().all(|k| *k >= 0.0 && k.is_finite()), "{text}");
    }
    for source in &ir.sources {
        assert_eq!(source.spectrum.cdf.last(), Some(&1.0), "{text}");
        assert!(source.spectrum.cdf.is_sorted() && source.spectrum.cdf.iter().all(unit), "{text}");
    }
    for detector in &ir.detectors {
        assert!(detector.num_cells() <= 1 << 31, "{text}");
        if let DetectorKind::Spectral(Spectral { wavelength_edges, .. }) = &detector.kind {
            assert!(wavelength_edges.is_sorted(), "{text}");
        }
    }
}

/// Changes the first digit from `at` on, which the parser does not notice.
fn change_digit(bytes: &mut [u8], at: usize, rng: &mut Rng) {
    if let Some(digit) = bytes[at..].iter_mut().find(|byte| byte.is_ascii_digit()) {
        *digit = b"0123456789-"[rng.below(11)];
    }
}

fn damage_text(rng: &mut Rng) -> String {
    let mut bytes = SCENE.as_bytes().to_vec();
    for _ in 0..1 + rng.below(2) {
        let at = rng.below(bytes.len());
        let len = (1 + rng.below(30)).min(bytes.len() - at);
        match rng.below(8) {
            0 => bytes[at] = rng.below(256) as u8,
            1 => bytes[at] = b"{}[]\",:0-+.eE/*\\tfnI\n"[rng.below(21)],
            2 => bytes.insert(at, b"{}[]\",:0-+.eE/*\\tfnI\n"[rng.below(21)]),
            3 => bytes.truncate(at.max(1)),
            4 => drop(bytes.drain(at..at + len)),
            5 | 6 => change_digit(&mut bytes, at, rng),
            _ => {
                let copy = bytes[at..at + len].to_vec();
                bytes.splice(at..at, copy);
            }
        }
        if bytes.len() < 2 {
            break;
        }
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

#[test]
fn damaged_text_is_read_or_refused() {
    let mut rng = Rng(0x5EED_0001);
    let survivors = (0..MUTATIONS).filter(|_| accepted(&damage_text(&mut rng))).count();
    // The mutations reach past the parser: some digits change and the scene stays valid.
    assert!((50..MUTATIONS / 2).contains(&survivors), "{survivors} accepted");
}

/// The node that is reached by random turns, with a chance to stop at each.
fn random_node<'a>(value: &'a mut Value, rng: &mut Rng, depth: usize) -> &'a mut Value {
    let count = match value {
        Value::Array(items) => items.len(),
        Value::Object(entries) => entries.len(),
        _ => 0,
    };
    if count == 0 || (depth > 0 && rng.below(6) == 0) {
        return value;
    }
    let pick = rng.below(count);
    match value {
        Value::Array(items) => random_node(&mut items[pick], rng, depth + 1),
        Value::Object(entries) => random_node(entries.values_mut().nth(pick).unwrap(), rng, depth + 1),
        _ => unreachable!(),
    }
}

fn misspell(entries: &mut serde_json::Map<String, Value>, rng: &mut Rng) {
    let key = entries.keys().nth(rng.below(entries.len())).unwrap().clone();
    let value = entries.remove(&key).unwrap();
    let mut letters: Vec<char> = key.chars().collect();
    match rng.below(3) {
        0 => drop(letters.pop()),
        1 => letters.push('x'),
        _ => letters.rotate_left(1),
    }
    entries.insert(letters.into_iter().collect(), value);
}

/// A wrong value; `<...>` becomes a bare word in the text.
fn wrong_value(old: &Value, rng: &mut Rng) -> Value {
    let words = [
        "<NaN>",
        "<Infinity>",
        "<-Infinity>",
        "",
        "lens",
        "..",
        "a/b",
        "\u{1b}[2J",
        "N-BK7",
        "$null",
        "medium",
    ];
    let numbers = [0.0, -0.0, -1.0, 0.5, 1e-300, 1e300, -1e300, 1e9, 587.6, 4294967296.0, 1e19, 3.5];
    match rng.below(12) {
        0 => Value::Null,
        1 => json!(true),
        2 => json!([]),
        3 => json!({}),
        4 => json!([old, old]),
        5 => json!({"type": old}),
        6 => json!({"type": "table", "name": "tab"}),
        7 | 8 => json!(words[rng.below(words.len())]),
        _ => json!(numbers[rng.below(numbers.len())]),
    }
}

fn damage_tree(whole: &Value, rng: &mut Rng) -> String {
    let mut tree = whole.clone();
    for _ in 0..1 + rng.below(2) {
        let node = random_node(&mut tree, rng, 0);
        match node {
            Value::Object(entries) if !entries.is_empty() && rng.below(2) == 0 => {
                let key = entries.keys().nth(rng.below(entries.len())).unwrap().clone();
                if rng.below(2) == 0 { drop(entries.remove(&key)) } else { misspell(entries, rng) }
            }
            Value::Array(items) if !items.is_empty() && rng.below(2) == 0 => {
                let at = rng.below(items.len());
                if rng.below(2) == 0 { drop(items.remove(at)) } else { items.push(items[at].clone()) }
            }
            node => *node = wrong_value(node, rng),
        }
    }
    tree.to_string().replace("\"<", "").replace(">\"", "")
}

#[test]
fn damaged_trees_are_read_or_refused() {
    let whole: Value = serde_json::from_str(SCENE).unwrap();
    assert!(accepted(&whole.to_string()));
    let mut rng = Rng(0x5EED_0002);
    let survivors = (0..MUTATIONS).filter(|_| accepted(&damage_tree(&whole, &mut rng))).count();
    assert!((50..MUTATIONS / 2).contains(&survivors), "{survivors} accepted");
}
