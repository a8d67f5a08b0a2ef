//! One module for each command, and functions that several of them share.

use std::fs::File;
use std::io::Read;

use anyhow::{Context, Result, ensure};
use serde::de::DeserializeOwned;

pub mod bench;
pub mod calibrate;
pub mod completions;
pub mod config;
pub mod demo;
pub mod doctor;
mod drawn_room;
pub mod eval;
pub mod keys;
pub mod link;
pub mod map;
mod mirrors;
mod own_program;
pub mod results;
pub mod scenario;
pub mod stop;
pub mod trace;
pub mod ui;
mod whole_file;

/// Longest CSV file in bytes; the longest useful one has a line for each mirror.
const CSV_BYTES_MAX: u64 = 16 << 20;
/// Characters of a header that an error quotes.
const HEADER_QUOTED: usize = 200;

/// Reads a CSV file whose header names all `required` columns, any `optional` ones, and no others.
fn read_csv<T: DeserializeOwned>(file: &str, required: &[&str], optional: &[&str]) -> Result<Vec<T>> {
    let mut bytes = Vec::new();
    let read = File::open(file).and_then(|file| file.take(CSV_BYTES_MAX + 1).read_to_end(&mut bytes));
    read.with_context(|| format!("cannot read {file}"))?;
    let length = bytes.len() as u64;
    ensure!(length <= CSV_BYTES_MAX, "{file} is longer than {} MiB; expected a shorter file", CSV_BYTES_MAX >> 20);
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).comment(Some(b'#')).from_reader(&bytes[..]);
    let header = reader.headers().with_context(|| format!("in {file}"))?;
    let known = header.iter().all(|name| required.contains(&name) || optional.contains(&name));
    let complete = required.iter().all(|name| header.iter().any(|found| found == *name));
    ensure!(
        known && complete,
        "in {file}: the header is \"{}\"; expected {}{}",
        header.iter().collect::<Vec<_>>().join(",").chars().take(HEADER_QUOTED).collect::<String>(),
        required.join(","),
        optional.iter().map(|name| format!("[,{name}]")).collect::<String>()
    );
    reader.deserialize().collect::<Result<_, _>>().with_context(|| format!("in {file}"))
}
