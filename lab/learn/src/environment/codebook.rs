//! Codebooks: the actions of the learners that choose among a fixed number of them.
//!
//! The paper's deep Q-learning acts by "the quantization of the angle values" and gives no further
//! detail. Quantised angles of each mirror are too many: five values an axis make 25^100 actions.
//! Here the action is one codeword, which sets the angles of all mirrors. A table or the output
//! layer of a network can then hold a value for each codeword:
//!
//! [`codewords`](mod@heliostat_core::policy::codewords) defines them: 5 x 5 angles that all
//! mirrors share in the paper's modes, and in `specular` all mirrors aimed at one of 144 grid
//! points, 12 x 12 over the floor ([`GRID`]).
//!
//! The codebook upper bound is the score of the best codeword in each state. The policy
//! [`BestCodeword`] finds it by evaluating every codeword; in comparisons it is `codebook`.
//! `lab/learn/experiments.md` compares several codebooks.

use heliostat_channel::solver::QOS_PENALTY;
use heliostat_channel::{ChannelModel, MirrorAngles};
use heliostat_core::observation::Observation;
pub use heliostat_core::policy::codewords::GRID;
use heliostat_core::policy::codewords::{codewords, coordinates};
use heliostat_core::policy::{Policy, PolicyResult};
use heliostat_scenario::{ChannelMode, Scenario};

use super::room::{Environment, Outcome, Reward};

/// The actions of a learner; each codeword has the angles of all mirrors.
#[derive(Clone, Debug, PartialEq)]
pub struct Codebook {
    codewords: Vec<MirrorAngles>,
    coordinates: Vec<[f32; 2]>,
    kind: &'static str,
}

impl Codebook {
    /// The codebook for a scenario's mode and geometry; every angle lies within the range of its
    /// mirrors.
    ///
    /// # Errors
    /// The scenario describes no channel.
    pub fn of(scenario: &Scenario) -> anyhow::Result<Self> {
        let model = scenario.channel_model()?;
        let kind = match scenario.channel.mode {
            ChannelMode::Specular => "the array aimed at a point of a 12 x 12 grid",
            ChannelMode::Paper | ChannelMode::PaperCalibrated => "5 x 5 angles common to all mirrors",
        };
        Ok(Self { codewords: codewords(scenario, &model), coordinates: coordinates(scenario.channel.mode), kind })
    }

    /// The angles of each codeword.
    pub fn codewords(&self) -> &[MirrorAngles] {
        &self.codewords
    }

    /// The coordinates of each codeword in the codebook's grid, from its middle: along x and y, or
    /// in steps of yaw and roll.
    pub fn coordinates(&self) -> &[[f32; 2]] {
        &self.coordinates
    }

    /// A short description of the codebook.
    pub fn kind(&self) -> &'static str {
        self.kind
    }

    /// Applies a codeword in a room. Returns the reward minus that of flat mirrors, over the
    /// bandwidth, and the codeword's own outcome.
    pub fn act(&self, environment: &mut Environment, codeword: usize, reward: Reward) -> (f32, Outcome) {
        let (users, mirrors) = (environment.users(), environment.observation().mirrors());
        let mut parts = vec![0.0; users];
        environment.act(&MirrorAngles::flat(mirrors), reward, &mut parts);
        let flat: f32 = parts.iter().sum();
        let outcome = environment.act(&self.codewords[codeword], reward, &mut parts);
        ((parts.iter().sum::<f32>() - flat) / users as f32, outcome)
    }

    /// The codeword with the largest true [`objective_bps`] in a state, found by evaluating each.
    pub fn best(&self, model: &ChannelModel, seen: &Observation) -> &MirrorAngles {
        let mut rates_bps = vec![0.0; seen.users()];
        let mut objective = |angles: &MirrorAngles| {
            seen.scene.rates_bps(model, angles, &mut rates_bps);
            objective_bps(&rates_bps, &seen.min_rate_bps)
        };
        let mut best = (&self.codewords[0], objective(&self.codewords[0]));
        for codeword in &self.codewords[1..] {
            let value = objective(codeword);
            if value > best.1 {
                best = (codeword, value);
            }
        }
        best.0
    }
}

/// The policy that gives the codebook upper bound: it evaluates every codeword in each state.
pub struct BestCodeword {
    codebook: Codebook,
}

impl BestCodeword {
    /// The policy for a scenario.
    ///
    /// # Errors
    /// As [`Codebook::of`].
    pub fn new(scenario: &Scenario) -> anyhow::Result<Self> {
        Ok(Self { codebook: Codebook::of(scenario)? })
    }
}

/// The objective of the oracle in bit/s: sum_k [R_k - rho max(0, R_min,k - R_k)] with rho =
/// [`QOS_PENALTY`].
pub fn objective_bps(rates_bps: &[f64], min_rate_bps: &[f64]) -> f64 {
    let pairs = rates_bps.iter().zip(min_rate_bps);
    pairs.map(|(rate, min_rate)| rate - QOS_PENALTY * (min_rate - rate).max(0.0)).sum()
}

impl Policy for BestCodeword {
    fn name(&self) -> &str {
        "codebook"
    }

    fn act(&mut self, model: &ChannelModel, seen: &Observation, out: &mut MirrorAngles) -> PolicyResult {
        out.clone_from(self.codebook.best(model, seen));
        Ok(())
    }
}
