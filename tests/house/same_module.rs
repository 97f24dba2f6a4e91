//! A change of the code that is to change no shader changes none: for every scene and tier, and for each way in which a scene
//! can be traced, the composed module is the committed one, but for names and the order of declarations (`eraser.rs` has the
//! rules).
//!
//! No adapter is needed. `NSQ_GPU_UPDATE_MODULES=1 cargo test --test same_module` writes tests/data/modules.json anew, which a
//! commit does whose purpose is another shader. To see what differs, let both versions of the code write their erased modules,
//! and compare the folders: `NSQ_GPU_WRITE_MODULES=FOLDER cargo test --test same_module`.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "clippy's exemption of tests does not reach their helpers"
)]

mod eraser;
#[path = "../zoo/files.rs"]
mod files;
mod forms;
mod planted;

use eraser::Erased;
use files::{json_files, repository};
use forms::Form;
use nsq_gpu::Scene;
use nsq_gpu::model::SceneIr;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::PathBuf;

const UPDATE: &str = "NSQ_GPU_UPDATE_MODULES";
const WRITE: &str = "NSQ_GPU_WRITE_MODULES";

/// The hashes by scene and form.
type Modules = BTreeMap<String, BTreeMap<String, String>>;

fn scene(name: &str) -> SceneIr {
    Scene::from_path(&repository("scenes").join(name).with_extension("json")).unwrap().lower().unwrap()
}

/// The hash of a module, or why there is none.
fn hash(scene: &str, ir: &SceneIr, form: &Form) -> String {
    let program = match form.program(ir) {
        Ok(program) => program,
        Err(error) => return format!("refused: {error}"),
    };
    let erased = match form.is_rewritten() {
        true => Erased::of(&naga::front::wgsl::parse_str(&program.wgsl).unwrap()),
        false => Erased::of(&program.module),
    };
    if let Some(folder) = std::env::var_os(WRITE) {
        let lines: String =
            erased.lines.iter().map(|line| format!("{}    // {}\n", line.text, line.origin)).collect();
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(PathBuf::from(folder).join(format!("{scene}, {}.txt", form.name())), lines).unwrap();
    }
    erased.hash()
}

#[test]
fn every_scene_and_tier_has_the_committed_module() {
    let file = repository("tests/data/modules.json");
    let modules_of = |name: String| {
        let ir = scene(&name);
        let hashes = Form::all().into_iter().map(|form| (form.name(), hash(&name, &ir, &form))).collect();
        (name, hashes)
    };
    let found: Modules = json_files("scenes").into_par_iter().map(modules_of).collect();
    if std::env::var_os(UPDATE).is_some() {
        std::fs::write(&file, serde_json::to_string_pretty(&found).unwrap() + "\n").unwrap();
    }
    let committed: Modules = std::fs::read_to_string(&file)
        .map_or_else(|_| Modules::new(), |text| serde_json::from_str(&text).unwrap());
    let names = |modules: &Modules| -> Vec<String> {
        let of_scene = |(scene, forms): (&String, &BTreeMap<String, String>)| {
            forms.iter().map(|(form, hash)| format!("{scene}, {form}: {hash}")).collect::<Vec<_>>()
        };
        modules.iter().flat_map(of_scene).collect()
    };
    let (found, committed) = (names(&found), names(&committed));
    let differ: Vec<&String> = found.iter().filter(|module| !committed.contains(module)).collect();
    assert!(
        differ.is_empty() && committed.len() == found.len(),
        "{} of {} modules are not the committed ones, such as {:#?}\nif that is the purpose of the change: {UPDATE}=1 cargo test --test same_module",
        differ.len(),
        found.len(),
        &differ[..differ.len().min(8)],
    );
}

/// Composed texts of two folders, as `nsq-gpu shader` prints them: tests/house/same_shaders.py compares two programs so.
#[test]
#[ignore = "wants two folders: tests/house/same_shaders.py"]
fn two_folders_of_shaders_hold_the_same_modules() {
    let folder =
        |name: &str| PathBuf::from(std::env::var_os(name).unwrap_or_else(|| panic!("{name} is not set")));
    let (before, after) = (folder("NSQ_GPU_SHADERS_BEFORE"), folder("NSQ_GPU_SHADERS_AFTER"));
    let mut names: Vec<_> =
        std::fs::read_dir(&before).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    names.sort();
    let mut differ = Vec::new();
    for name in names {
        let [old, new] = [&before, &after].map(|folder| std::fs::read_to_string(folder.join(&name)).unwrap());
        let verdict = if old == new {
            "same to the letter".to_string()
        } else {
            let [old, new] = [old, new].map(|text| Erased::of(&naga::front::wgsl::parse_str(&text).unwrap()));
            old.first_difference(&new).map_or("same module".to_string(), |difference| {
                differ.push(name.clone());
                format!("DIFFERS\n{difference}")
            })
        };
        eprintln!("{}: {verdict}", name.to_string_lossy());
    }
    assert!(differ.is_empty(), "{} modules differ", differ.len());
}
