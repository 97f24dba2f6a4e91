//! Mesh files: STL, as text or binary, and OBJ, of which vertices and faces are read.
//!
//! The readers are our own: a file may come from anywhere, so sizes in it are checked before memory is taken, messages
//! name the line, and coordinates keep the digits that the text has.

use std::borrow::Cow;
use std::collections::HashMap;
use std::io::Read;
use std::path::Path;

use glam::DVec3;

use super::place::quoted;
use crate::ir::{Mesh, area_vector};
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

type Parsed = std::result::Result<Mesh, Malformed>;

/// Reads a mesh by the ending of its name.
pub(super) fn read(path: &Path, place: &str) -> Result<Mesh> {
    let ending = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
    let parse: fn(&[u8]) -> Parsed = match ending.as_str() {
        "stl" => stl,
        "obj" => |bytes| obj(&text(bytes)?),
        _ => {
            let problem = format!("{} is neither .stl nor .obj", quoted(&path.display().to_string()));
            return Err(Error::scene(place, problem, "convert the mesh to one of the two"));
        }
    };
    let bytes = bytes_of(path).map_err(|err| Error::file(path, format!("{err}; {place} names it")))?;
    let mesh = parse(&bytes).map_err(|err| {
        Error::file(path, format!("{}: {}; {place} names the file", err.place, err.problem))
    })?;
    match mesh.faces.is_empty() {
        true => Err(Error::file(path, format!("it holds no triangle; {place} names it"))),
        false => Ok(mesh),
    }
}

fn bytes_of(path: &Path) -> std::io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    std::fs::File::open(path)?.take(MAX_BYTES + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > MAX_BYTES {
        return Err(std::io::Error::other(format!("the file is longer than {MAX_BYTES} bytes")));
    }
    Ok(bytes)
}

fn text(bytes: &[u8]) -> std::result::Result<String, Malformed> {
    String::from_utf8(bytes.to_vec()).map_err(|err| Malformed {
        place: format!("byte {}", err.utf8_error().valid_up_to()),
        problem: "this is no UTF-8 text".into(),
    })
}

fn at_line(index: usize, problem: impl Into<String>) -> Malformed {
    Malformed { place: format!("line {}", index + 1), problem: problem.into() }
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
            // -0 is 0.
            let corner = corner + DVec3::ZERO;
            *self.known.entry(corner.to_array().map(f64::to_bits)).or_insert_with(|| {
                self.mesh.vertices.push(corner);
                self.mesh.vertices.len() as u32 - 1
            })
        });
        self.mesh.faces.push(face);
    }
}

/// A file whose length fits its number of triangles is binary, even if its comment begins with `solid`.
fn stl(bytes: &[u8]) -> Parsed {
    let count = bytes.get(STL_HEADER - 4..STL_HEADER).and_then(|word| word.try_into().ok());
    let count = count.map(|word| u32::from_le_bytes(word) as usize);
    match count {
        Some(count) if bytes.len() == STL_HEADER + count * STL_TRIANGLE => Ok(binary_stl(bytes)),
        _ if bytes.trim_ascii_start().starts_with(b"solid") && !bytes.contains(&0) => {
            ascii_stl(&text(bytes)?)
        }
        count => Err(Malformed {
            place: "the file".into(),
            problem: match count {
                Some(count) => format!("{} bytes are no binary STL of {count} triangles", bytes.len()),
                None => "it is too short for an STL".into(),
            },
        }),
    }
}

fn binary_stl(bytes: &[u8]) -> Mesh {
    let mut soup = Soup::default();
    for triangle in bytes[STL_HEADER..].chunks_exact(STL_TRIANGLE) {
        let number = |i: usize| {
            let word = [triangle[4 * i], triangle[4 * i + 1], triangle[4 * i + 2], triangle[4 * i + 3]];
            f64::from(f32::from_le_bytes(word))
        };
        // The first three numbers are the normal, which the corners tell better.
        soup.push([3, 6, 9].map(|i| DVec3::new(number(i), number(i + 1), number(i + 2))));
    }
    soup.mesh
}

fn ascii_stl(text: &str) -> Parsed {
    let mut soup = Soup::default();
    let mut corners = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let mut words = line.split_whitespace();
        match words.next() {
            Some("vertex") => corners.push(point(words, index)?),
            Some("endloop") => {
                let triangle = <[DVec3; 3]>::try_from(std::mem::take(&mut corners));
                soup.push(triangle.map_err(|loose| {
                    at_line(index, format!("this facet has {} corners instead of 3", loose.len()))
                })?);
            }
            _ => {}
        }
    }
    if corners.is_empty() {
        return Ok(soup.mesh);
    }
    Err(Malformed { place: "the end of the file".into(), problem: "the last facet is not complete".into() })
}

fn point<'a>(words: impl Iterator<Item = &'a str>, index: usize) -> std::result::Result<DVec3, Malformed> {
    let numbers: Vec<f64> = words.map_while(|word| word.parse().ok()).take(3).collect();
    match numbers[..] {
        [x, y, z] if DVec3::new(x, y, z).is_finite() => Ok(DVec3::new(x, y, z)),
        _ => Err(at_line(index, "a vertex needs three finite numbers")),
    }
}

/// Faces of more than three corners are cut into a fan.
fn obj(text: &str) -> Parsed {
    let mut mesh = Mesh::default();
    for (index, line) in records(text) {
        let mut words = line.split_whitespace();
        match words.next() {
            Some("v") => mesh.vertices.push(point(words, index)? + DVec3::ZERO),
            Some("f") => {
                let corner = |word| obj_index(word, mesh.vertices.len());
                let corners: Option<Vec<u32>> = words.map(corner).collect();
                let corners = corners
                    .filter(|corners| corners.len() >= 3)
                    .ok_or_else(|| at_line(index, "a face needs three or more vertices that are there"))?;
                let triangles = fan(&corners, &mesh.vertices).ok_or_else(|| {
                    at_line(
                        index,
                        format!(
                            "this face of {} corners cannot be cut into a fan; cut it into triangles",
                            corners.len()
                        ),
                    )
                })?;
                mesh.faces.extend(triangles);
            }
            _ => {}
        }
    }
    Ok(mesh)
}

fn without_comment(line: &str) -> &str {
    line.split('#').next().unwrap_or(line).trim_end()
}

/// Records without their comments, each with the index of its first line: where a vertex or a face ends in a backslash, the
/// next line belongs to it.
fn records(text: &str) -> impl Iterator<Item = (usize, Cow<'_, str>)> {
    let mut lines = text.lines().map(without_comment).enumerate();
    std::iter::from_fn(move || {
        let (index, line) = lines.next()?;
        let mut record = Cow::Borrowed(line);
        let is_read = matches!(line.split_whitespace().next(), Some("v" | "f"));
        while is_read && record.ends_with('\\') {
            let begun = record.to_mut();
            begun.pop();
            begun.push(' ');
            begun.push_str(lines.next().map_or("", |(_, next)| next));
        }
        Some((index, record))
    })
}

/// The triangles from a corner that sees every other, so that each point of the face lies in one of them; the first without
/// triangles that have no area, if there is one. None if no corner does, of the first so many of a long face.
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

/// `7`, `7/1`, `7//3`: vertices count from 1, or backwards from -1.
fn obj_index(word: &str, num_vertices: usize) -> Option<u32> {
    let number: i64 = word.split('/').next()?.parse().ok()?;
    let index = if number < 0 { num_vertices as i64 + number } else { number - 1 };
    (0..num_vertices as i64).contains(&index).then_some(index as u32)
}
