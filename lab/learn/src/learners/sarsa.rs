//! SARSA with a table: [`super::q_learning`] with the value of the codeword that is taken next.
//!
//! ```text
//! Q(s, a) <- Q(s, a) + alpha [r + gamma Q(s', a') - Q(s, a)]
//! ```
//!
//! The epsilon-greedy rule draws a' once, and the next step takes it. All deviations listed at the
//! head of [`super::q_learning`] apply here too.

use heliostat_core::policy::PolicyKind;
use heliostat_scenario::ChannelMode;

use super::q_learning::{QLearning, Settings, Target};
use crate::training::algorithm::{Algorithm, start};

/// The row in the table of algorithms.
pub const ALGORITHM: Algorithm = Algorithm {
    name: "sarsa",
    policy: PolicyKind::Sarsa,
    help: "SARSA with a table, on a codebook of angles",
    summary: "SARSA with a table on a codebook; see the heads of `lab/learn/src/learners/sarsa.rs` and \
              `lab/learn/src/learners/q_learning.rs`",
    has_paper_preset: false,
    start: |scenario, _, options| {
        let settings = settings(scenario.seed, scenario.channel.mode);
        start(scenario, settings, options, QLearning::new)
    },
};

/// The hyperparameters of the shipped tables.
pub fn settings(seed: u64, mode: ChannelMode) -> Settings {
    Settings { target: Target::Taken, ..Settings::new(seed, mode) }
}
