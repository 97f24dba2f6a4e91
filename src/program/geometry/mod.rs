//! How a scene's surfaces are searched: trees of boxes, meshes, and faces in contact.

pub mod bvh;
pub mod contact;
pub mod mesh;
pub mod tree;
