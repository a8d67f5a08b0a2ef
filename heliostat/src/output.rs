//! Standard output. A reader such as `head` may close it at any time: this ends the command without
//! an error.

use std::fmt::Arguments;
use std::io::{self, Write};

/// Prints a line; see [`outln!`].
pub fn line(text: Arguments) -> io::Result<()> {
    let mut out = io::stdout().lock();
    out.write_fmt(text)?;
    out.write_all(b"\n")
}

/// `println!` that returns an error instead of a panic.
macro_rules! outln {
    () => { $crate::output::line(format_args!("")) };
    ($($argument:tt)*) => { $crate::output::line(format_args!($($argument)*)) };
}
pub(crate) use outln;
