//! Composed scenes as committed text, in which the files of shaders/ stand as their names alone: what is left is what
//! the composition itself wrote.
//!
//! To accept a change: `NSQ_GPU_UPDATE_SNAPSHOTS=1 cargo test --test portability`

use crate::variants::Tier;
use crate::{root, scene_variant};
use std::path::Path;

const UPDATE: &str = "NSQ_GPU_UPDATE_SNAPSHOTS";

/// Every file of shaders/ by its path there, and its text; the longest first.
pub fn shader_files() -> Vec<(String, String)> {
    let shaders = root().join("shaders");
    let mut files = Vec::new();
    collect(&shaders, &shaders, &mut files);
    files.sort_by_key(|(path, text)| (std::cmp::Reverse(text.len()), path.clone()));
    files
}

fn collect(folder: &Path, shaders: &Path, files: &mut Vec<(String, String)>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            collect(&path, shaders, files);
        } else {
            let name = path.strip_prefix(shaders).unwrap().to_string_lossy().replace('\\', "/");
            files.push((name, std::fs::read_to_string(&path).unwrap()));
        }
    }
}

fn abridged(wgsl: &str) -> String {
    let abridge = |text: String, (path, file): (String, String)| {
        let named = format!("// ==== shaders/{path}\n{file}\n");
        text.replace(&named, &format!("// <- shaders/{path}\n"))
    };
    shader_files().into_iter().fold(wgsl.to_string(), abridge)
}

/// The composition of a scene is the committed one.
pub fn compare(scene: &str, tier: Tier) {
    let integers = if tier.native { "native" } else { "portable" };
    let place = if tier.baked { "baked" } else { "table" };
    let name = format!("{scene}_{}_{integers}_{place}.wgsl", tier.precision.name());
    let path = root().join("tests/snapshots").join(&name);
    let composed = abridged(&scene_variant(scene).program(tier).wgsl);
    if std::env::var_os(UPDATE).is_some() {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, &composed).unwrap();
    }
    let reviewed = std::fs::read_to_string(&path).unwrap_or_default();
    if reviewed != composed {
        let line = reviewed.lines().zip(composed.lines()).take_while(|(old, new)| old == new).count();
        panic!(
            "tests/snapshots/{name} differs from line {}:\n  was {:?}\n  is  {:?}\nto accept: {UPDATE}=1 cargo test --test portability",
            line + 1,
            reviewed.lines().nth(line).unwrap_or_default(),
            composed.lines().nth(line).unwrap_or_default(),
        );
    }
}
