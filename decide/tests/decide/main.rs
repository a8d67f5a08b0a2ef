//! The decision core from outside: reports in, decisions out.

mod actor_files;
mod allocations;
mod beliefs;
mod deadlines;
mod decisions;
mod epochs;
mod memory;
mod observations;
mod policies;
mod reports;
mod support;
mod users;
