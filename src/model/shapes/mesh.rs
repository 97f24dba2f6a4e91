//! A triangle mesh of the scene, where a surface places it.

use crate::model::checks;
use crate::model::mesh::Mesh;
use crate::model::shapes::{Extent, FrontSide, Geometry, Normal, Shape, ShapeKind, ShapeWgsl, WrittenShape};
use crate::shaders::shader;
use crate::{Error, Result};
use glam::DVec3;
use schemars::JsonSchema;
use serde::Deserialize;

/// The mesh, by the root of the tree over its triangles.
pub const MESH: ShapeWgsl =
    ShapeWgsl { name: "mesh", file: shader!("shapes/mesh.wgsl"), num_arguments: 1, normal: Normal::Facet };

/// An index into [`crate::model::SceneIr::meshes`]. The normal of a face points to the side from which its corners run
/// counter-clockwise.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MeshId(pub usize);

/// A mesh in a scene file.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Written {
    /// File, relative to the scene file.
    #[serde(default)]
    pub path: Option<String>,
    /// Vertices \[mm\].
    #[serde(default)]
    pub vertices: Option<Vec<[f64; 3]>>,
    /// Indices into the vertices, counter-clockwise seen from outside.
    #[serde(default)]
    pub faces: Option<Vec<[u32; 3]>>,
    /// Factor of all coordinates, such as 1000 for a file in metres. 1 where it is left out.
    #[serde(default)]
    pub scale: Option<f64>,
}

impl WrittenShape for Written {
    /// The rest is checked where it is read.
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        self.scale.map_or(Ok(()), |scale| checks::between(at("scale"), scale, 1e-9, 1e9))
    }

    fn shape(&self, place: &str, mesh: Option<usize>) -> Result<Shape> {
        let mesh = mesh.ok_or_else(|| Error::Internal(format!("the mesh at {place} was not read")))?;
        Ok(Shape::Mesh(MeshId(mesh)))
    }
}

impl Geometry for MeshId {
    fn kind(&self) -> ShapeKind {
        ShapeKind::Mesh
    }

    fn front_side(&self) -> FrontSide {
        FrontSide::Inside
    }

    fn arguments(&self) -> Vec<f64> {
        // The trees over meshes come first, in the order of the meshes.
        vec![self.0 as f64]
    }

    fn holds(&self, _: DVec3) -> bool {
        false
    }

    fn extent(&self, meshes: &[Mesh]) -> Option<Extent> {
        let vertices = &meshes.get(self.0)?.vertices;
        let low = vertices.iter().copied().reduce(DVec3::min)?;
        let high = vertices.iter().copied().reduce(DVec3::max)?;
        Some(Extent::block(low, high))
    }

    /// The search for contacts looks at facets.
    fn samples(&self) -> Vec<DVec3> {
        Vec::new()
    }

    /// The edges of its faces; of a large mesh a part.
    fn edges(&self, meshes: &[Mesh]) -> Vec<Vec<DVec3>> {
        const MOST_FACES: usize = 3000;
        let Some(mesh) = meshes.get(self.0) else { return Vec::new() };
        let step = mesh.faces.len().div_ceil(MOST_FACES).max(1);
        let face = |face: &[u32; 3]| {
            let [a, b, c] = mesh.corners(*face);
            vec![a, b, c, a]
        };
        mesh.faces.iter().step_by(step).map(face).collect()
    }

    fn is_closed(&self) -> bool {
        true
    }

    fn mesh(&self) -> Option<usize> {
        Some(self.0)
    }
}
