//! Reproduces the figures of the paper with one command: results, the paper's values, seeds,
//! intervals and verdicts.
//!
//! Rates, policies, oracles and closed loops come from `heliostat-learn`, rooms from
//! `heliostat-sim-node`. This crate selects the computations, stores finished parts, derives
//! verdicts and draws.
//!
//! # From the command line to the report
//! - [`args`]: the command line, and the checks before long computations.
//! - [`effort`], [`plan`]: sizes, seeds and rooms.
//! - [`figures`]: one file for each figure: its parts, and the figure from finished parts.
//! - [`part`], [`job`], [`store`]: a part has a key of all its inputs, and is stored on disk when
//!   it is finished.
//! - [`run`]: estimate, progress, and the computation of the parts.
//! - [`progress`]: how far a run is when it is interrupted.
//! - [`command`]: the command that reproduces a figure.
//! - [`claims`]: the statements of the paper, each with a verdict.
//! - [`report`], [`files`], [`document`]: the result, its files, and its text, which is also
//!   docs/results/reproduction.md.
//! - [`figure`](mod@figure), [`draw`], [`statistics`], [`machine`], [`over_floor`](mod@over_floor):
//!   shared by the modules above.

pub mod args;
pub mod claims;
pub mod command;
pub mod document;
pub mod draw;
pub mod effort;
pub mod figure;
pub mod figures;
pub mod files;
pub mod job;
pub mod machine;
pub mod over_floor;
pub mod part;
pub mod plan;
pub mod progress;
pub mod report;
pub mod run;
#[cfg(test)]
mod sources;
pub mod statistics;
pub mod store;
pub mod verdict;

pub use args::ReproduceArgs;
pub use progress::Progress;
pub use run::run_reproduce;
