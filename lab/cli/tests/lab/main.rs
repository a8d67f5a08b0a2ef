//! The program `heliostat-lab` on the command line.

mod bench;
mod eval;
mod help;
mod map;
mod report;
mod trace;
mod train;
