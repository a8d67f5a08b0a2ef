//! Scores of angles on states that training never uses.
//!
//! - [`held_out`]: held-out states, the oracle on them, and the score of a policy.
//! - [`Estimate`]: means with confidence intervals.

pub mod held_out;

pub use held_out::{HeldOut, Score};
pub use heliostat_environment::statistics::Estimate;
