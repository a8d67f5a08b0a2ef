//! The program `heliostat` on the command line.

mod bench;
mod config;
mod doctor;
mod durations;
mod help;
mod json_errors;
mod link;
#[cfg(target_os = "linux")]
mod open_files;
#[cfg(target_os = "linux")]
mod output;

use std::process::{Command, Output};

/// Runs the program.
fn heliostat(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_heliostat")).args(arguments).output().expect("the program starts")
}
