//! Scores of angles on states that training never uses.
//!
//! - [`held_out`]: held-out states, the oracle on them, and the score of a policy.
//! - [`statistics`]: means with confidence intervals.

pub mod held_out;
pub mod statistics;

pub use held_out::{HeldOut, Score};
pub use statistics::Estimate;
