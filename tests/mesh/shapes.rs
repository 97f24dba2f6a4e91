//! Meshes to test with; faces are counter-clockwise seen from outside.

use glam::DVec3;
use nsq_gpu::model::Mesh;
use std::collections::HashMap;

/// A sphere about the origin: an icosahedron whose triangles are cut in four so many times.
pub fn icosphere(cuts: u32, radius: f64) -> Mesh {
    let mut mesh = icosahedron();
    for _ in 0..cuts {
        mesh = cut_in_four(&mesh);
    }
    mesh.vertices.iter_mut().for_each(|v| *v *= radius);
    mesh
}

/// The same with dents and bumps, so that lines cross it many times.
pub fn bumpy_ball(cuts: u32, radius: f64) -> Mesh {
    let mut mesh = icosphere(cuts, radius);
    for v in &mut mesh.vertices {
        let u = *v / radius;
        *v *= 0.8 + 0.2 * (9.0 * u.x).sin() * (8.0 * u.y).sin() * (7.0 * u.z + 1.0).sin();
    }
    mesh
}

fn icosahedron() -> Mesh {
    let g = 0.5 * (1.0 + 5.0_f64.sqrt());
    let corner = |i: u32| {
        let (long, short) = (if i & 1 == 0 { g } else { -g }, if i & 2 == 0 { 1.0 } else { -1.0 });
        match i / 4 {
            0 => DVec3::new(0.0, short, long),
            1 => DVec3::new(short, long, 0.0),
            _ => DVec3::new(long, 0.0, short),
        }
    };
    let vertices: Vec<DVec3> = (0..12).map(corner).collect();
    // Edges have length 2, and three vertices at that distance are a face.
    let near = |i: usize, j: usize| (vertices[i] - vertices[j]).length() < 2.1;
    let mut faces = Vec::new();
    for i in 0..12 {
        for j in i + 1..12 {
            for k in j + 1..12 {
                if near(i, j) && near(j, k) && near(k, i) {
                    let outward =
                        (vertices[j] - vertices[i]).cross(vertices[k] - vertices[i]).dot(vertices[i]) > 0.0;
                    faces.push(if outward { [i, j, k] } else { [i, k, j] }.map(|index| index as u32));
                }
            }
        }
    }
    assert_eq!(faces.len(), 20);
    Mesh { vertices: vertices.iter().map(|v| v.normalize()).collect(), faces }
}

fn cut_in_four(mesh: &Mesh) -> Mesh {
    let mut vertices = mesh.vertices.clone();
    let mut middles = HashMap::new();
    let mut middle = |a: u32, b: u32| {
        *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
            vertices.push((vertices[a as usize] + vertices[b as usize]).normalize());
            vertices.len() as u32 - 1
        })
    };
    let faces = mesh.faces.iter().flat_map(|&[a, b, c]| {
        let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
        [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
    });
    let faces = faces.collect();
    Mesh { vertices, faces }
}

/// A cube about the origin.
pub fn cube(half: f64) -> Mesh {
    let sign = |bit: u32| if bit == 0 { -half } else { half };
    let corner = |i: u32| DVec3::new(sign(i & 1), sign(i & 2), sign(i & 4));
    let squares = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let faces = squares.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]);
    Mesh { vertices: (0..8).map(corner).collect(), faces: faces.collect() }
}
