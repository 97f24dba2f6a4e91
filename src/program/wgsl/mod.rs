//! The WGSL of one scene: the files that it takes, and the text composed around them.

mod bins;
pub mod compose;
pub mod composition;
pub(crate) mod constants;
mod derivatives;
mod dispatch;
pub mod extension;
pub mod library;
mod paths;
mod rows;
mod search;
pub mod text;
mod trees;
pub(crate) mod variants;
mod wrong_sides;
