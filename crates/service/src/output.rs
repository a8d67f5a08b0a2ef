//! Standard output and standard error: the only places where a process writes text for a user.
//!
//! Results go to standard output, notes and errors to standard error. All text is made
//! [`printable`](crate::printable) here, because it may quote a message or a file.

use std::fmt::Display;
use std::io::{self, Write};

use crate::printable::printable_lines;

/// `println!` that returns an error instead of a panic when the reader has closed the pipe.
#[macro_export]
macro_rules! outln {
    () => { $crate::output::line("") };
    ($($argument:tt)*) => { $crate::output::line(format_args!($($argument)*)) };
}

/// Writes a text and a line end to standard output.
///
/// # Errors
/// The reader has closed the pipe; `println!` would panic then.
pub fn line(text: impl Display) -> io::Result<()> {
    write_text(&mut io::stdout().lock(), format_args!("{text}\n"))
}

/// Writes a text that ends its last line itself to standard output.
///
/// # Errors
/// As [`line()`].
pub fn text(text: impl Display) -> io::Result<()> {
    write_text(&mut io::stdout().lock(), text)
}

/// Writes a text and a line end to standard error. A closed standard error is ignored.
pub fn note(text: impl Display) {
    drop(write_text(&mut io::stderr().lock(), format_args!("{text}\n")));
}

fn write_text(out: &mut impl Write, text: impl Display) -> io::Result<()> {
    out.write_all(printable_lines(&text.to_string()).as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_stay_and_escape_sequences_do_not() {
        for (text, expected) in [("a\nb\n", "a\nb\n"), ("\u{1b}[2J", "\\u001b[2J"), ("", "")] {
            let mut out = Vec::new();
            write_text(&mut out, text).expect("memory takes everything");
            assert_eq!(String::from_utf8_lossy(&out), expected);
        }
    }
}
