//! The true evaluation of angles in a state.

use heliostat_channel::link::{ber_ook, jain};
use heliostat_channel::{ChannelModel, MirrorAngles, Scene};
use heliostat_environment::outage::OutageLog;
use heliostat_room::World;

use super::belief_log::Errors;
use super::tracked_user::TrackedUser;
use crate::evaluation::held_out::met;

/// The evaluation of angles in one state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Sample {
    /// Sum of the users' rates in Mbit/s.
    pub sum_rate_mbps: f64,
    /// Share of users whose minimum rate is met; NaN without users.
    pub met: f64,
    /// Jain's fairness index of the rates.
    pub jain: f64,
    /// Mean rate of the users without a direct path, in Mbit/s; NaN without such a user.
    pub blocked_rate_mbps: f64,
    /// Mean bit error rate of the users with on-off keying.
    pub ber: f64,
}

impl Sample {
    /// The mean of several samples of one state.
    pub fn mean(samples: &[Self]) -> Self {
        let mean = |value: fn(&Self) -> f64| samples.iter().map(value).sum::<f64>() / samples.len() as f64;
        Self {
            sum_rate_mbps: mean(|sample| sample.sum_rate_mbps),
            met: mean(|sample| sample.met),
            jain: mean(|sample| sample.jain),
            blocked_rate_mbps: mean(|sample| sample.blocked_rate_mbps),
            ber: mean(|sample| sample.ber),
        }
    }
}

/// A policy's samples in all states, group by group, and the time of each decision in us.
#[derive(Default)]
pub(super) struct Run {
    pub groups: Vec<Vec<Sample>>,
    pub decisions_us: Vec<f64>,
    /// In closed loop, the outages of each episode.
    pub outages: Vec<OutageLog>,
    /// In closed loop, the errors of the belief in each episode.
    pub belief: Vec<Errors>,
    /// In closed loop, the users of the first episode as a filter believes them to be.
    pub tracked: Vec<TrackedUser>,
}

impl Run {
    /// One run whose samples are the means over several runs on the same states.
    pub fn mean(mut runs: Vec<Self>) -> Self {
        let decisions_us = runs.iter_mut().flat_map(|run| std::mem::take(&mut run.decisions_us)).collect();
        let outages = runs.iter_mut().flat_map(|run| std::mem::take(&mut run.outages)).collect();
        let belief = runs.iter_mut().flat_map(|run| std::mem::take(&mut run.belief)).collect();
        let tracked = runs.first_mut().map(|run| std::mem::take(&mut run.tracked)).unwrap_or_default();
        let same = |group: usize, state: usize| {
            Sample::mean(&runs.iter().map(|run| run.groups[group][state]).collect::<Vec<_>>())
        };
        let groups = runs.first().map_or(&[][..], |run| &run.groups);
        let groups = groups.iter().enumerate();
        Self {
            groups: groups.map(|(group, states)| (0..states.len()).map(|state| same(group, state)).collect()).collect(),
            decisions_us,
            outages,
            belief,
            tracked,
        }
    }
}

/// Evaluates angles with the complete channel: spill, the LED's panel and blocked paths.
pub(crate) struct Evaluator {
    model: ChannelModel,
    rates: Rates,
}

/// Buffers with one entry per user.
struct Rates {
    min_rate_bps: Vec<f64>,
    sinr: Vec<f64>,
    rates_bps: Vec<f64>,
}

impl Evaluator {
    /// An evaluator for a channel and the users' minimum rates.
    pub fn new(model: ChannelModel, min_rate_bps: Vec<f64>) -> Self {
        let users = min_rate_bps.len();
        Self { model, rates: Rates { min_rate_bps, sinr: vec![0.0; users], rates_bps: vec![0.0; users] } }
    }

    pub fn model(&self) -> &ChannelModel {
        &self.model
    }

    /// Evaluates angles in a world, with its users and its true equipment. Without users the sum
    /// rate is 0, and the shares and means over users are NaN.
    pub fn evaluate_world(&mut self, world: &World, angles: &MirrorAngles) -> Sample {
        let users = world.scene().users();
        self.rates.min_rate_bps.clear();
        self.rates.min_rate_bps.extend_from_slice(world.min_rate_bps());
        self.rates.sinr.resize(users, 0.0);
        self.rates.rates_bps.resize(users, 0.0);
        let sample = self.rates.sample(world.model(), world.scene(), angles);
        if users > 0 { sample } else { Sample { jain: f64::NAN, ..sample } }
    }

    /// Whether each user was below the minimum rate in the last evaluation. Shape: K.
    pub fn below_minimum(&self) -> impl Iterator<Item = bool> + Clone {
        self.rates.rates_bps.iter().zip(&self.rates.min_rate_bps).map(|(rate, least)| rate < least)
    }

    /// Evaluates angles in one state.
    pub fn evaluate(&mut self, scene: &Scene, angles: &MirrorAngles) -> Sample {
        self.rates.sample(&self.model, scene, angles)
    }
}

impl Rates {
    fn sample(&mut self, model: &ChannelModel, scene: &Scene, angles: &MirrorAngles) -> Sample {
        scene.sinr(model, angles, &mut self.sinr);
        let users = self.sinr.len();
        for (rate, sinr) in self.rates_bps.iter_mut().zip(&self.sinr) {
            *rate = model.budget.rate_bps(*sinr, users);
        }
        let blocked = self.rates_bps.iter().zip(scene.los_blocked()).filter(|(_, blocked)| **blocked);
        let (sum, count) = blocked.fold((0.0, 0.0), |(sum, count), (rate, _)| (sum + rate, count + 1.0));
        Sample {
            sum_rate_mbps: 1e-6 * self.rates_bps.iter().sum::<f64>(),
            met: met(&self.rates_bps, &self.min_rate_bps),
            jain: jain(&self.rates_bps),
            // Without a blocked user this is 0 / 0, NaN as documented.
            blocked_rate_mbps: 1e-6 * sum / count,
            ber: self.sinr.iter().map(|sinr| ber_ook(*sinr)).sum::<f64>() / users as f64,
        }
    }
}
