//! The paper's figures from one command: what this project finds, beside what the paper says, with seeds, intervals and verdicts.
//!
//! Nothing is computed here that another crate computes: rates, policies, oracles and closed loops are those of `heliostat-models`, rooms those of
//! `heliostat-sim-node`. This crate chooses what to run, keeps what is finished, judges and draws.
//!
//! # From the command to the report
//! - [`args`]: the command line, and everything that can be refused before long work starts.
//! - [`effort`]: how much is computed.
//! - [`figures`]: one file a figure: its parts, and the picture from finished parts.
//! - [`part`], [`store`]: a part is named by all that it depends on, and kept on disk when it is finished.
//! - [`run`]: estimate, progress, and the parts one by one.
//! - [`command`]: the command that makes a report or a figure again.
//! - [`claims`]: every statement of the paper with a verdict.
//! - [`report`], [`page`], [`document`]: JSON, CSV and SVG files, the page, and docs/results/reproduction.md.
//! - [`figure`](mod@figure), [`draw`], [`statistics`], [`machine`], [`over_floor`](mod@over_floor): what these share.

pub mod args;
pub mod claims;
pub mod command;
pub mod document;
pub mod draw;
pub mod effort;
pub mod figure;
pub mod figures;
pub mod machine;
pub mod over_floor;
pub mod page;
pub mod part;
pub mod report;
pub mod run;
#[cfg(test)]
mod sources;
pub mod statistics;
pub mod store;
mod training;

pub use args::ReproduceArgs;
pub use run::run_reproduce;
