//! What a scene's surfaces are searched by: trees of boxes, meshes, and which faces lie in one place.

pub mod bvh;
pub mod contact;
pub mod mesh;
pub mod tree;
