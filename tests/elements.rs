//! Names of elements, gaps and frames: each moves what a scene written by hand has moved, to the bit.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

mod command;
mod zoo;

use glam::{DMat3, DVec3};
use nsq_gpu::Scene;
use nsq_gpu::model::{Frame, SceneIr};
use serde_json::{Value, json};

const FRAME: [&str; 6] = ["x", "y", "z", "rx", "ry", "rz"];

fn with(scene: &Value, numbers: &[(&str, f64)]) -> Result<SceneIr, String> {
    let numbers: Vec<(String, f64)> =
        numbers.iter().map(|(name, value)| (name.to_string(), *value)).collect();
    let folder = zoo::repository("scenes");
    let scene =
        Scene::with_numbers(&scene.to_string(), &folder, &numbers).map_err(|error| error.to_string())?;
    scene.lower().map_err(|error| error.to_string())
}

/// The text of a file as JSON has it, in which no bare word is infinite.
fn finite(text: &str) -> String {
    text.replace("-Infinity", "-1e999")
        .replace(": Infinity", ": \"Infinity\"")
        .replace("-1e999", "\"-Infinity\"")
}

fn number(scene: &Value, name: &str) -> f64 {
    Scene::numbers(&scene.to_string(), &[name.to_string()]).unwrap()[0]
}

/// The entry of a name: a component, a surface or a detector.
fn entry<'s>(scene: &'s mut Value, name: &str) -> &'s mut Value {
    let lists = ["/components", "/nsq_gpu/surfaces", "/detectors"];
    let list = lists.into_iter().find(|list| {
        let entries = scene.pointer(list).and_then(Value::as_array);
        entries.is_some_and(|entries| entries.iter().any(|entry| entry["name"] == name))
    });
    let entries = scene.pointer_mut(list.unwrap()).unwrap().as_array_mut().unwrap();
    entries.iter_mut().find(|entry| entry["name"] == name).unwrap()
}

fn cs(scene: &Value, name: &str) -> [f64; 6] {
    let entry = entry(&mut scene.clone(), name)["cs"].clone();
    FRAME.map(|key| entry[key].as_f64().unwrap_or(0.0))
}

/// The scene with a number of an element of these entries, as somebody would write it who moves each by hand.
fn by_hand(scene: &Value, names: &[String], key: usize, value: f64) -> Value {
    let first = cs(scene, &names[0]);
    let mut moved = scene.clone();
    for name in names {
        let own = cs(scene, name);
        let frame = &mut entry(&mut moved, name)["cs"];
        if own == first {
            frame[FRAME[key]] = json!(value);
        } else if key < 3 {
            frame[FRAME[key]] = json!(own[key] + (value - first[key]));
        } else {
            // Within the frame of the first face, which is not turned where the file has it.
            for i in 0..3 {
                frame[FRAME[i]] = json!(own[i] - first[i]);
            }
            let mut outer = first;
            outer[key] = value;
            let outer: serde_json::Map<_, _> =
                FRAME.iter().zip(outer).map(|(key, value)| (key.to_string(), json!(value))).collect();
            frame["reference_cs"] = Value::Object(outer);
        }
    }
    moved
}

/// Components and single surfaces of a scene, of which each stands in no other frame.
fn entries(scene: &Value) -> Vec<String> {
    let lists =
        ["/components", "/nsq_gpu/surfaces"].map(|list| scene.pointer(list).and_then(Value::as_array));
    let all = lists.into_iter().flatten().flatten();
    let free = all.filter(|entry| entry["cs"]["reference_cs"].is_null());
    free.map(|entry| entry["name"].as_str().unwrap().to_owned()).collect()
}

fn listed(scene: &Value, elements: Value) -> Value {
    let mut scene = scene.clone();
    if scene["nsq_gpu"].is_null() {
        scene["nsq_gpu"] = json!({"version": 1});
    }
    scene["nsq_gpu"]["elements"] = elements;
    scene
}

/// Each of six numbers of each component, alone and with the entry that follows it, in all scenes.
#[test]
fn a_name_of_an_element_gives_the_scene_written_by_hand() {
    let mut num_compared = [0, 0];
    for (_, name) in zoo::scenes_in_turn() {
        let text = std::fs::read_to_string(zoo::repository(&format!("scenes/{name}.json"))).unwrap();
        let scene: Value = serde_json::from_str(&finite(&text)).unwrap();
        let names = entries(&scene);
        // Of large scenes the first entries stand for all.
        let alone = names.iter().take(12).map(|name| vec![name.clone()]);
        for names in alone.chain(names.windows(2).take(12).map(<[_]>::to_vec)) {
            let scene = listed(&scene, json!([{"name": "an element", "faces": names}]));
            let first = cs(&scene, &names[0]);
            if names.len() > 1 && first[3..] != [0.0; 3] {
                continue;
            }
            let mut hand = scene.clone();
            hand["nsq_gpu"]["elements"] = json!([]);
            for key in 0..6 {
                let label = format!("{name}: {names:?}: {}", FRAME[key]);
                let number_name = format!("an element.{}", FRAME[key]);
                assert_eq!(number(&scene, &number_name), first[key], "{label}");
                let value = first[key] + if key < 3 { 0.0625 } else { 0.01 };
                let ours = with(&scene, &[(&number_name, value)]);
                let theirs = with(&by_hand(&hand, &names, key, value), &[]);
                assert_eq!(ours.is_ok(), theirs.is_ok(), "{label}: {ours:?}");
                let Ok(ours) = ours else { continue };
                assert_eq!(ours, theirs.unwrap(), "{label}");
                assert_ne!(ours, with(&hand, &[]).unwrap(), "{label}");
                // The number that the file has moves nothing.
                assert_eq!(with(&scene, &[(&number_name, first[key])]), with(&hand, &[]), "{label}");
                num_compared[names.len() - 1] += 1;
            }
        }
    }
    let least = if zoo::turn().is_none() { [700, 500] } else { [200, 150] };
    assert!(num_compared[0] > least[0] && num_compared[1] > least[1], "{num_compared:?}");
}

/// A small number that is far from the file's number keeps its digits.
#[test]
fn a_number_of_an_element_is_what_was_set_to_the_bit() {
    let mut scene = plates();
    entry(&mut scene, "A")["cs"]["x"] = json!(1000);
    let there = with(&scene, &[("L1.x", 0.1)]).unwrap();
    assert_eq!(frame(&there, "A").origin.x, 0.1);
}

/// Three plates of one surface each, a stop between, and a screen.
fn plates() -> Value {
    let plate = |name: &str, cs: Value| json!({"name": name, "cs": cs, "shape": {"type": "plane", "width": 20, "height": 20}, "interaction": "absorbing"});
    json!({"nsq_schema_version": 1, "components": [],
        "sources": [{"name": "beam", "type": "collimated", "total_flux": 1, "aperture_radius": 1, "cs": {"z": -5},
            "spectrum": {"wavelengths": [0.5], "weights": [1]}}],
        "detectors": [{"name": "image", "type": "irradiance", "width": 9, "height": 9, "cs": {"z": 50}}],
        "nsq_gpu": {"version": 1,
            "surfaces": [plate("A", json!({"x": 1, "z": 1.5, "rx": 0.2, "rz": 0.3})), plate("B", json!({"y": 2, "z": 4})),
                plate("C", json!({"z": 9, "ry": -0.4})), plate("stop", json!({"z": 7})),
                plate("D", json!({"x": 0.5, "z": 2, "reference_cs": {"x": 3, "z": 20, "ry": 0.3, "name": "barrel"}})),
                plate("E", json!({"z": 5, "reference_cs": {"x": 3, "z": 20, "ry": 0.3, "name": "barrel"}}))],
            "elements": [
                {"name": "L1", "faces": ["A", "B"], "behind": ["stop"]},
                {"name": "L2", "faces": ["C"], "behind": []},
                {"name": "L3", "faces": ["D", "E"], "behind": ["image"]},
                {"name": "group", "faces": ["B", "A", "C"], "parts": ["D"], "pivot": [1, 2, 3]}]}})
}

fn frame(ir: &SceneIr, name: &str) -> Frame {
    let surfaces = ir.surfaces.iter().map(|surface| (&surface.name, surface.frame));
    let detectors = ir.detectors.iter().map(|detector| (&detector.name, detector.frame));
    surfaces.chain(detectors).find(|(known, _)| *known == name).unwrap().1
}

/// A frame of six numbers.
fn of([x, y, z, rx, ry, rz]: [f64; 6]) -> Frame {
    let rotation = DMat3::from_rotation_z(rz) * DMat3::from_rotation_y(ry) * DMat3::from_rotation_x(rx);
    Frame { origin: DVec3::new(x, y, z), rotation }
}

/// The frame moved as another frame goes from one place to another.
fn moved(frame: Frame, from: Frame, to: Frame) -> Frame {
    let rotation = to.rotation * from.rotation.transpose();
    Frame { origin: to.origin + rotation * (frame.origin - from.origin), rotation: rotation * frame.rotation }
}

fn assert_near(found: Frame, expected: Frame, label: &str) {
    let turned = found.rotation - expected.rotation;
    let apart = [turned.x_axis, turned.y_axis, turned.z_axis, found.origin - expected.origin];
    assert!(apart.iter().all(|apart| apart.length() < 1e-13), "{label}: {found:?} is not {expected:?}");
}

/// Turned faces, a group that holds elements, a pivot, and frames within frames: all by matrices.
#[test]
fn elements_move_rigidly_and_groups_move_what_their_members_have_moved() {
    let scene = plates();
    let here = with(&scene, &[]).unwrap();
    let names = ["L1.y", "L1.rx", "L1.ry", "group.z", "group.rz", "group.rx", "gap_2", "L3.rz", "barrel.y"];
    let values = [0.7, 0.35, 0.1, 9.0, 0.2, -0.3, 8.0, 0.5, 0.25];
    let all: Vec<(&str, f64)> = names.into_iter().zip(values).collect();
    let there = with(&scene, &all).unwrap();
    let a = [1.0, 0.0, 1.5, 0.2, 0.0, 0.3];
    let lens = |frame| moved(frame, of(a), of([1.0, 0.7, 1.5, 0.35, 0.1, 0.3]));
    let pivot = [1.0, 4.0, 7.0, 0.0, 0.0, 0.0];
    assert_eq!(["x", "y", "z"].map(|key| number(&scene, &format!("group.{key}"))), [1.0, 4.0, 7.0]);
    let group = |frame| moved(frame, of(pivot), of([1.0, 4.0, 9.0, -0.3, 0.0, 0.2]));
    assert_near(frame(&there, "A"), group(lens(frame(&here, "A"))), "A");
    assert_near(frame(&there, "B"), group(lens(frame(&here, "B"))), "B");
    assert_near(frame(&there, "C"), group(frame(&here, "C")), "C");
    assert_eq!(frame(&there, "stop"), frame(&here, "stop"));
    // The gap is along the axis of C, from its vertex; what is in the barrel moves with that first.
    let axis = frame(&here, "C").rotation * DVec3::Z;
    let size = (frame(&here, "D").origin - frame(&here, "C").origin).dot(axis);
    assert!((number(&scene, "gap_2") - size).abs() < 1e-14);
    let barrel = [3.0, 0.0, 20.0, 0.0, 0.3, 0.0];
    let raised = [3.0, 0.25, 20.0, 0.0, 0.3, 0.0];
    let within = |cs| {
        let (outer, inner) = (of(raised), of(cs));
        Frame {
            origin: outer.origin + outer.rotation * inner.origin,
            rotation: outer.rotation * inner.rotation,
        }
    };
    let d = [0.5, 0.0, 2.0, 0.0, 0.0, 0.0];
    let turned = [0.5, 0.0, 2.0, 0.0, 0.0, 0.5];
    let shift = |frame: Frame| Frame { origin: frame.origin + (8.0 - size) * axis, ..frame };
    let of_l3 =
        |name| shift(moved(moved(frame(&here, name), of(barrel), of(raised)), within(d), within(turned)));
    assert_near(frame(&there, "E"), of_l3("E"), "E");
    let image = shift(frame(&here, "image"));
    assert_near(frame(&there, "image"), image, "image");
    // D belongs to the group as well, which moves it before the gap does.
    let own = moved(moved(frame(&here, "D"), of(barrel), of(raised)), within(d), within(turned));
    assert_near(frame(&there, "D"), shift(group(own)), "D");
}

/// A sphere that turns about its centre stays where it is.
#[test]
fn an_element_turns_about_its_pivot() {
    let text = std::fs::read_to_string(zoo::repository("scenes/bench_lens.json")).unwrap();
    let scene: Value = serde_json::from_str(&text).unwrap();
    let name = scene["components"][0]["name"].as_str().unwrap();
    let elements = json!([{"name": name, "faces": [name], "pivot": [0, 0, 40]}]);
    let scene = listed(&scene, elements);
    let (here, there) = (
        with(&scene, &[]).unwrap(),
        with(&scene, &[(&format!("{name}.rx"), 0.2), (&format!("{name}.ry"), 0.1)]).unwrap(),
    );
    let center = |ir: &SceneIr| {
        ir.surfaces[0].frame.origin + ir.surfaces[0].frame.rotation * DVec3::new(0.0, 0.0, 40.0)
    };
    assert!(here.surfaces[0].frame != there.surfaces[0].frame);
    assert!(center(&here).distance(center(&there)) < 1e-13);
    let raised = number(&scene, &format!("{name}.z"));
    assert_eq!(raised, here.surfaces[0].frame.origin.z + 40.0);
}

/// All behind a gap moves along, and nothing before it; behind a mirror, along the light.
#[test]
fn a_gap_moves_what_follows() {
    let scene = plates();
    let here = with(&scene, &[]).unwrap();
    assert_eq!(number(&scene, "gap_1"), 5.0);
    let there = with(&scene, &[("gap_1", 5.5)]).unwrap();
    for (name, shift) in
        [("A", 0.0), ("B", 0.0), ("stop", 0.5), ("C", 0.5), ("D", 0.5), ("E", 0.5), ("image", 0.5)]
    {
        let (here, there) = (frame(&here, name), frame(&there, name));
        let apart = there.origin - here.origin - DVec3::new(0.0, 0.0, shift);
        assert!(apart.length() < 1e-14, "{name}");
        assert_eq!(there.rotation, here.rotation);
    }
    // A lens is as long as its glass; the mirror sends light back.
    let lens = json!({"name": "L", "type": "lens", "cs": {"z": 1}, "config": {"r1": 50, "r2": -50, "thickness": 4,
        "material": "N-BK7", "front_aperture_radius": 8}});
    let mirror = json!({"name": "M", "type": "mirror", "cs": {"z": 30},
        "config": {"radius": -100, "reflectance": 0.9, "aperture_radius": 9}});
    let mut scene = scene;
    scene["components"] = json!([lens, mirror]);
    scene["detectors"][0]["cs"] = json!({"z": 10});
    scene["nsq_gpu"]["surfaces"] = json!([]);
    scene["nsq_gpu"]["elements"] = json!([{"name": "L", "faces": ["L"], "behind": []},
        {"name": "M", "faces": ["M"], "behind": ["image"]}]);
    assert_eq!([number(&scene, "gap_1"), number(&scene, "gap_2")], [25.0, 20.0]);
    let there = with(&scene, &[("gap_1", 26.0), ("gap_2", 23.0)]).unwrap();
    let places = ["M.surface", "image", "L.front"].map(|name| frame(&there, name).origin.z);
    assert_eq!(places, [31.0, 8.0, 1.0]);
}

/// A group of what gaps move needs no list; nor do elements before the first gap, and members of a group that has one.
#[test]
fn an_element_without_a_gap_is_a_group_or_stands_before() {
    let change = |changes: &[(&str, Value)]| {
        let mut scene = plates();
        for (pointer, value) in changes {
            *scene.pointer_mut(pointer).unwrap() = value.clone();
        }
        with(&scene, &[("gap_1", 30.0)])
    };
    // The group holds a stop, which a gap moves, too.
    assert!(change(&[("/nsq_gpu/elements/3/parts/0", json!("stop"))]).is_ok());
    assert!(change(&[("/nsq_gpu/elements/0/behind", json!(null))]).is_ok());
    let members =
        [("/nsq_gpu/elements/0/faces", json!(["A", "B", "C"])), ("/nsq_gpu/elements/1/behind", json!(null))];
    assert!(change(&members).is_ok());
}

/// Copies of a frame are one, and have one number.
#[test]
fn a_frame_moves_by_its_name() {
    let mut scene = plates();
    assert_eq!(number(&scene, "barrel.ry"), 0.3);
    let there = with(&scene, &[("barrel.ry", 0.5), ("barrel.y", 1.0)]).unwrap();
    for name in ["D", "E"] {
        let outer = &mut entry(&mut scene, name)["cs"]["reference_cs"];
        outer["ry"] = json!(0.5);
        outer["y"] = json!(1.0);
    }
    assert_eq!(Ok(there), with(&scene, &[]));
}

#[test]
fn a_wrong_name_is_answered_with_what_would_be_right() {
    let scene = plates();
    for (name, said) in [
        ("L4.y", "did you mean `L1`?"),
        ("barel.y", "did you mean `barrel`?"),
        (
            "L1.radius",
            "`L1` is an element and has no number `radius`; known here: `x`, `y`, `z`, `rx`, `ry`, `rz`; its faces, which have numbers of their own, are `A`, `B`",
        ),
        ("L1.xx", "did you mean `x`?"),
        ("barrel.radius", "`barrel` is a frame and has no number `radius`; known here: `x`"),
        ("gap_4", "there is no such gap; the scene has gap_1 to gap_3"),
        ("gap_0", "gap_1 to gap_3"),
        ("gap_", "gap_1 to gap_3"),
        ("gap3", "names no number"),
    ] {
        let numbers = Scene::numbers(&scene.to_string(), &[name.to_owned()]);
        let set = with(&scene, &[(name, 1.0)]);
        for problem in [numbers.unwrap_err().to_string(), set.unwrap_err()] {
            assert!(problem.contains(said), "{name}: {problem}");
        }
    }
    let twice = with(&scene, &[("L1.y", 1.0), ("\"L1\".y", 2.0)]).unwrap_err();
    assert!(twice.contains("is set twice"), "{twice}");
    assert!(with(&scene, &[("L1.y", f64::NAN)]).unwrap_err().contains("finite"));
    let mut bare = scene.clone();
    bare["nsq_gpu"]["elements"] = json!([]);
    let problem = with(&bare, &[("gap_1", 1.0)]).unwrap_err();
    assert!(problem.contains("no element of the scene says what is `behind` it"), "{problem}");
    let mut none = scene.clone();
    none["nsq_gpu"]["elements"][2]["behind"] = json!([]);
    assert!(with(&none, &[("gap_3", 1.0)]).unwrap_err().contains("nothing is behind the element \"L3\""));
}

#[test]
fn a_list_that_makes_no_sense_is_refused_with_its_place() {
    for (pointer, value, said) in [
        (
            "/nsq_gpu/elements/0/faces/1",
            json!("BB"),
            "nsq_gpu.elements[0].faces[1]: nothing in the scene is called",
        ),
        ("/nsq_gpu/elements/0/behind/0", json!("stp"), "nsq_gpu.elements[0].behind[0]"),
        ("/nsq_gpu/elements/3/parts/0", json!("d"), "nsq_gpu.elements[3].parts[0]"),
        ("/nsq_gpu/elements/1/name", json!("L1"), "nsq_gpu.elements[1].name: the name \"L1\" is taken"),
        ("/nsq_gpu/elements/1/faces", json!([]), "nsq_gpu.elements[1].faces: the list is empty"),
        (
            "/nsq_gpu/elements/1/behind",
            json!(null),
            "nsq_gpu.elements[1].behind: the element \"L2\" has no such list, so no gap moves \"C\"",
        ),
        ("/nsq_gpu/elements/3/pivot", json!([1, 2]), "nsq_gpu.elements[3].pivot"),
        ("/nsq_gpu/elements/3/pivot/0", json!(1e300), "nsq_gpu.elements[3].pivot[0]"),
        ("/nsq_gpu/elements/1/faces", json!(7), "nsq_gpu.elements[1].faces"),
        ("/nsq_gpu/surfaces/4/cs/reference_cs/x", json!(4), "frames of this name differ"),
        ("/nsq_gpu/elements/0/name", json!("barrel"), "a frame has the name of something else"),
    ] {
        let mut scene = plates();
        *scene.pointer_mut(pointer).unwrap() = value;
        for numbers in [&[][..], &[("L2.z", 9.5)]] {
            let problem = with(&scene, numbers).unwrap_err();
            assert!(problem.contains(said) || !numbers.is_empty(), "{pointer}: {problem}");
        }
    }
}

/// Sweeps, tolerances and differences take names of elements, and units.
#[test]
fn the_command_takes_elements_with_units() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("plates.json");
    std::fs::write(&path, plates().to_string()).unwrap();
    let path = path.to_str().unwrap();
    let json = |arguments: &[&str]| -> Value {
        let output =
            command::run(&[&arguments[..1], &[path], &arguments[1..], &["-n", "1000", "--json"]].concat());
        assert!(output.status.success(), "{arguments:?}: {}", command::stderr(&output));
        serde_json::from_slice(&output.stdout).unwrap()
    };
    let found = json(&["sweep", "--set", "L1.rx=0.1deg,2mrad", "--set", "gap_3=21mm"]);
    let set = |number: usize, name: &str| found["points"][number]["set"][name].as_f64().unwrap();
    assert_eq!([set(0, "L1.rx"), set(1, "L1.rx"), set(1, "gap_3")], [0.1_f64.to_radians(), 2e-3, 21.0]);
    let tolerances = "L1.y=50um,L1.rx=0.1deg,gap_3=0.02,barrel.z=1%";
    let found = json(&["sweep", "--tolerance", tolerances, "--samples", "2", "--distribution", "uniform"]);
    let nominal = &found["nominal"]["set"];
    let gap = number(&plates(), "gap_3");
    assert_eq!(*nominal, json!({"L1.y": 0.0, "L1.rx": 0.2, "gap_3": gap, "barrel.z": 20.0}));
    let drawn =
        |name: &str| found["points"][1]["set"][name].as_f64().unwrap() - nominal[name].as_f64().unwrap();
    for (name, size) in [("L1.y", 0.05), ("L1.rx", 0.1_f64.to_radians()), ("gap_3", 0.02)] {
        assert!(drawn(name) != 0.0 && drawn(name).abs() <= size, "{name}: {}", drawn(name));
    }
    let found = json(&["sweep", "--set", "L1.y=-50:50um:3"]);
    let raised = |number: usize| found["points"][number]["set"]["L1.y"].as_f64().unwrap();
    assert_eq!([raised(0), raised(1), raised(2)], [-0.05, 0.0, 0.05]);
    assert!(json(&["diff", "--set", "gap_3=2.1cm"])["detectors"]["image"].is_object());
    for (arguments, said) in [
        (["sweep", path, "--set", "L1.rx=1mm"], "has no unit `mm`"),
        (["sweep", path, "--set", "L1.y=-50um:50:3"], "`-50um` has a unit, and the last number has none"),
        (["sweep", path, "--set", "L1.y=1:2:3um"], "`3um` is no number"),
        (["sweep", path, "--tolerance", "L1.y=1deg"], "has no unit `deg`"),
        (["sweep", path, "--tolerance", "L1.y=1mm%"], "`1mm` is no number"),
        (["sweep", path, "--tolerance", "barrel.y=1%"], "`barrel.y` is 0, and no share of 0 is a tolerance"),
        (["sweep", path, "--tolerance", "L9.y=1"], "did you mean `L1`?"),
        (["diff", path, "--set", "gap_9=1"], "the scene has gap_1 to gap_3"),
    ] {
        let output = command::run(&arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(command::stderr(&output).contains(said), "{arguments:?}: {}", command::stderr(&output));
    }
}
