//! Lines on standard output. A reader such as `head` may close it at any time: this ends the
//! command without an error.

/// `println!` that returns an error instead of a panic.
macro_rules! outln {
    () => { heliostat_service::output::line("") };
    ($($argument:tt)*) => { heliostat_service::output::line(format_args!($($argument)*)) };
}
pub(crate) use outln;
