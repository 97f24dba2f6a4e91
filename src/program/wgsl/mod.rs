//! The WGSL of one scene: the files that it takes, and the text composed around them.

mod bins;
pub mod compose;
pub mod composition;
pub(crate) mod constants;
mod dispatch;
pub mod library;
pub(crate) mod rows;
mod search;
pub mod text;
mod trees;
pub(crate) mod variants;
