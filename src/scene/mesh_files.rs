//! Mesh files: STL, as text or binary, and OBJ, of which vertices and faces are read, in all dialects that trimesh reads.
//!
//! The readers are our own, because a file may come from anywhere. They check sizes before they take memory, name the
//! line in messages, and keep all digits of coordinates.

use std::borrow::Cow;
use std::collections::HashMap;
use std::path::Path;

use glam::DVec3;

use crate::model::checks::MAX_LENGTH;
use crate::model::key_path::quoted;
use crate::model::whole_files;
use crate::model::{Mesh, area_vector};
use crate::{Error, Result};

/// Longest file that is read \[bytes\].
const MAX_BYTES: u64 = 1 << 30;
/// Bytes of a binary STL before its triangles: a comment and their number.
const STL_HEADER: usize = 84;
/// Bytes of a triangle of a binary STL: normal, corners, attributes.
const STL_TRIANGLE: usize = 50;

/// What a file's format does not allow; `place` is a line or a triangle.
struct Malformed {
    place: String,
    problem: String,
}

type Checked<T> = std::result::Result<T, Malformed>;

/// What a file holds.
pub(super) struct MeshFile {
    pub mesh: Mesh,
    /// A text STL without its last line: whole, or cut off between two facets.
    pub lacks_end: bool,
}

/// Reads a mesh by the ending of its name.
pub(super) fn read(path: &Path, place: &str) -> Result<MeshFile> {
    let ending = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
    let parse: fn(&[u8]) -> Checked<MeshFile> = match ending.as_str() {
        "stl" => stl,
        "obj" => |bytes| obj(&lines_of(bytes)?),
        _ => {
            let problem = format!("{} is neither .stl nor .obj", quoted(&path.display().to_string()));
            return Err(Error::scene(place, problem, "convert the mesh to one of the two"));
        }
    };
    let bytes = whole_files::read(path, MAX_BYTES)
        .map_err(|err| Error::file(path, format!("{err}; {place} names it")))?;
    let file = parse(&bytes).map_err(|err| {
        Error::file(path, format!("{}: {}; {place} names the file", err.place, err.problem))
    })?;
    match file.mesh.faces.is_empty() {
        true => Err(Error::file(path, format!("it holds no triangle; {place} names it"))),
        false => Ok(file),
    }
}

/// The text of a file whose lines end as other readers take them to.
fn lines_of(bytes: &[u8]) -> Checked<String> {
    let text = whole_files::text(bytes);
    if text.contains('\r') && !text.contains('\n') {
        return Err(Malformed {
            place: "line 1".into(),
            problem: "its lines end in a carriage return alone; end them in a line feed".into(),
        });
    }
    Ok(text)
}

fn at_line(index: usize, problem: impl Into<String>) -> Malformed {
    Malformed { place: format!("line {}", index + 1), problem: problem.into() }
}

/// A corner, if its coordinates are such as a scene may have.
fn corner_of(coordinates: [f64; 3]) -> std::result::Result<DVec3, String> {
    let corner = DVec3::from_array(coordinates);
    if !corner.is_finite() {
        return Err(format!("a vertex needs three finite numbers, and has {coordinates:?}"));
    }
    if corner.abs().max_element() > MAX_LENGTH {
        return Err(format!(
            "the vertex {coordinates:?} mm is out of range: coordinates reach to {MAX_LENGTH:e}"
        ));
    }
    // -0 is 0.
    Ok(corner + DVec3::ZERO)
}

/// Collects triangles; corners of the same coordinates become one vertex.
#[derive(Default)]
struct Soup {
    mesh: Mesh,
    known: HashMap<[u64; 3], u32>,
}

impl Soup {
    fn push(&mut self, corners: [DVec3; 3]) {
        let face = corners.map(|corner| {
            *self.known.entry(corner.to_array().map(f64::to_bits)).or_insert_with(|| {
                self.mesh.vertices.push(corner);
                self.mesh.vertices.len() as u32 - 1
            })
        });
        self.mesh.faces.push(face);
    }
}

/// A file whose length fits its number of triangles is binary, even if its comment begins with `solid`.
fn stl(bytes: &[u8]) -> Checked<MeshFile> {
    let count = bytes.get(STL_HEADER - 4..STL_HEADER).and_then(|word| word.try_into().ok());
    let count = count.map(|word| u32::from_le_bytes(word) as usize);
    if count.is_some_and(|count| bytes.len() == STL_HEADER + count * STL_TRIANGLE) {
        return binary_stl(bytes);
    }
    let is_utf_16 = matches!(bytes, [0xFF, 0xFE, ..] | [0xFE, 0xFF, ..]);
    if is_utf_16 || !bytes.contains(&0) {
        let text = whole_files::text(bytes);
        let has = |word: &str| text.split_whitespace().any(|other| other.eq_ignore_ascii_case(word));
        if has("facet") || has("solid") {
            return ascii_stl(&lines_of(bytes)?);
        }
    }
    Err(Malformed {
        place: "the file".into(),
        problem: match count {
            Some(count) => format!("{} bytes are no binary STL of {count} triangles", bytes.len()),
            None => "it is too short for an STL".into(),
        },
    })
}

fn binary_stl(bytes: &[u8]) -> Checked<MeshFile> {
    let mut soup = Soup::default();
    for (number, triangle) in (1..).zip(bytes[STL_HEADER..].chunks_exact(STL_TRIANGLE)) {
        let coordinate = |i: usize| {
            let word = [triangle[4 * i], triangle[4 * i + 1], triangle[4 * i + 2], triangle[4 * i + 3]];
            f64::from(f32::from_le_bytes(word))
        };
        // The first three numbers are the normal, which follows from the corners with more digits.
        let mut corners = [DVec3::ZERO; 3];
        for (corner, first) in corners.iter_mut().zip([3, 6, 9]) {
            *corner = corner_of([0, 1, 2].map(|axis| coordinate(first + axis)))
                .map_err(|problem| Malformed { place: format!("facet {number}"), problem })?;
        }
        soup.push(corners);
    }
    Ok(MeshFile { mesh: soup.mesh, lacks_end: false })
}

/// Words count, in upper or lower case, and not how lines hold them; `end loop` is `endloop`. A name ends with its line, and so
/// does a normal, which is not read: it follows from the corners with more digits.
fn ascii_stl(text: &str) -> Checked<MeshFile> {
    let mut soup = Soup::default();
    let mut corners = Vec::new();
    let (mut begun, mut ended) = (0_usize, 0_usize);
    for (index, line) in text.lines().enumerate() {
        let mut words = line.split_whitespace();
        while let Some(word) = words.next() {
            match word.to_ascii_lowercase().as_str() {
                "solid" => {
                    begun += 1;
                    break;
                }
                "endsolid" => {
                    ended += 1;
                    break;
                }
                "normal" => break,
                "vertex" => {
                    let numbers: Vec<f64> =
                        words.by_ref().take(3).map_while(|word| word.parse().ok()).collect();
                    corners.push(corner_at(&numbers, index)?);
                }
                "endloop" => soup.push(facet(&mut corners, index)?),
                "endfacet" if corners.is_empty() => {}
                "endfacet" => soup.push(facet(&mut corners, index)?),
                "end" => match words.next().map(str::to_ascii_lowercase).as_deref() {
                    Some("loop") => soup.push(facet(&mut corners, index)?),
                    Some("solid") => {
                        ended += 1;
                        break;
                    }
                    _ => {}
                },
                "facet" if !corners.is_empty() => return Err(at_line(index, "the facet before has no end")),
                other if other.parse::<f64>().is_ok() => {
                    return Err(at_line(index, format!("the number {other} belongs to no vertex")));
                }
                _ => {}
            }
        }
    }
    if !corners.is_empty() {
        return Err(Malformed {
            place: "the end of the file".into(),
            problem: "the last facet is not complete".into(),
        });
    }
    Ok(MeshFile { mesh: soup.mesh, lacks_end: ended < begun.max(1) })
}

fn facet(corners: &mut Vec<DVec3>, index: usize) -> Checked<[DVec3; 3]> {
    let found = std::mem::take(corners);
    <[DVec3; 3]>::try_from(found)
        .map_err(|loose| at_line(index, format!("this facet has {} corners instead of 3", loose.len())))
}

fn corner_at(numbers: &[f64], index: usize) -> Checked<DVec3> {
    let numbers: [f64; 3] =
        numbers.try_into().map_err(|_| at_line(index, "a vertex needs three finite numbers"))?;
    corner_of(numbers).map_err(|problem| at_line(index, problem))
}

/// Faces may stand before their vertices; faces of more than three corners are cut into a fan.
fn obj(text: &str) -> Checked<MeshFile> {
    let mut mesh = Mesh::default();
    let mut faces = Vec::new();
    for (index, line) in records(text) {
        let mut words = line.split_whitespace();
        match words.next() {
            Some("v" | "V") => {
                // A weight or a colour may follow.
                let numbers: Vec<f64> = words.take(3).map_while(|word| word.parse().ok()).collect();
                mesh.vertices.push(corner_at(&numbers, index)?);
            }
            Some("f" | "F" | "fo") => {
                let corners: Option<Vec<usize>> =
                    words.map(|word| obj_index(word, mesh.vertices.len())).collect();
                faces.push((index, corners.filter(|corners| corners.len() >= 3)));
            }
            _ => {}
        }
    }
    for (index, corners) in faces {
        let are_there = |corners: &Vec<usize>| corners.iter().all(|&corner| corner < mesh.vertices.len());
        let corners = corners
            .filter(are_there)
            .ok_or_else(|| at_line(index, "a face needs three or more vertices that are there"))?;
        let corners: Vec<u32> = corners.into_iter().map(|corner| corner as u32).collect();
        let triangles = fan(&corners, &mesh.vertices).ok_or_else(|| {
            let corners = corners.len();
            let problem =
                format!("this face of {corners} corners cannot be cut into a fan; cut it into triangles");
            at_line(index, problem)
        })?;
        mesh.faces.extend(triangles);
    }
    Ok(MeshFile { mesh, lacks_end: false })
}

fn without_comment(line: &str) -> &str {
    line.split('#').next().unwrap_or(line).trim_end()
}

/// Records without their comments, each with the index of its first line. Where a vertex or a face ends in a backslash,
/// the next line belongs to it.
fn records(text: &str) -> impl Iterator<Item = (usize, Cow<'_, str>)> {
    let mut lines = text.lines().map(without_comment).enumerate();
    std::iter::from_fn(move || {
        let (index, line) = lines.next()?;
        let mut record = Cow::Borrowed(line);
        let is_read = matches!(line.split_whitespace().next(), Some("v" | "V" | "f" | "F" | "fo"));
        while is_read && record.ends_with('\\') {
            let begun = record.to_mut();
            begun.pop();
            begun.push(' ');
            begun.push_str(lines.next().map_or("", |(_, next)| next));
        }
        Some((index, record))
    })
}

/// The triangles from a corner that sees every other corner, so that each point of the face lies in one of them. The
/// first corner whose triangles all have an area is preferred. None if no corner does, of the first so many of a long
/// face.
fn fan(corners: &[u32], vertices: &[DVec3]) -> Option<Vec<[u32; 3]>> {
    const MOST_TRIED: usize = 1 << 8;
    /// Share of the face that triangles may lie outside it, where corners in a row are rounded.
    const ROUNDING: f64 = 1e-6;
    let from = |start: usize| {
        let corner = move |i: usize| corners[(start + i) % corners.len()];
        (1..corners.len() - 1).map(move |i| [corner(0), corner(i), corner(i + 1)])
    };
    let normal = |triangle: [u32; 3]| area_vector(triangle.map(|vertex| vertices[vertex as usize]));
    if corners.len() == 3 {
        return Some(from(0).collect());
    }
    let whole: DVec3 = from(0).map(normal).sum();
    let least = whole.length_squared() * ROUNDING;
    let start = |least: f64| {
        let sees_all = |start: &usize| from(*start).all(|triangle| normal(triangle).dot(whole) >= least);
        (0..corners.len().min(MOST_TRIED)).find(sees_all)
    };
    start(least).or_else(|| start(-least)).map(|start| from(start).collect())
}

/// `7`, `7/1`, `7//3`: vertices count from 1, or backwards from -1, the last one before.
fn obj_index(word: &str, num_vertices: usize) -> Option<usize> {
    let number: i64 = word.split('/').next()?.parse().ok()?;
    let index = if number < 0 { (num_vertices as i64).checked_add(number)? } else { number - 1 };
    usize::try_from(index).ok()
}
