//! Text files of bounded length: a device or a file of gigabytes must not fill the memory.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

/// Longest text in bytes: a recorded walk of some 2 million samples.
const BYTES_MAX: u64 = 64 << 20;

/// Reads a file of at most [`BYTES_MAX`] bytes.
pub(crate) fn read_text(path: &Path) -> io::Result<String> {
    let mut text = String::new();
    File::open(path)?.take(BYTES_MAX + 1).read_to_string(&mut text)?;
    if text.len() as u64 > BYTES_MAX {
        let message = format!("it is longer than {} MiB: expected a shorter text file", BYTES_MAX >> 20);
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, message));
    }
    Ok(text)
}
