//! Text files that a flag or a configuration names.

use std::path::Path;

use anyhow::{Context, Result};
use heliostat_files::read_text;

/// Reads a text file as [`read_text`] does.
///
/// # Errors
/// A file that cannot be read, by name.
pub fn read(file: &Path) -> Result<String> {
    read_text(file).with_context(|| format!("cannot read {}", file.display()))
}
