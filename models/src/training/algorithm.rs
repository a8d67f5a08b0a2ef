//! The algorithms that `heliostat train` knows.
//!
//! To add one: write a file whose trainer implements [`Learner`], with [`RunSettings`](crate::learner::RunSettings) flattened into its settings; add a variant to
//! [`Algorithm`] and its arm to each method. Checkpoints, curve, card, held-out scores and the command line follow.

use anyhow::ensure;
use heliostat_decide::policy::PolicyKind;
use heliostat_scenario::Scenario;

use crate::learner::{Learner, with_options};
use crate::{analytic, ddpg, ddpg_basis, ddpg_raw, dql, q_learning, sarsa};

/// What can be trained.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Algorithm {
    /// Algorithm 1 of the paper with one weight a user as the action
    Ddpg,
    /// Algorithm 1 to the letter: the angles of all mirrors as the action
    DdpgRaw,
    /// The same with a critic that sees smooth patterns of the angles
    DdpgBasis,
    /// The network of ddpg, trained by the gradient through the channel itself
    Analytic,
    /// Deep Q-learning on a codebook of angles
    Dql,
    /// Q-learning with a table, on a codebook of angles
    QLearning,
    /// SARSA with a table, on a codebook of angles
    Sarsa,
}

/// Where the numbers of a run come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Preset {
    /// What the shipped actors were made with
    Tuned,
    /// The paper's networks, rates and buffer, where they differ
    Paper,
}

impl Algorithm {
    /// The policy that it trains; of the same name.
    pub fn policy(self) -> PolicyKind {
        match self {
            Self::Ddpg => PolicyKind::Ddpg,
            Self::DdpgRaw => PolicyKind::DdpgRaw,
            Self::DdpgBasis => PolicyKind::DdpgBasis,
            Self::Analytic => PolicyKind::Analytic,
            Self::Dql => PolicyKind::Dql,
            Self::QLearning => PolicyKind::QLearning,
            Self::Sarsa => PolicyKind::Sarsa,
        }
    }

    /// What it is, in one sentence and with the file that says more.
    pub fn summary(self) -> &'static str {
        match self {
            Self::Ddpg => "DDPG with one weight a user; departures from the paper at the head of `models/src/ddpg.rs`",
            Self::DdpgRaw => "DDPG on all angles, as in the paper; departures at the head of `models/src/ddpg_raw.rs`",
            Self::DdpgBasis => {
                "DDPG on all angles, seen by the critic as smooth patterns; departures from the paper at the heads of \
                 `models/src/ddpg_basis.rs` and `models/src/ddpg_raw.rs`"
            }
            Self::Analytic => {
                "the network of ddpg, trained by the gradient through the channel; see the head of `models/src/analytic.rs`"
            }
            Self::Dql => "deep Q-learning on a codebook; departures from the paper at the head of `models/src/dql.rs`",
            Self::QLearning => "Q-learning with a table on a codebook; see the head of `models/src/q_learning.rs`",
            Self::Sarsa => {
                "SARSA with a table on a codebook; see the heads of `models/src/sarsa.rs` and `models/src/q_learning.rs`"
            }
        }
    }

    /// A run at its beginning, with options of the form `key=value` applied to the preset.
    ///
    /// # Errors
    /// A scenario, preset or option that makes no sense.
    pub fn begin(self, scenario: Scenario, preset: Preset, options: &[String]) -> anyhow::Result<Box<dyn Learner>> {
        let (seed, mode, lamps) = (scenario.seed, scenario.channel.mode, scenario.led.positions_m.len());
        ensure!(
            preset == Preset::Tuned || self == Self::Ddpg,
            "--preset paper: only ddpg has numbers of the paper besides its own"
        );
        ensure!(lamps == 1, "an actor is made for one access point, but led.positions_m lists {lamps}");
        Ok(match self {
            Self::Ddpg => {
                let settings = match preset {
                    Preset::Tuned => ddpg::Settings::tuned(seed, mode),
                    Preset::Paper => ddpg::Settings::paper(seed),
                };
                Box::new(ddpg::Trainer::new(scenario, with_options(settings, options)?)?)
            }
            Self::DdpgRaw => {
                Box::new(ddpg_raw::Trainer::new(scenario, with_options(ddpg_raw::Settings::new(seed), options)?)?)
            }
            Self::DdpgBasis => {
                Box::new(ddpg_raw::Trainer::new(scenario, with_options(ddpg_basis::settings(seed), options)?)?)
            }
            Self::Analytic => {
                Box::new(analytic::Trainer::new(scenario, with_options(analytic::Settings::new(seed, mode), options)?)?)
            }
            Self::Dql => Box::new(dql::Trainer::new(scenario, with_options(dql::Settings::new(seed), options)?)?),
            Self::QLearning => {
                let settings = with_options(q_learning::Settings::new(seed, mode), options)?;
                Box::new(q_learning::Trainer::new(scenario, settings)?)
            }
            Self::Sarsa => {
                let settings = with_options(sarsa::settings(seed, mode), options)?;
                Box::new(q_learning::Trainer::new(scenario, settings)?)
            }
        })
    }
}
