//! The command line of Heliostat, and what the command line of the laboratory shares with it.
//!
//! - [`cli`]: the commands and their help; [`arguments`]: the command line as their arguments.
//! - [`commands`]: one module for each command; [`commands::bench`] and [`commands::mirrors`] are also
//!   for `heliostat-lab`.
//! - `one_process`: a controller and an array in one process.
//! - `platform`: what differs between operating systems.
//! - [`programs`]: the two programs as processes.

pub mod arguments;
pub mod cli;
pub mod commands;
mod one_process;
mod platform;
pub mod programs;

use std::process::ExitCode;

/// Runs the program `heliostat`.
pub fn main() -> ExitCode {
    arguments::run::<cli::Cli>(programs::HELIOSTAT, cli::run)
}
