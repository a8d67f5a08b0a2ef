//! The controller from outside: reports in, decisions out, without a bus.

mod actor_files;
mod allocations;
mod deadlines;
mod decisions;
mod node;
mod observations;
mod policies;
mod reports;
mod support;
