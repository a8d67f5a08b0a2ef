//! The program `heliostat-lab` on the command line.

mod bench;
mod eval;
mod help;
mod map;
mod report;
mod trace;
mod train;

use std::process::{Command, Output};

/// Runs the program.
fn lab(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_heliostat-lab")).args(arguments).output().expect("the program starts")
}
