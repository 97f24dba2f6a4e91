//! The entries of a scene file that have a name, and the ways to them in the file's tree.

use crate::error::{Error, Result};
use crate::model::key_path::ticked;
use crate::scene::json::{CoordinateSystem, SceneFile};
use crate::scene::json_tree::{Array, Value};
use indexmap::IndexMap;

/// The keys of a frame: positions and angles.
pub(super) const FRAME: [&str; 6] = ["x", "y", "z", "rx", "ry", "rz"];

/// What the name of a gap begins with.
pub(super) const GAP: &str = "gap_";

/// True of the end of a name that moves something: mm and rad.
pub(crate) fn moves(key: &str) -> bool {
    FRAME.contains(&key) || key.starts_with(GAP)
}

/// The last key of a name. Places in lists end a name: `asphere.coefficients.1`.
pub(crate) fn last_key(name: &str) -> &str {
    name.rsplit('.').find(|part| part.parse::<usize>().is_err()).unwrap_or_default()
}

/// The lists of a scene whose entries have a name of their own.
const LISTS: [&str; 3] = ["components", "sources", "detectors"];

pub(super) type Object = IndexMap<String, Value>;

/// A step into a tree.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Step {
    Key(String),
    Item(usize),
}

pub(super) fn key(name: &str) -> Step {
    Step::Key(name.into())
}

/// The value at the end of a way.
pub(super) fn value_at<'t>(tree: &'t Value, way: &[Step]) -> Option<&'t Value> {
    way.iter().try_fold(tree, |value, step| match (step, value) {
        (Step::Key(key), Value::Object(object)) => object.get(key),
        (Step::Item(item), Value::Array(Array::Values(values))) => values.get(*item),
        _ => None,
    })
}

/// The object at the end of a way.
pub(super) fn at<'t>(tree: &'t Value, way: &[Step]) -> Option<&'t Object> {
    value_at(tree, way)?.object()
}

pub(super) fn at_mut<'t>(tree: &'t mut Value, way: &[Step]) -> Option<&'t mut Object> {
    let end = way.iter().try_fold(tree, |value, step| match (step, value) {
        (Step::Key(key), Value::Object(object)) => object.get_mut(key),
        (Step::Item(item), Value::Array(Array::Values(values))) => values.get_mut(*item),
        _ => None,
    })?;
    match end {
        Value::Object(object) => Some(object.as_mut()),
        _ => None,
    }
}

/// All entries that have a name: the name, and the way to the entry.
pub(super) fn entries(tree: &Value) -> Vec<(String, Vec<Step>)> {
    let block = || vec![key("nsq_gpu")];
    let mut entries = Vec::new();
    let lists = LISTS.iter().map(|list| vec![key(list)]).chain([[block(), vec![key("surfaces")]].concat()]);
    for list in lists {
        let (last, parent) = list.split_last().map_or((None, &[][..]), |(last, parent)| (Some(last), parent));
        let Some(Step::Key(last)) = last else { continue };
        let Some(Value::Array(Array::Values(values))) = at(tree, parent).and_then(|object| object.get(last))
        else {
            continue;
        };
        for (i, value) in values.iter().enumerate() {
            if let Some(Value::String(name)) = value.object().and_then(|object| object.get("name")) {
                entries.push((name.to_string(), [&list[..], &[Step::Item(i)]].concat()));
            }
        }
    }
    for table in ["media", "overrides"] {
        let table = [block(), vec![key(table)]].concat();
        let names = at(tree, &table).into_iter().flat_map(|object| object.keys());
        entries.extend(names.map(|name| (name.clone(), [&table[..], &[key(name)]].concat())));
    }
    entries
}

/// All frames that have a name: the name, and the way to a copy of the frame.
pub(super) fn frames(tree: &Value) -> Vec<(String, Vec<Step>)> {
    let mut frames = Vec::new();
    for (_, entry) in entries(tree) {
        let mut way = [&entry[..], &[key("cs")]].concat();
        while let Some(object) = at(tree, &way) {
            if let Some(Value::String(name)) = object.get("name") {
                frames.push((name.to_string(), way.clone()));
            }
            way.push(key("reference_cs"));
        }
    }
    frames
}

/// The name and the frame of everything that has a place.
pub(super) fn placed(file: &SceneFile) -> impl Iterator<Item = (&str, &CoordinateSystem)> {
    let components = file.components.iter().map(|component| (component.name(), component.cs()));
    let surfaces = file.nsq_gpu.iter().flat_map(|block| &block.surfaces);
    let surfaces = surfaces.map(|surface| (surface.name.as_str(), &surface.cs));
    let sources = file.sources.iter().map(|source| (source.name(), source.cs()));
    let detectors = file.detectors.iter().map(|detector| (detector.name(), detector.cs()));
    components.chain(surfaces).chain(sources).chain(detectors)
}

/// The parts of a name, between dots that are not quoted.
pub(super) fn parts(name: &str) -> Result<Vec<String>> {
    let mut parts = vec![String::new()];
    let mut in_quotes = false;
    for letter in name.chars() {
        match letter {
            '"' => in_quotes = !in_quotes,
            '.' if !in_quotes => parts.push(String::new()),
            letter => parts.last_mut().into_iter().for_each(|part| part.push(letter)),
        }
    }
    if in_quotes || parts.iter().any(String::is_empty) {
        return Err(Error::Usage(format!("{} is no name of a number; write it as in `L1.r1`", ticked(name))));
    }
    Ok(parts)
}

/// The way to the object of an entry that has a key: the entry's frame, its configuration, its shape, or the entry.
pub(super) fn inner(tree: &Value, entry: &[Step], wanted: &str) -> Vec<Step> {
    let within = |name: &str| [entry, &[key(name)]].concat();
    let has = |way: &[Step]| at(tree, way).is_some_and(|object| object.contains_key(wanted));
    if FRAME.contains(&wanted) && at(tree, &within("cs")).is_some() {
        return within("cs");
    }
    if let Some(way) =
        ["config", "shape", "interaction", "bsdf", "coating"].map(within).into_iter().find(|way| has(way))
    {
        return way;
    }
    // What no object has yet belongs to a component's configuration.
    if !has(entry) && at(tree, &within("config")).is_some() { within("config") } else { entry.to_vec() }
}
