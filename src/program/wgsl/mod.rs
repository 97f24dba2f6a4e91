//! The WGSL of one scene: the files that it takes, and the text composed around them.

pub mod compose;
pub mod composition;
pub(crate) mod constants;
mod dispatch;
mod ledger_bins;
pub mod library;
pub(crate) mod rows;
mod search;
pub mod text;
mod trees;
pub(crate) mod variants;
