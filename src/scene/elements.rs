//! Elements: what moves as one. `L4.y` decentres all faces of L4 with its edge and its mount, and `gap_3` moves whatever
//! stands behind the third element.
//!
//! A block `nsq_gpu` lists elements. An element has the frame of its first face, at the pivot if one is
//! stated. A number of it is set by moving all of its entries rigidly: from the file's frame to the frame with that number.
//! A name that moves no angle adds to positions, which keeps every digit of a frame that is not moved. A turned entry
//! stands in the element's new frame (`reference_cs`), as people would write it.

use crate::error::{Error, Result};
use crate::model::checks::{position, refuse};
use crate::model::key_path::{did_you_mean, key_of, quoted, ticked};
use crate::scene::de;
use crate::scene::frame::{frame_of, moved, shifted};
use crate::scene::json::{Component, CoordinateSystem, Element, SceneFile};
use crate::scene::json_tree::Value;
use crate::scene::named_entries::{FRAME, GAP, Step, at, at_mut, entries, key, placed, value_at};
use glam::{DVec3, EulerRot};
use serde::Deserialize;
use serde_json::Number;
use std::collections::{HashMap, HashSet};

/// The elements of a scene.
pub(super) struct Elements(Vec<Element>);

/// What a name moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Moved {
    /// An element, by its place in the list and the place of the number in [`FRAME`].
    Element(usize, usize),
    /// All behind an element, by its place among those that say what is behind them.
    Gap(usize),
}

/// How entries move.
pub(super) struct Motions {
    /// Elements, the numbers of their frames before, and after. Members come before the groups that hold them.
    elements: Vec<(usize, [f64; 6], [f64; 6])>,
    /// Gaps, and how far all behind them moves \[mm\].
    gaps: Vec<(usize, DVec3)>,
}

/// The space behind an element.
struct Gap {
    /// \[mm\]
    size: f64,
    /// From the element to what is next.
    direction: DVec3,
}

impl Elements {
    pub(super) fn of(tree: &Value) -> Result<Self> {
        typed_at(tree, &[key("nsq_gpu"), key("elements")]).map(Elements)
    }

    pub(super) fn names(&self) -> impl Iterator<Item = &str> + Clone {
        self.0.iter().map(|element| element.name.as_str())
    }

    /// The element, or the gap, of a name's parts.
    ///
    /// # Errors
    /// [`Error::Usage`] for a gap that the scene has not.
    pub(super) fn find(&self, parts: &[String]) -> Result<Option<Moved>> {
        match parts {
            [gap] if gap.starts_with(GAP) => self.gap_of(gap).map(Some),
            [label @ .., key] => {
                let label = label.join(".");
                let element = self.names().position(|name| name == label);
                let number = FRAME.iter().position(|known| known == key);
                Ok(element.zip(number).map(|(element, number)| Moved::Element(element, number)))
            }
            [] => Ok(None),
        }
    }

    fn gap_of(&self, name: &str) -> Result<Moved> {
        let number = name[GAP.len()..].parse::<usize>().ok().and_then(|number| number.checked_sub(1));
        let num_gaps = self.with_gaps().count();
        let advice = match num_gaps {
            0 => "no element of the scene says what is `behind` it; list elements in the block `nsq_gpu`"
                .into(),
            1 => format!("the scene has {GAP}1"),
            _ => format!("the scene has {GAP}1 to {GAP}{num_gaps}"),
        };
        match number.filter(|number| *number < num_gaps) {
            Some(number) => Ok(Moved::Gap(number)),
            None => Err(Error::Usage(format!("{}: there is no such gap; {advice}", ticked(name)))),
        }
    }

    /// The elements that say what is behind them, and what.
    fn with_gaps(&self) -> impl Iterator<Item = (&Element, &[String])> + Clone {
        self.0.iter().filter_map(|element| Some((element, element.behind.as_deref()?)))
    }

    /// The number that a name has in the scene.
    pub(super) fn get(&self, tree: &Value, moved: Moved) -> Result<f64> {
        match moved {
            Moved::Element(element, number) => Ok(numbers_of(&self.frame(tree, element)?)[number]),
            Moved::Gap(gap) => Ok(self.gap(tree, gap)?.size),
        }
    }

    /// What setting some numbers moves.
    ///
    /// # Errors
    /// [`Error::Scene`] if an element names what the scene has not.
    pub(super) fn motions(&self, tree: &Value, numbers: &[(Moved, f64)]) -> Result<Motions> {
        let mut motions = Motions { elements: Vec::new(), gaps: Vec::new() };
        for (moved, value) in numbers {
            match moved {
                Moved::Gap(number) => {
                    let gap = self.gap(tree, *number)?;
                    motions.gaps.push((*number, (value - gap.size) * gap.direction));
                }
                Moved::Element(number, key) => {
                    let known = motions.elements.iter().position(|(element, ..)| element == number);
                    let at = match known {
                        Some(at) => at,
                        None => {
                            let frame = numbers_of(&self.frame(tree, *number)?);
                            motions.elements.push((*number, frame, frame));
                            motions.elements.len() - 1
                        }
                    };
                    motions.elements[at].2[*key] = *value;
                }
            }
        }
        motions.elements.sort_by_key(|(element, ..)| self.0[*element].entries().count());
        Ok(motions)
    }

    /// Moves entries of a scene.
    pub(super) fn carry_out(&self, tree: &mut Value, motions: &Motions) -> Result<()> {
        // The outermost frame of each entry that stands where the file has it: an element may have put others within.
        let mut outermost: HashMap<&str, Vec<Step>> = HashMap::new();
        for (element, before, after) in &motions.elements {
            let element = &self.0[*element];
            let first = outer(tree, &mut outermost, &element.faces[0])?;
            let reference = at(tree, first).and_then(|frame| frame.get("reference_cs").cloned());
            // What the element stands in may have been set meanwhile.
            let [x, y, z, rx, ry, rz] = *before;
            let before = CoordinateSystem { x, y, z, rx, ry, rz, ..cs_at(tree, first)? };
            for name in element.entries() {
                let way = outer(tree, &mut outermost, name)?;
                move_by(tree, way, (&before, *after), reference.as_ref())?;
            }
        }
        let mut shifts: HashMap<&str, DVec3> = HashMap::new();
        for (gap, shift) in &motions.gaps {
            let later = self.with_gaps().skip(*gap);
            let elements = later.clone().skip(1).flat_map(|(element, _)| element.entries());
            let behind = later.flat_map(|(_, behind)| behind.iter().map(String::as_str));
            for name in elements.chain(behind).collect::<HashSet<&str>>() {
                *shifts.entry(name).or_default() += *shift;
            }
        }
        for (name, shift) in shifts {
            let way = outer(tree, &mut outermost, name)?;
            let frame = cs_at(tree, way)?;
            let reference = frame.reference_cs.as_deref().map(frame_of);
            let shift = reference.map_or(shift, |reference| reference.rotation.transpose() * shift);
            add(tree, way, &frame, shift);
        }
        Ok(())
    }

    /// The frame that an element's numbers are of, as the file has it.
    fn frame(&self, tree: &Value, number: usize) -> Result<CoordinateSystem> {
        let element = &self.0[number];
        let Some(first) = element.faces.first() else {
            return Err(Error::scene(
                quoted(&element.name),
                "the element has no face",
                "name one in `faces`",
            ));
        };
        let mut frame = cs_at(tree, &way_to(tree, first)?)?;
        if let Some(pivot) = element.pivot {
            let own = CoordinateSystem { reference_cs: None, ..frame.clone() };
            set_origin(&mut frame, moved(&frame_of(&own), DVec3::from(pivot)).origin);
        }
        Ok(frame)
    }

    fn gap(&self, tree: &Value, number: usize) -> Result<Gap> {
        let mut later = self.with_gaps().skip(number);
        let (element, behind) = later.next().ok_or_else(|| Error::Internal("a gap of no element".into()))?;
        let last = element.faces.last().map_or("", String::as_str);
        let next = later.next().and_then(|(next, _)| next.faces.first()).or(behind.first());
        let Some(next) = next else {
            return Err(Error::Usage(format!(
                "{}: nothing is behind the element {}; name it in the element's `behind`",
                ticked(&format!("{GAP}{}", number + 1)),
                quoted(&element.name)
            )));
        };
        let way = way_to(tree, last)?;
        let vertex = shifted(&frame_of(&cs_at(tree, &way)?), thickness(tree, &way)?);
        let next = frame_of(&cs_at(tree, &way_to(tree, next)?)?);
        let axis = vertex.rotation * DVec3::Z;
        let along = (next.origin - vertex.origin).dot(axis);
        // Behind a mirror, light runs along -z.
        Ok(Gap { size: along.abs(), direction: if along < 0.0 { -axis } else { axis } })
    }

    /// The faces of the element of this name.
    pub(super) fn faces_of(&self, label: &str) -> impl Iterator<Item = &str> {
        let is_this = self.0.iter().filter(move |element| element.name == label);
        is_this.flat_map(|element| element.faces.iter().map(String::as_str))
    }
}

impl Element {
    /// The names of all that moves with it.
    fn entries(&self) -> impl Iterator<Item = &str> {
        self.faces.iter().chain(&self.parts).map(String::as_str)
    }
}

/// Checks the names of elements and frames.
///
/// # Errors
/// [`Error::Scene`] with the place.
pub(super) fn check(file: &SceneFile) -> Result<()> {
    let elements = file.nsq_gpu.as_ref().map_or(&[][..], |block| &block.elements);
    let has_names =
        placed(file).any(|(_, cs)| chain(cs).any(|frame| frame.name.is_some())) || !elements.is_empty();
    if !has_names {
        return Ok(());
    }
    let known: Vec<&str> = placed(file).map(|(name, _)| name).collect();
    let entries: HashSet<&str> = known.iter().copied().collect();
    // What gaps move, and what stands before all gaps.
    let first_gap = elements.iter().position(|element| element.behind.is_some());
    let in_order = elements.iter().enumerate();
    let in_order = in_order.filter(|(i, element)| element.behind.is_some() || Some(*i) < first_gap);
    let in_order: HashSet<&str> = in_order
        .flat_map(|(_, element)| element.entries().chain(element.behind.iter().flatten().map(String::as_str)))
        .collect();
    let mut seen = HashSet::new();
    for (i, element) in elements.iter().enumerate() {
        let place = format!("nsq_gpu.elements[{i}]");
        if !seen.insert(element.name.as_str()) {
            let problem = format!("the name {} is taken", quoted(&element.name));
            return refuse(key_of(&place, "name"), problem, "give each its own name");
        }
        if element.faces.is_empty() {
            return refuse(key_of(&place, "faces"), "the list is empty", "name at least one face");
        }
        let behind = element.behind.as_deref().unwrap_or_default();
        for (list, names) in [("faces", &element.faces[..]), ("parts", &element.parts), ("behind", behind)] {
            if let Some(at) = names.iter().position(|name| !entries.contains(name.as_str())) {
                let problem = format!("nothing in the scene is called {}", quoted(&names[at]));
                let advice = did_you_mean(&names[at], known.iter().copied());
                return refuse(format!("{place}.{list}[{at}]"), problem, advice);
            }
        }
        if first_gap.is_some()
            && let Some(left) = element.entries().find(|name| !in_order.contains(name))
        {
            let (name, left) = (quoted(&element.name), quoted(left));
            let problem = format!("the element {name} has no such list, so no gap moves {left}");
            return refuse(
                key_of(&place, "behind"),
                problem,
                "name what stands behind it; [] if nothing does",
            );
        }
        for (at, number) in element.pivot.iter().flatten().enumerate() {
            position(format!("{place}.pivot[{at}]"), *number)?;
        }
    }
    let mut copies: HashMap<&str, &CoordinateSystem> = HashMap::new();
    for frame in placed(file).flat_map(|(_, cs)| chain(cs)) {
        let Some(name) = frame.name.as_deref() else { continue };
        if entries.contains(name) || seen.contains(name) {
            return refuse(quoted(name), "a frame has the name of something else", "give each its own name");
        }
        if copies.insert(name, frame).is_some_and(|copy| copy != frame) {
            return refuse(
                quoted(name),
                "frames of this name differ",
                "copies of one frame have the same numbers; give another frame another name",
            );
        }
    }
    Ok(())
}

/// A frame, the one that it stands in, and so on.
fn chain(cs: &CoordinateSystem) -> impl Iterator<Item = &CoordinateSystem> {
    std::iter::successors(Some(cs), |cs| cs.reference_cs.as_deref())
}

/// The way to the frame of an entry.
fn way_to(tree: &Value, name: &str) -> Result<Vec<Step>> {
    let of_name = entries(tree).into_iter().filter(|(known, _)| known == name);
    let mut ways: Vec<Vec<Step>> = of_name.map(|(_, way)| [&way[..], &[key("cs")]].concat()).collect();
    ways.retain(|way| at(tree, way).is_some());
    match ways.len() {
        1 => Ok(ways.swap_remove(0)),
        0 => Err(Error::scene(
            quoted(name),
            "an element holds it, and the scene has no such entry",
            "name another",
        )),
        _ => Err(Error::scene(
            quoted(name),
            "an element holds it, and several entries have the name",
            "rename one",
        )),
    }
}

/// The way to the outermost frame of an entry that is where the file has it.
fn outer<'n, 'w>(
    tree: &Value,
    known: &'w mut HashMap<&'n str, Vec<Step>>,
    name: &'n str,
) -> Result<&'w mut Vec<Step>> {
    if !known.contains_key(name) {
        known.insert(name, way_to(tree, name)?);
    }
    known.get_mut(name).ok_or_else(|| Error::Internal("a frame without a way".into()))
}

/// The frame at the end of a way.
fn cs_at(tree: &Value, way: &[Step]) -> Result<CoordinateSystem> {
    typed_at(tree, way)
}

/// What is at the end of a way; the default where nothing is.
fn typed_at<'t, T: Deserialize<'t> + Default>(tree: &'t Value, way: &[Step]) -> Result<T> {
    let Some(value) = value_at(tree, way) else { return Ok(T::default()) };
    de::typed(value).or_else(|error| {
        // The error of the whole file has the whole place.
        de::typed::<SceneFile>(tree)?;
        Err(error)
    })
}

/// How far behind its frame the last vertex of an entry is \[mm\].
fn thickness(tree: &Value, way: &[Step]) -> Result<f64> {
    let entry = &way[..way.len() - 1];
    if entry.first() != Some(&key("components")) {
        return Ok(0.0);
    }
    let Some(value) = value_at(tree, entry) else { return Ok(0.0) };
    Ok(match de::typed::<Component>(value)? {
        Component::Lens(lens) => lens.config.thickness,
        Component::Doublet(doublet) => doublet.config.thickness1 + doublet.config.thickness2,
        Component::Mirror(_) => 0.0,
    })
}

/// Moves the frame at the end of a way as an element moves: from a frame to other numbers, both within `reference`. The
/// way is led on to the frame that the moved one has come to stand in.
fn move_by(
    tree: &mut Value,
    way: &mut Vec<Step>,
    (before, new): (&CoordinateSystem, [f64; 6]),
    reference: Option<&Value>,
) -> Result<()> {
    let frame = cs_at(tree, way)?;
    let old = numbers_of(before);
    let is_within = frame.reference_cs == before.reference_cs;
    if is_within && numbers_of(&frame) == old {
        write(tree, way, new);
        return Ok(());
    }
    if is_within && old[3..] == new[3..] {
        add(tree, way, &frame, DVec3::from_slice(&new[..3]) - origin(before));
        return Ok(());
    }
    let within = |cs: &CoordinateSystem| {
        frame_of(&CoordinateSystem {
            reference_cs: cs.reference_cs.clone().filter(|_| !is_within),
            ..cs.clone()
        })
    };
    let (here, there) = (within(before), within(&frame));
    let offset = here.rotation.transpose() * (there.origin - here.origin);
    let angles = if is_within && numbers_of(&frame)[3..] == old[3..] {
        [0.0; 3]
    } else if is_within && old[3..] == [0.0; 3] {
        [frame.rx, frame.ry, frame.rz]
    } else {
        let (rz, ry, rx) = (here.rotation.transpose() * there.rotation).to_euler(EulerRot::ZYX);
        [rx, ry, rz]
    };
    write(tree, way, [offset.x, offset.y, offset.z, angles[0], angles[1], angles[2]]);
    let mut outer = indexmap::IndexMap::new();
    outer
        .extend(FRAME.iter().zip(new).filter_map(|(key, number)| Some((key.to_string(), value_of(number)?))));
    outer.extend(reference.map(|reference| ("reference_cs".to_owned(), reference.clone())));
    if let Some(frame) = at_mut(tree, way) {
        frame.insert("reference_cs".into(), Value::Object(Box::new(outer)));
    }
    way.push(key("reference_cs"));
    Ok(())
}

/// Adds to the position of a frame. A number to which nothing is added keeps its digits.
fn add(tree: &mut Value, way: &[Step], frame: &CoordinateSystem, by: DVec3) {
    let there = origin(frame) + by;
    let Some(frame) = at_mut(tree, way) else { return };
    for (key, by, there) in [("x", by.x, there.x), ("y", by.y, there.y), ("z", by.z, there.z)] {
        if let Some(number) = value_of(there).filter(|_| by != 0.0) {
            frame.insert(key.into(), number);
        }
    }
}

fn write(tree: &mut Value, way: &[Step], numbers: [f64; 6]) {
    let Some(frame) = at_mut(tree, way) else { return };
    frame.extend(
        FRAME.iter().zip(numbers).filter_map(|(key, number)| Some((key.to_string(), value_of(number)?))),
    );
}

fn value_of(number: f64) -> Option<Value> {
    Number::from_f64(number).map(Value::Number)
}

/// In the order of [`FRAME`].
fn numbers_of(cs: &CoordinateSystem) -> [f64; 6] {
    [cs.x, cs.y, cs.z, cs.rx, cs.ry, cs.rz]
}

fn origin(cs: &CoordinateSystem) -> DVec3 {
    DVec3::new(cs.x, cs.y, cs.z)
}

fn set_origin(cs: &mut CoordinateSystem, origin: DVec3) {
    (cs.x, cs.y, cs.z) = origin.into();
}
