//! Standard output and standard error: the only places where a process writes text for a user.
//!
//! Results go to standard output, notes and errors to standard error. All text is made
//! [`printable`](crate::printable) here, because it may quote a message or a file.

use std::fmt::Display;
use std::io::{self, Write};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::printable::printable_lines;

/// Whether the last text on standard output is an object in JSON.
static ENDS_WITH_OBJECT: AtomicBool = AtomicBool::new(false);
/// What also takes the error that ends this process.
static ERROR_REPORT: OnceLock<fn(&str)> = OnceLock::new();

/// `println!` that returns an error instead of a panic where standard output cannot be written.
#[macro_export]
macro_rules! outln {
    () => { $crate::output::line("") };
    ($($argument:tt)*) => { $crate::output::line(format_args!($($argument)*)) };
}

/// Writes a text and a line end to standard output. A reader that has closed it, such as `head`, is no error: the
/// command goes on, and its exit code is that of its work.
///
/// # Errors
/// The text cannot be written, for example because the disk is full; `println!` would panic then.
pub fn line(text: impl Display) -> io::Result<()> {
    self::text(format_args!("{text}\n"))
}

/// Writes a text that ends its last line itself to standard output.
///
/// # Errors
/// As [`line()`].
pub fn text(text: impl Display) -> io::Result<()> {
    unless_closed(write_result(text))
}

/// Writes a text and a line end to standard output; to standard error too where standard output does not take it.
///
/// # Errors
/// As [`line()`].
pub fn outcome(text: impl Display) -> io::Result<()> {
    let written = write_result(format_args!("{text}\n"));
    if written.is_err() {
        note(text);
    }
    unless_closed(written)
}

/// Whether the last text on standard output is an object in JSON, which a reader of JSON expects to be the only one or
/// the last.
pub fn ends_with_object() -> bool {
    ENDS_WITH_OBJECT.load(Ordering::Relaxed)
}

fn is_object(text: &str) -> bool {
    text.starts_with('{') && text.trim_end().ends_with('}')
}

/// Writes bytes as they are to standard output, for another program.
///
/// # Errors
/// As [`line()`].
pub fn bytes(bytes: &[u8]) -> io::Result<()> {
    flushed(io::stdout().lock().write_all(bytes))
}

/// The result of a write to standard output, with what is still in its buffer.
///
/// # Errors
/// As [`line()`].
pub fn flushed(written: io::Result<()>) -> io::Result<()> {
    unless_closed(complete(written))
}

fn write_result(text: impl Display) -> io::Result<()> {
    let text = text.to_string();
    ENDS_WITH_OBJECT.store(is_object(&text), Ordering::Relaxed);
    complete(write_text(&mut io::stdout().lock(), text))
}

fn complete(written: io::Result<()>) -> io::Result<()> {
    written.and_then(|()| io::stdout().flush()).map_err(|error| unwritten(&error))
}

/// The result of a write, whose reader may have gone.
fn unless_closed(written: io::Result<()>) -> io::Result<()> {
    match written {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        written => written,
    }
}

/// Writes a text and a line end to standard error. A closed standard error is ignored.
pub fn note(text: impl Display) {
    drop(write_text(&mut io::stderr().lock(), format_args!("{text}\n")));
}

/// Has `report` called with the error that ends this process, after it is written to standard error. Only the first call
/// has an effect.
pub fn also_report_error(report: fn(&str)) {
    // A second one is that of the same program.
    let _ = ERROR_REPORT.set(report);
}

/// Writes the error that ends this process to standard error, with the name of its program.
pub fn error(program: &str, text: &str) {
    note(format_args!("{program}: {text}"));
    if let Some(report) = ERROR_REPORT.get() {
        report(text);
    }
}

/// The error of a write to standard output: its kind stays, which tells a closed pipe from a full disk.
fn unwritten(error: &io::Error) -> io::Error {
    io::Error::new(error.kind(), format!("cannot write to standard output: {error}"))
}

fn write_text(out: &mut impl Write, text: impl Display) -> io::Result<()> {
    out.write_all(printable_lines(&text.to_string()).as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_of_standard_output_names_it_and_keeps_its_kind() {
        let error = unwritten(&io::Error::new(io::ErrorKind::StorageFull, "no space"));
        assert_eq!(error.to_string(), "cannot write to standard output: no space");
        assert_eq!(error.kind(), io::ErrorKind::StorageFull);
        assert!(unless_closed(Err(error)).is_err());
        assert!(unless_closed(Err(unwritten(&io::ErrorKind::BrokenPipe.into()))).is_ok());
    }

    #[test]
    fn an_object_is_told_from_other_texts() {
        for (text, expected) in
            [("{\"a\": 1}\n", true), ("{}\n", true), ("{ a\n", false), ("a {}\n", false), ("", false)]
        {
            assert_eq!(is_object(text), expected, "{text}");
        }
    }

    #[test]
    fn lines_stay_and_escape_sequences_do_not() {
        for (text, expected) in [("a\nb\n", "a\nb\n"), ("\u{1b}[2J", "\\u001b[2J"), ("", "")] {
            let mut out = Vec::new();
            write_text(&mut out, text).expect("memory takes everything");
            assert_eq!(String::from_utf8_lossy(&out), expected);
        }
    }
}
