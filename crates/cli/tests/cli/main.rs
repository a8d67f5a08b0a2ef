//! The program `heliostat` on the command line.

mod bench;
mod config;
mod doctor;
mod durations;
mod help;
mod link;
