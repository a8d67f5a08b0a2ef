//! What every process of the project shares.
//!
//! - [`clock`]: UTC and monotonic time in ns.
//! - [`locks`]: locks that survive a panic of another thread.
//! - [`source_id`]: the random number by which others know one publisher.
//! - [`stop`]: a request that a process ends, and what waits for it.
//! - [`signals`]: Ctrl-C, SIGTERM and the end of standard input, as such a request.
//! - [`duration`]: durations on the command line.
//! - [`logging`]: logs to standard error, as text or as JSON.
//! - [`log_limit`]: bounds the lines of a lasting problem, and of a flood of events.
//! - [`output`]: text for a user on standard output and standard error.
//! - [`input`]: text files that a flag names.
//! - [`whole_file`]: files that are complete, or not there.
//! - [`file_id`]: whether a path still leads to the same file.
//! - [`printable`]: text from messages and files, made safe for a terminal.
//! - [`process`]: memory, files and threads of this process, its limit of open files, and the name of its machine.
//! - [`page`]: counters, gauges and histograms of one moment, in the OpenMetrics text format.
//! - [`exporter`]: serves the newest page under `/metrics`.
//! - [`http`]: the HTTP server below the metrics page and the live page, with its limits.
//! - [`exit`]: the exit codes of every program and command.
//!
//! The pure crates (ARCHITECTURE.md, invariant 2) do not depend on this crate. No decision waits for a server: each server runs on a thread of its own.

pub mod clock;
pub mod counted;
pub mod duration;
pub mod exit;
pub mod exporter;
pub mod file_id;
pub mod http;
pub mod input;
pub mod locks;
pub mod log_limit;
pub mod logging;
pub mod output;
pub mod page;
pub mod printable;
pub mod process;
pub mod signals;
pub mod source_id;
pub mod stop;
pub mod terminal;
mod waiting;
pub mod whole_file;

pub use exporter::{Exporter, MetricsArgs, MetricsError};
pub use logging::{LogArgs, LogFormat, LogGuard};
pub use page::{Histogram, Page};
pub use signals::EndArgs;
pub use stop::Stop;
