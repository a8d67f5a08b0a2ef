//! SARSA with a table: [`crate::q_learning`], but an update counts on the entry that is really taken next, explored or not.
//!
//! ```text
//! Q(s, a) <- Q(s, a) + alpha [r + gamma Q(s', a') - Q(s, a)]
//! ```
//!
//! a' is drawn once, by the same epsilon-greedy rule, and then taken. All departures listed at the head of [`crate::q_learning`] hold here too.

use heliostat_scenario::ChannelMode;

use crate::q_learning::{Settings, Target};

/// The numbers of the shipped tables.
pub fn settings(seed: u64, mode: ChannelMode) -> Settings {
    Settings { target: Target::Taken, ..Settings::new(seed, mode) }
}
