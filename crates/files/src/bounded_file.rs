//! Files that a flag or a scenario names: a pipe without a writer must not hang a program, and a device or a file of
//! gigabytes must not fill the memory.

use std::ffi::OsStr;
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use crate::excerpt::CARRIAGE_RETURNS;
use crate::foreign_file::foreign_text;

/// Longest text in bytes: a recorded walk of some 2 million samples.
const TEXT_MAX: u64 = 64 << 20;

/// Opens a file.
///
/// # Errors
/// What the operating system reports, a folder, or a pipe outside `/dev`, which may never have a writer.
#[allow(clippy::disallowed_methods, reason = "the one place that opens the files of a flag or a scenario")]
pub fn open_file(path: &Path) -> io::Result<File> {
    let kind = std::fs::metadata(path).map_err(|error| with_hint(error, path))?.file_type();
    if kind.is_dir() {
        return Err(io::Error::new(io::ErrorKind::IsADirectory, "it is a folder: expected a file"));
    }
    if !(kind.is_file() || path.starts_with("/dev") || path.starts_with("/proc")) {
        return Err(io::Error::other("it is no regular file: expected one, or /dev/stdin for a pipe"));
    }
    File::open(path)
}

/// The error of a path that a shell would have completed: none does so in a file, or behind the `=` of a flag.
fn with_hint(error: io::Error, path: &Path) -> io::Error {
    let is_of_shell = |part: &OsStr| part == "~" || part.to_string_lossy().starts_with('$');
    if error.kind() == io::ErrorKind::NotFound && path.iter().any(is_of_shell) {
        return io::Error::new(
            error.kind(),
            format!("{error}; ~ and $ stay as they are here: write the folder itself"),
        );
    }
    error
}

/// Reads a file of at most so many bytes, which are some MiB.
///
/// # Errors
/// As of [`open_file`], or a longer file.
pub fn read_bytes(path: &Path, bytes_max: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    open_file(path)?.take(bytes_max + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > bytes_max {
        let message = format!("it is longer than {} MiB: expected a shorter file", bytes_max >> 20);
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, message));
    }
    Ok(bytes)
}

/// Reads a text file of at most 64 MiB, without the byte order mark that some editors write.
///
/// # Errors
/// As of [`read_bytes`], the place of the first byte that is not UTF-8, or a text in which CR alone ends the lines:
/// for a parser it would be one line.
pub fn read_text(path: &Path) -> io::Result<String> {
    let bytes = read_bytes(path, TEXT_MAX)?;
    let text =
        String::from_utf8(bytes).map_err(|error| not_utf8(error.as_bytes(), error.utf8_error().valid_up_to()))?;
    if text.contains('\r') && !text.contains('\n') {
        return Err(io::Error::new(io::ErrorKind::InvalidData, CARRIAGE_RETURNS));
    }
    Ok(text.strip_prefix('\u{feff}').map(str::to_owned).unwrap_or(text))
}

/// The place of the first invalid byte, both counted from 1.
fn not_utf8(bytes: &[u8], valid: usize) -> io::Error {
    if let Some(what) = foreign_text(bytes) {
        return io::Error::new(io::ErrorKind::InvalidData, format!("it {what}"));
    }
    let before = &bytes[..valid];
    let line = 1 + before.iter().filter(|byte| **byte == b'\n').count();
    let in_line = before.iter().rev().take_while(|byte| **byte != b'\n').count();
    let message = format!(
        "it is not UTF-8 at line {line}, byte {}: expected a text in UTF-8; save it again in this encoding",
        in_line + 1
    );
    io::Error::new(io::ErrorKind::InvalidData, message)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(bytes: &[u8]) -> io::Result<String> {
        let file = tempfile::NamedTempFile::new().expect("a file");
        std::fs::write(file.path(), bytes).expect("written");
        read_text(file.path())
    }

    #[test]
    fn a_path_that_a_shell_would_complete_is_refused_with_what_to_do() {
        for path in ["~/walk.csv", "rooms/$HOME/walk.csv"] {
            let error = open_file(Path::new(path)).expect_err("no such file");
            assert_eq!(error.kind(), io::ErrorKind::NotFound);
            assert!(error.to_string().ends_with("~ and $ stay as they are here: write the folder itself"), "{error}");
        }
        let error = open_file(Path::new("nowhere/walk.csv")).expect_err("no such file");
        assert!(error.raw_os_error().is_some(), "{error}");
    }

    #[test]
    fn a_folder_is_refused_as_such() {
        let folder = tempfile::tempdir().expect("a folder");
        let error = read_bytes(folder.path(), 1).expect_err("a folder");
        assert_eq!(
            (error.kind(), error.to_string().as_str()),
            (io::ErrorKind::IsADirectory, "it is a folder: expected a file")
        );
    }

    #[cfg(unix)]
    #[test]
    fn what_is_no_regular_file_is_refused_before_it_is_opened() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("room.toml");
        let _socket = std::os::unix::net::UnixListener::bind(&path).expect("a socket");
        assert!(read_text(&path).expect_err("refused").to_string().contains("no regular file"));
    }

    #[test]
    fn a_text_whose_lines_end_with_cr_alone_is_refused_with_the_line_ends_to_use() {
        let message = read(b"[users]\rcount = 2\r").expect_err("refused").to_string();
        assert_eq!(message, CARRIAGE_RETURNS);
        for text in ["[users]\r\ncount = 2\r\n", "[users]\ncount = 2\n", "seed = 2"] {
            assert_eq!(read(text.as_bytes()).expect("a text"), text);
        }
    }

    #[test]
    fn a_byte_that_is_not_utf8_is_named_by_its_place_and_a_byte_order_mark_is_left_out() {
        let message = |bytes: &[u8]| read(bytes).expect_err("refused").to_string();
        assert!(message(b"name = \"\xfc\"").contains("line 1, byte 9"));
        assert!(message(b"a\n\nb\xe4").contains("line 3, byte 2"));
        assert_eq!(message(b"\xff\xfea\0"), "it is text in UTF-16, expected a text in UTF-8: save it in UTF-8");
        assert_eq!(read(b"\xef\xbb\xbfa = 1\r\n").expect("text"), "a = 1\r\n");
    }
}
