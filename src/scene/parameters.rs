//! The numbers of a scene by their names, such as `L1.r1`, `L2.z`, `L1.front.reflectance`, `lamp.total_flux`,
//! `screen.width` or `glass.n`.
//!
//! A name begins with the name of a component, a surface, a source, a detector or a medium. It ends with a key of this
//! entry, as the scene file has it; keys of objects within it follow each other: `mirror.reflectance.values.0`. Of a list follow
//! the places of the number, from 0 on: `asphere.coefficients.1`. Names with dots are quoted: `"a.b".r1`.
//!
//! Elements and gaps, such as `L4.rx` and `gap_3`, move several entries: [`crate::scene::elements`]. A frame that several entries
//! stand in, and that has a name, is one: its number is set in all of them.

use crate::error::{Error, Result};
use crate::model::key_path::{did_you_mean, nearest, quoted, suggested, ticked};
use crate::scene::elements::{Elements, Moved};
use crate::scene::json_tree::{Array, Value, View};
use crate::scene::named_entries::{FRAME, Step, at, at_mut, entries, frames, inner, key, parts};
use serde_json::Number;

/// The number of this name, where the file has it; a frame's default is 0. A flat face has an infinite radius.
///
/// # Errors
/// [`Error::Usage`] if the scene has no such number.
pub(super) fn get(tree: &Value, name: &str) -> Result<f64> {
    let elements = Elements::of(tree)?;
    let NumberKey { object, key, items } = match find(tree, &elements, name)? {
        Found::Moved(moved) => return elements.get(tree, moved),
        Found::Number(mut places) => places.swap_remove(0),
    };
    let found = at(tree, &object).and_then(|object| object.get(&key));
    if let (Some(list), false) = (found, items.is_empty()) {
        return item(list, &items).ok_or_else(|| no_item(name));
    }
    match found {
        Some(Value::Number(number)) if number.as_f64().is_some() => Ok(number.as_f64().unwrap_or_default()),
        Some(Value::String(text)) if is_infinite(text) => Ok(f64::INFINITY),
        Some(_) => Err(no_single_number(name)),
        None if FRAME.contains(&key.as_str()) => Ok(0.0),
        None => {
            Err(Error::Usage(format!("the scene does not give {}; write it into the file", ticked(name))))
        }
    }
}

/// Sets numbers by their names.
///
/// # Errors
/// [`Error::Usage`] if nothing has a name, the scene has something else than a number there, or two names are of one
/// number.
pub(super) fn set_all(tree: &mut Value, numbers: &[(String, f64)]) -> Result<()> {
    if numbers.is_empty() {
        return Ok(());
    }
    let elements = Elements::of(tree)?;
    let mut places: Vec<(NumberKey, &String, Number)> = Vec::new();
    let mut moves: Vec<(Moved, f64)> = Vec::new();
    for (name, value) in numbers {
        let Some(number) = Number::from_f64(*value) else {
            return Err(Error::Usage(format!("{} is {value}; give a finite number", ticked(name))));
        };
        let is_known = match find(tree, &elements, name)? {
            Found::Number(of_name) => {
                let is_known = places.iter().any(|(place, ..)| of_name.contains(place));
                places.extend(of_name.into_iter().map(|place| (place, name, number.clone())));
                is_known
            }
            Found::Moved(moved) => {
                let is_known = moves.iter().any(|(known, _)| *known == moved);
                moves.push((moved, *value));
                is_known
            }
        };
        if is_known {
            return Err(Error::Usage(format!("{} is set twice; set it once", ticked(name))));
        }
    }
    // Elements move by how far their numbers are from the file's, whatever else is set.
    let motions = elements.motions(tree, &moves)?;
    for (place, name, number) in &places {
        set(tree, place, name, number)?;
    }
    elements.carry_out(tree, &motions)
}

/// Sets the number at this place. A key that its entry does not know is refused later, when the scene is read.
fn set(tree: &mut Value, place: &NumberKey, name: &str, number: &Number) -> Result<()> {
    let NumberKey { object, key, items } = place;
    let Some(object) = at_mut(tree, object) else { return Err(no_single_number(name)) };
    if let (Some(list), false) = (object.get_mut(key), items.is_empty()) {
        return set_item(list, items, number).ok_or_else(|| no_item(name));
    }
    match object.get(key) {
        None | Some(Value::Number(_) | Value::Null) => {}
        Some(Value::String(text)) if is_infinite(text) => {}
        Some(_) => return Err(no_single_number(name)),
    }
    object.insert(key.clone(), Value::Number(number.clone()));
    Ok(())
}

/// True of a radius that is the text "Infinity".
fn is_infinite(text: &str) -> bool {
    text.trim_start_matches('-') == "Infinity"
}

fn no_single_number(name: &str) -> Error {
    Error::Usage(format!("{} is no single number in the scene", ticked(name)))
}

fn no_item(name: &str) -> Error {
    Error::Usage(format!(
        "{} is no number of a list in the scene; places count from 0, as in `asphere.coefficients.1`",
        ticked(name)
    ))
}

/// The number at these places of lists within lists.
fn item(value: &Value, places: &[usize]) -> Option<f64> {
    match (value, places) {
        (Value::Number(number), []) => number.as_f64(),
        (Value::Array(array), [first, rest @ ..]) => match (array.get(*first)?, rest) {
            (View::Number(number), []) => Some(number),
            (View::Row(row), [place]) => row.get(*place).copied(),
            (View::Value(value), rest) => item(value, rest),
            _ => None,
        },
        _ => None,
    }
}

/// Sets that number; none if there is none.
fn set_item(value: &mut Value, places: &[usize], to: &Number) -> Option<()> {
    match (value, places) {
        (Value::Number(number), []) => *number = to.clone(),
        (Value::Array(Array::Numbers(numbers)), [place]) => *numbers.get_mut(*place)? = to.as_f64()?,
        (Value::Array(Array::Rows { length, numbers }), [row, place]) if *place < *length => {
            *numbers.get_mut(row.checked_mul(*length)?.checked_add(*place)?)? = to.as_f64()?;
        }
        (Value::Array(Array::Values(values)), [first, rest @ ..]) => {
            return set_item(values.get_mut(*first)?, rest, to);
        }
        _ => return None,
    }
    Some(())
}

/// What a name stands for.
enum Found {
    /// A number, in as many places as there are copies of its frame.
    Number(Vec<NumberKey>),
    /// A number that moves several entries.
    Moved(Moved),
}

/// Where a number stands: the way to its object, and its key there.
#[derive(PartialEq)]
struct NumberKey {
    object: Vec<Step>,
    key: String,
    /// Places in lists within lists, where the key has a list.
    items: Vec<usize>,
}

fn find(tree: &Value, elements: &Elements, name: &str) -> Result<Found> {
    let mut parts = parts(name)?;
    if let Some(moved) = elements.find(&parts)? {
        return Ok(Found::Moved(moved));
    }
    let mut items = Vec::new();
    while let Some(place) = parts.last().filter(|_| parts.len() > 2).and_then(|last| last.parse().ok()) {
        items.insert(0, place);
        parts.pop();
    }
    let Some((last, entry)) = parts.split_last().filter(|(_, entry)| !entry.is_empty()) else {
        return Err(Error::Usage(format!("{} names no number; write it as in `L1.r1`", ticked(name))));
    };
    let entries = entries(tree);
    // Names of entries may have dots, and keys may lie within objects: the longest name of an entry counts.
    for num_keys in 1..parts.len() {
        let (label, keys) = parts.split_at(parts.len() - num_keys);
        let label = label.join(".");
        let ways: Vec<&[Step]> =
            entries.iter().filter(|(known, _)| *known == label).map(|(_, way)| way.as_slice()).collect();
        let object = |way: &&[Step]| -> Vec<Step> {
            let inner = inner(tree, way, &keys[0]);
            inner.into_iter().chain(keys[..num_keys - 1].iter().map(|name| key(name))).collect()
        };
        let mut objects: Vec<Vec<Step>> = ways.iter().map(object).collect();
        // The key distinguishes entries of one name. Every frame has all of its keys, and a configuration could have one.
        let ends_in = |object: &Vec<Step>, end: &str| object.last() == Some(&key(end));
        let has = |object: &Vec<Step>| {
            FRAME.contains(&last.as_str()) && ends_in(object, "cs")
                || at(tree, object).is_some_and(|object| object.contains_key(last))
        };
        if objects.iter().any(has) {
            objects.retain(has);
        } else if objects.iter().any(|object| ends_in(object, "config")) {
            objects.retain(|object| ends_in(object, "config"));
        }
        if objects.len() > 1 {
            return Err(Error::Usage(format!(
                "{}: several entries are called {}; rename one",
                ticked(name),
                quoted(&label)
            )));
        }
        let Some(object) = objects.pop().filter(|object| num_keys == 1 || at(tree, object).is_some()) else {
            continue;
        };
        return Ok(Found::Number(vec![NumberKey { object, key: last.clone(), items }]));
    }
    let label = entry.join(".");
    let frames = frames(tree);
    let copies = frames.iter().filter(|(known, _)| *known == label);
    let places: Vec<NumberKey> = copies
        .map(|(_, way)| NumberKey { object: way.clone(), key: last.clone(), items: items.clone() })
        .collect();
    let faces: Vec<String> = elements.faces_of(&label).map(ticked).collect();
    let is_known = !faces.is_empty() || !places.is_empty();
    if is_known && !FRAME.contains(&last.as_str()) {
        let advice = did_you_mean(last, FRAME);
        let (kind, of_faces) = match faces.is_empty() {
            true => ("a frame", String::new()),
            false => (
                "an element",
                format!("; its faces, which have numbers of their own, are {}", faces.join(", ")),
            ),
        };
        return Err(Error::Usage(format!(
            "{}: {} is {kind} and has no number {}; {advice}{of_faces}",
            ticked(name),
            ticked(&label),
            ticked(last)
        )));
    }
    if !places.is_empty() {
        return Ok(Found::Number(places));
    }
    let frames = frames.iter().map(|(name, _)| name.as_str());
    let known = entries.iter().map(|(name, _)| name.as_str()).chain(elements.names()).chain(frames);
    let known: Vec<&str> = known.collect();
    let faces: Vec<&str> = elements.names().flat_map(|name| elements.faces_of(name)).collect();
    // The entry may lack what the name asks for, or be misspelt before that.
    for end in (1..=entry.len()).rev() {
        let part = entry[..end].join(".");
        if end < entry.len() && (known.contains(&part.as_str()) || faces.contains(&part.as_str())) {
            return Err(Error::Usage(format!(
                "{}: {} has no {} in the scene file, and only numbers that stand there can be changed; the faces of a lens are \
                 written in `overrides` of `nsq_gpu`",
                ticked(name),
                ticked(&part),
                ticked(&entry[end])
            )));
        }
        if let Some(near) = nearest(&part, known.iter().chain(&faces).copied()) {
            return Err(nothing_called(name, &label, &suggested(near)));
        }
    }
    Err(nothing_called(name, &label, &did_you_mean(&label, known)))
}

/// The error of a name that stands for nothing.
fn nothing_called(name: &str, label: &str, advice: &str) -> Error {
    Error::Usage(format!("{}: nothing in the scene is called {}; {advice}", ticked(name), quoted(label)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::json_text;

    fn scene() -> Value {
        json_text::parse(
            r#"{"nsq_schema_version": 1,
                "components": [{"type": "lens", "name": "L1", "cs": {"z": 3.0}, "config": {"r1": 50.0, "material": "N-BK7"}}],
                "sources": [{"name": "lamp", "cs": {}, "total_flux": 1.0}, {"name": "beam", "cs": {}}],
                "detectors": [{"name": "beam", "cs": {"z": 1.0}}, {"name": "a.b", "cs": {}, "width": 4.0}],
                "nsq_gpu": {"media": {"glass": {"type": "constant", "n": 1.5}, "L1": {"n": 1.7}, "table": {"n": [1.5, 1.6]}},
                            "surfaces": [{"name": "A", "reflectance": {"values": [0.8, 0.9]}, "shape": {"coefficients": [0.0, 2e-6], "table": [[1.0, 2.0], [3.0, 4.0]]}}],
                            "overrides": {"L1.front": {"reflectance": 0.1}}}}"#,
        )
        .unwrap()
    }

    fn set(tree: &mut Value, name: &str, value: f64) -> Result<()> {
        set_all(tree, &[(name.into(), value)])
    }

    #[test]
    fn numbers_are_found_by_their_names() {
        let mut tree = scene();
        for (name, before) in [
            ("L1.r1", 50.0),
            ("L1.z", 3.0),
            ("L1.rx", 0.0),
            ("L1.n", 1.7),
            ("lamp.total_flux", 1.0),
            ("\"a.b\".width", 4.0),
            ("glass.n", 1.5),
            ("L1.front.reflectance", 0.1),
            ("A.coefficients.1", 2e-6),
            ("A.table.1.0", 3.0),
            ("A.reflectance.values.1", 0.9),
            ("A.shape.table.0.1", 2.0),
        ] {
            assert_eq!(get(&tree, name), Ok(before), "{name}");
            set(&mut tree, name, before + 1.0).unwrap();
            assert_eq!(get(&tree, name), Ok(before + 1.0), "{name}");
        }
        set(&mut tree, "L1.conic1", -1.0).unwrap();
        assert_eq!(get(&tree, "L1.conic1"), Ok(-1.0));
    }

    #[test]
    fn a_name_of_nothing_is_refused_with_the_nearest() {
        let mut tree = scene();
        for (name, said) in [
            ("L2.r1", "did you mean"),
            ("r1", "names no number"),
            ("L1..r1", "no name of a number"),
            ("\"a.b.width", "no name of a number"),
            ("L1.material", "no single number"),
            ("beam.z", "several entries"),
            ("table.n", "no single number"),
            ("L1.conic2", "does not give"),
            ("A.coefficients.2", "no number of a list"),
            ("A.reflectance.value", "does not give"),
            ("A.coating.reflectance", "`A` has no `coating`"),
            ("AA.reflectance.value", "nothing in the scene"),
            ("lamb.cs.x", "did you mean `lamp`?"),
            ("A.table.1", "no number of a list"),
            ("L1.r1.0", "no number of a list"),
        ] {
            let found = if said == "does not give" {
                get(&tree, name).map(|_| ())
            } else {
                set(&mut tree, name, 1.0)
            };
            let error = found.unwrap_err().to_string();
            assert!(error.contains(said), "{name}: {error}");
        }
        assert!(set(&mut tree, "L1.r1", f64::NAN).is_err());
    }
}
