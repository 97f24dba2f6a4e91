//! The meshes of a scene: from files or as written, checked, each kept once.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};

use glam::DVec3;

use crate::format::path_text;
use crate::model::checks::MAX_LENGTH;
use crate::model::key_path::{key_of, quoted};
use crate::model::shapes::mesh;
use crate::model::{Mesh, area_vector};
use crate::scene::json::{Interaction, Material, RawSurface, SceneFile, Shape};
use crate::scene::mesh_files::{self, MeshFile};
use crate::{Error, Result};

/// Most triangles of all meshes: 3 rows each and 2 for each of less than twice as many nodes, numbered below 2^24, which
/// f32 holds.
const MAX_TRIANGLES: usize = 1 << 21;

/// Where a surface's mesh is.
#[derive(Debug, Clone, Copy)]
pub(super) struct Placed {
    /// Its place among the meshes of the scene.
    pub mesh: usize,
    /// The origin of the mesh's frame in the coordinates that the user gave.
    pub centre: DVec3,
}

/// The meshes of a scene.
#[derive(Debug, Default)]
pub(super) struct Meshes {
    /// Each once, however often it is placed.
    pub meshes: Vec<Mesh>,
    placed: HashMap<usize, Placed>,
    /// By path, and the bits of the scale.
    files: HashMap<(PathBuf, u64), Placed>,
    by_hash: HashMap<u64, Vec<Placed>>,
    /// What refractive surfaces ask of a mesh.
    solids: HashMap<usize, Solid>,
}

impl Meshes {
    /// Reads every mesh that the single surfaces name.
    pub fn load(file: &SceneFile, folder: &Path, warnings: &mut Vec<String>) -> Result<Self> {
        let mut meshes = Meshes::default();
        for (index, raw) in file.nsq_gpu.iter().flat_map(|block| &block.surfaces).enumerate() {
            let place = key_of(&format!("nsq_gpu.surfaces[{index}]"), "shape");
            if let Some(placed) = meshes.mesh_of(raw, folder, &place, warnings)? {
                meshes.placed.insert(index, placed);
                if raw.interaction == Interaction::Refractive {
                    let solid = meshes
                        .solids
                        .entry(placed.mesh)
                        .or_insert_with(|| Solid::of(&meshes.meshes[placed.mesh]));
                    warnings.extend(solid.warnings(raw));
                }
            }
        }
        Ok(meshes)
    }

    /// The mesh of a single surface, by its place in the list.
    pub fn placed(&self, surface: usize) -> Option<Placed> {
        self.placed.get(&surface).copied()
    }

    fn mesh_of(
        &mut self,
        raw: &RawSurface,
        folder: &Path,
        place: &str,
        warnings: &mut Vec<String>,
    ) -> Result<Option<Placed>> {
        let Shape::Mesh(written) = &raw.shape else { return Ok(None) };
        let mesh::Written { path, vertices, faces, scale } = written;
        let scale = scale.unwrap_or(1.0);
        let placed = match (path, vertices, faces) {
            (Some(path), None, None) => {
                let path = folder.join(path);
                let key = (path.clone(), scale.to_bits());
                if let Some(known) = self.files.get(&key) {
                    return Ok(Some(*known));
                }
                let place_of_path = key_of(place, "path");
                let MeshFile { mesh, lacks_end } = mesh_files::read(&path, &place_of_path)?;
                let placed = self.add(scaled(mesh, scale), raw, place, warnings)?;
                if lacks_end {
                    warnings.push(self.cut_off(placed, &path, &place_of_path)?);
                }
                self.files.insert(key, placed);
                placed
            }
            (None, Some(vertices), Some(faces)) => {
                let vertices = vertices.iter().copied().map(DVec3::from_array).collect();
                self.add(scaled(Mesh { vertices, faces: faces.clone() }, scale), raw, place, warnings)?
            }
            _ => {
                return Err(Error::scene(
                    place,
                    "a mesh needs either a file or its vertices and faces",
                    "give `path`, or both `vertices` and `faces`",
                ));
            }
        };
        Ok(Some(placed))
    }

    /// What to say of a file that ends without `endsolid`. Where the mesh is not closed, part of it is missing most likely.
    fn cut_off(&self, placed: Placed, path: &Path, place: &str) -> Result<String> {
        let found = "the file ends without `endsolid`";
        match Solid::of(&self.meshes[placed.mesh]).open_edges {
            0 => Ok(format!("{}: {found}, though its mesh is closed", path_text(path))),
            open => Err(Error::file(
                path,
                format!(
                    "{found} and its mesh has {open} open edges, so that it seems cut off; if it is whole, add the line \
                     `endsolid`; {place} names the file"
                ),
            )),
        }
    }

    /// Checks a mesh, moves it about its middle, and keeps it unless it is there already.
    fn add(
        &mut self,
        mut mesh: Mesh,
        raw: &RawSurface,
        place: &str,
        warnings: &mut Vec<String>,
    ) -> Result<Placed> {
        check(&mesh, place)?;
        warnings.extend(drop_degenerate(&mut mesh, &raw.name));
        if mesh.faces.is_empty() {
            return Err(Error::scene(
                place,
                "the mesh has no triangle",
                "give at least one that has an area",
            ));
        }
        let hash = hash_of(&mesh);
        let candidates = self.by_hash.entry(hash).or_default();
        let centre = centre_of(&mesh);
        mesh.vertices.iter_mut().for_each(|v| *v -= centre);
        let same = |placed: &&Placed| placed.centre == centre && self.meshes[placed.mesh] == mesh;
        if let Some(known) = candidates.iter().find(same) {
            return Ok(*known);
        }
        let total = mesh.faces.len() + self.meshes.iter().map(|m| m.faces.len()).sum::<usize>();
        if total > MAX_TRIANGLES {
            return Err(Error::scene(
                place,
                format!("with this mesh the scene has {total} triangles"),
                format!("use at most {MAX_TRIANGLES}; the same mesh placed twice counts once"),
            ));
        }
        warnings.extend(doubled_facets(&mesh, &raw.name));
        let placed = Placed { mesh: self.meshes.len(), centre };
        candidates.push(placed);
        self.meshes.push(mesh);
        Ok(placed)
    }
}

/// The mesh in other units.
fn scaled(mut mesh: Mesh, scale: f64) -> Mesh {
    if scale != 1.0 {
        mesh.vertices.iter_mut().for_each(|vertex| *vertex *= scale);
    }
    mesh
}

fn check(mesh: &Mesh, place: &str) -> Result<()> {
    let absurd = |v: &DVec3| !(v.is_finite() && v.abs().max_element() <= MAX_LENGTH);
    if let Some(i) = mesh.vertices.iter().position(absurd) {
        return Err(Error::scene(
            format!("{place}.vertices[{i}]"),
            format!("{:?} mm is out of range", mesh.vertices[i].to_array()),
            format!("give numbers from -{MAX_LENGTH:e} to {MAX_LENGTH:e}"),
        ));
    }
    let strays = |face: &[u32; 3]| face.iter().any(|&vertex| vertex as usize >= mesh.vertices.len());
    if let Some(i) = mesh.faces.iter().position(strays) {
        return Err(Error::scene(
            format!("{place}.faces[{i}]"),
            format!("{:?} names a vertex that is not there", mesh.faces[i]),
            format!("there are {} vertices, counted from 0", mesh.vertices.len()),
        ));
    }
    Ok(())
}

/// Triangles without area have no normal, and no ray hits them.
fn drop_degenerate(mesh: &mut Mesh, name: &str) -> Option<String> {
    let before = mesh.faces.len();
    let faces = std::mem::take(&mut mesh.faces);
    let has_area = |face: &[u32; 3]| {
        let area = area_vector(mesh.corners(*face));
        area != DVec3::ZERO && area.is_finite()
    };
    mesh.faces = faces.into_iter().filter(has_area).collect();
    let dropped = before - mesh.faces.len();
    (dropped > 0).then(|| {
        format!("{dropped} of the {before} triangles of {} have no area and are left out", quoted(name))
    })
}

/// Triangles that have the same corners as others. Two that face each other may be the wall between two bodies of one file.
fn doubled_facets(mesh: &Mesh, name: &str) -> Option<String> {
    let mut seen: HashMap<[[u64; 3]; 3], bool> = HashMap::with_capacity(mesh.faces.len());
    let (mut doubled, mut facing) = (0, 0);
    for face in &mesh.faces {
        let corners = mesh.corners(*face).map(bits);
        let mut sorted = corners;
        sorted.sort_unstable();
        // Turning the corners round their triangle keeps the way that it faces.
        let is_even = (0..3).any(|turn| [0, 1, 2].map(|i| corners[(i + turn) % 3]) == sorted);
        match seen.entry(sorted) {
            Entry::Vacant(entry) => drop(entry.insert(is_even)),
            Entry::Occupied(first) if *first.get() == is_even => doubled += 1,
            Entry::Occupied(_) => facing += 1,
        }
    }
    let all = mesh.faces.len();
    let name = quoted(name);
    if doubled > 0 {
        Some(format!(
            "{doubled} of the {all} triangles of the mesh {name} stand where another one has the same corners: the mesh has \
             doubled facets, so remove them from its file"
        ))
    } else {
        (facing > 0).then(|| {
            format!(
                "{facing} of the {all} triangles of the mesh {name} face another one with the same corners: light passes \
                 between bodies in touch there, as it should; where the file holds one facet twice, remove the second"
            )
        })
    }
}

/// What bounds a solid, and what does not.
#[derive(Debug)]
struct Solid {
    /// Edges of an odd number of faces.
    open_edges: usize,
    /// Other edges that unlike numbers of faces run along in either direction.
    turned_edges: usize,
    /// Closed parts whose faces look inward, but for hollows within others.
    parts_inside_out: usize,
}

impl Solid {
    /// An edge of a closed mesh belongs to two faces, which run along it in opposite directions.
    fn of(mesh: &Mesh) -> Self {
        let mut edges: HashMap<([u64; 3], [u64; 3]), [u32; 2]> = HashMap::new();
        for face in &mesh.faces {
            let corners = mesh.corners(*face).map(bits);
            for (from, to) in [(0, 1), (1, 2), (2, 0)] {
                let (key, direction) = match corners[from] <= corners[to] {
                    true => ((corners[from], corners[to]), 0),
                    false => ((corners[to], corners[from]), 1),
                };
                edges.entry(key).or_default()[direction] += 1;
            }
        }
        let uneven = || edges.values().filter(|[there, back]| there != back);
        let open_edges = uneven().filter(|[there, back]| (there + back) % 2 == 1).count();
        let turned_edges = uneven().count() - open_edges;
        let parts_inside_out = if open_edges + turned_edges == 0 { parts_inside_out(mesh) } else { 0 };
        Solid { open_edges, turned_edges, parts_inside_out }
    }

    /// Says where a solid would leak, or light take its inside for its outside.
    fn warnings(&self, raw: &RawSurface) -> Option<String> {
        let name = quoted(&raw.name);
        match *self {
            Solid { open_edges: open @ 1.., .. } => Some(format!(
                "the mesh {name} is not closed ({open} open edges): it bounds a solid only with other surfaces"
            )),
            Solid { turned_edges: turned @ 1.., .. } => Some(format!(
                "faces of the mesh {name} are turned against their neighbours (along {turned} edges): rays take its inside for \
                 its outside there"
            )),
            // With vacuum in front, and a medium behind, that is how a solid is written.
            Solid { parts_inside_out: parts @ 1.., .. } if raw.material_front != Material::Vacuum => {
                Some(format!(
                    "the mesh {name} is inside out ({parts} of its parts): its normals point inward, so that its material_front fills \
                 what is outside; turn its faces, or exchange its materials"
                ))
            }
            Solid { .. } => None,
        }
    }
}

/// Parts of a closed mesh that hold a negative volume, if no part of positive volume has them in its box.
fn parts_inside_out(mesh: &Mesh) -> usize {
    struct Part {
        volume: f64,
        low: DVec3,
        high: DVec3,
    }
    let mut parts: HashMap<u32, Part> = HashMap::new();
    let of_face = parts_of(mesh);
    for (face, part) in mesh.faces.iter().zip(of_face) {
        let [a, b, c] = mesh.corners(*face);
        let none = || Part { volume: 0.0, low: DVec3::INFINITY, high: DVec3::NEG_INFINITY };
        let part = parts.entry(part).or_insert_with(none);
        part.volume += a.dot(b.cross(c));
        part.low = part.low.min(a).min(b).min(c);
        part.high = part.high.max(a).max(b).max(c);
    }
    let is_within =
        |inner: &Part, outer: &Part| inner.low.cmpge(outer.low).all() && inner.high.cmple(outer.high).all();
    let solid: Vec<&Part> = parts.values().filter(|part| part.volume > 0.0).collect();
    let is_hollow = |part: &Part| solid.iter().any(|outer| is_within(part, outer));
    parts.values().filter(|part| part.volume < 0.0 && !is_hollow(part)).count()
}

/// For each face a number that faces have in common where a way along edges leads from one to the other.
fn parts_of(mesh: &Mesh) -> Vec<u32> {
    let mut number_of: HashMap<[u64; 3], u32> = HashMap::new();
    let mut numbered = |vertex: DVec3| {
        let next = number_of.len() as u32;
        *number_of.entry(bits(vertex)).or_insert(next)
    };
    let faces: Vec<[u32; 3]> = mesh.faces.iter().map(|face| mesh.corners(*face).map(&mut numbered)).collect();
    let mut parents: Vec<u32> = (0..number_of.len() as u32).collect();
    for [a, b, c] in &faces {
        for other in [b, c] {
            let (one, two) = (root_of(&mut parents, *a), root_of(&mut parents, *other));
            parents[one as usize] = two;
        }
    }
    faces.iter().map(|[corner, ..]| root_of(&mut parents, *corner)).collect()
}

fn root_of(parents: &mut [u32], mut of: u32) -> u32 {
    while parents[of as usize] != of {
        // Halves the way for whoever comes next.
        parents[of as usize] = parents[parents[of as usize] as usize];
        of = parents[of as usize];
    }
    of
}

fn bits(vertex: DVec3) -> [u64; 3] {
    // -0 is 0.
    vertex.to_array().map(|x| (x + 0.0).to_bits())
}

fn hash_of(mesh: &Mesh) -> u64 {
    let mut hasher = DefaultHasher::new();
    mesh.faces.hash(&mut hasher);
    mesh.vertices.iter().for_each(|v| bits(*v).hash(&mut hasher));
    hasher.finish()
}

/// The middle of the bounds of the vertices that are used.
fn centre_of(mesh: &Mesh) -> DVec3 {
    let used = || mesh.faces.iter().flat_map(|face| mesh.corners(*face));
    let low = used().fold(DVec3::INFINITY, DVec3::min);
    let high = used().fold(DVec3::NEG_INFINITY, DVec3::max);
    0.5 * (low + high)
}
