//! `nsq-gpu schema`: prints the JSON Schema of scene files.

use crate::error::{Error, Result};

/// Returns the schema as text.
pub fn run() -> Result<String> {
    let text = serde_json::to_string_pretty(&crate::scene::schema());
    text.map(|text| text + "\n").map_err(|e| Error::Internal(e.to_string()))
}
