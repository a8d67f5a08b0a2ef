//! The program `heliostat` on the command line.

mod bench;
mod config;
mod doctor;
mod durations;
mod help;
mod link;
#[cfg(target_os = "linux")]
mod output;
