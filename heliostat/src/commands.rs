//! One module for each command, and functions that several of them share.

use anyhow::{Context, Result, ensure};
use serde::de::DeserializeOwned;

pub mod bench;
pub mod calibrate;
pub mod completions;
pub mod config;
pub mod demo;
pub mod doctor;
pub mod eval;
pub mod keys;
pub mod link;
pub mod map;
mod mirrors;
pub mod results;
pub mod scenario;
pub mod ui;

/// Reads a CSV file whose header names all `required` columns, any `optional` ones, and no others.
fn read_csv<T: DeserializeOwned>(file: &str, required: &[&str], optional: &[&str]) -> Result<Vec<T>> {
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .comment(Some(b'#'))
        .from_path(file)
        .with_context(|| format!("cannot read {file}"))?;
    let header = reader.headers().with_context(|| format!("in {file}"))?;
    let known = header.iter().all(|name| required.contains(&name) || optional.contains(&name));
    let complete = required.iter().all(|name| header.iter().any(|found| found == *name));
    ensure!(
        known && complete,
        "in {file}: the header is \"{}\"; expected {}{}",
        header.iter().collect::<Vec<_>>().join(","),
        required.join(","),
        optional.iter().map(|name| format!("[,{name}]")).collect::<String>()
    );
    reader.deserialize().collect::<Result<_, _>>().with_context(|| format!("in {file}"))
}
