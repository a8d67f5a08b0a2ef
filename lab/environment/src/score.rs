//! The true evaluation of angles in a state, and the figures of a comparison from such samples.

use heliostat_channel::link::{ber_ook, jain};
use heliostat_channel::solver::Solver;
use heliostat_channel::{ChannelModel, MirrorAngles, Scene};
use heliostat_room::World;
use heliostat_scenario::Scenario;

use crate::error::EnvironmentError;
use crate::held_out::{best_angles, held_out_world, met};
use crate::statistics::{Spread, mean, present};

/// The evaluation of angles in one state, with the true users and equipment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Sum of the users' rates in Mbit/s; 0 without users.
    pub sum_rate_mbps: f64,
    /// Share of users whose minimum rate is met; NaN without users.
    pub met: f64,
    /// Jain's fairness index of the rates; NaN where no user has a rate.
    pub jain: f64,
    /// Mean rate of the users without a direct path, in Mbit/s; NaN without such a user.
    pub blocked_rate_mbps: f64,
    /// Mean bit error rate of the users with on-off keying; NaN without users.
    pub ber: f64,
}

impl Sample {
    /// The evaluation of angles in the present state of a world.
    pub fn of(world: &World, angles: &MirrorAngles) -> Self {
        Rates::default().sample_world(world, angles)
    }

    /// The oracle in the state `index` of the set `set` of held-out rooms; see [`held_out_world`].
    ///
    /// # Errors
    /// As [`held_out_world`].
    pub fn of_oracle(
        scenario: &Scenario,
        trace: Option<&str>,
        (set, index): (u64, u64),
    ) -> Result<Self, EnvironmentError> {
        let world = held_out_world(scenario, trace, set, index)?;
        let mut solver = Solver::new(world.scene().users().max(1), scenario.mirror_count());
        let angles = best_angles(&mut solver, world.model(), world.scene(), world.min_rate_bps());
        Ok(Self::of(&world, &angles))
    }

    /// The values in the order of the fields.
    pub fn row(&self) -> [f64; 5] {
        let Self { sum_rate_mbps, met, jain, blocked_rate_mbps, ber } = *self;
        [sum_rate_mbps, met, jain, blocked_rate_mbps, ber]
    }

    /// The sample with these values in the order of the fields.
    pub fn of_row([sum_rate_mbps, met, jain, blocked_rate_mbps, ber]: [f64; 5]) -> Self {
        Self { sum_rate_mbps, met, jain, blocked_rate_mbps, ber }
    }

    /// The mean of several samples of one state; each figure leaves out the samples without it.
    pub fn mean(samples: &[Self]) -> Self {
        let mean = |value: fn(&Self) -> f64| mean(&present(&samples.iter().map(value).collect::<Vec<_>>()));
        Self {
            sum_rate_mbps: mean(|sample| sample.sum_rate_mbps),
            met: mean(|sample| sample.met),
            jain: mean(|sample| sample.jain),
            blocked_rate_mbps: mean(|sample| sample.blocked_rate_mbps),
            ber: mean(|sample| sample.ber),
        }
    }
}

/// A figure of a comparison.
#[derive(Clone, Copy)]
pub struct Figure {
    /// Its name in JSON and in CSV files.
    pub name: &'static str,
    /// Its value in a state, from the samples of a policy and of the oracle; NaN is a missing value.
    pub of: fn(&Sample, &Sample) -> f64,
    /// Smallest and largest value that it can have.
    bounds: (f64, f64),
}

/// The bounds of a rate or a ratio. An angle by the oracle is not the best one under drives and latency, so a ratio
/// has no upper bound.
const FROM_0: (f64, f64) = (0.0, f64::INFINITY);

/// The bounds of a share.
const SHARE: (f64, f64) = (0.0, 1.0);

impl Figure {
    /// Sum rate in Mbit/s.
    pub const SUM_RATE: Self = Self { name: "sum_rate_mbps", of: |own, _| own.sum_rate_mbps, bounds: FROM_0 };
    /// Sum rate over that of the oracle; missing where the oracle serves no user.
    pub const RATIO: Self = Self { name: "ratio_to_oracle", of: ratio, bounds: FROM_0 };
    /// Share of users whose minimum rate is met.
    pub const QOS_MET: Self = Self { name: "qos_met", of: |own, _| own.met, bounds: SHARE };
    /// Jain's fairness index of the rates; missing where no user has a rate.
    pub const JAIN: Self = Self { name: "jain", of: |own, _| own.jain, bounds: SHARE };
    /// Mean rate of the users without a direct path in Mbit/s.
    pub const BLOCKED_RATE: Self =
        Self { name: "blocked_rate_mbps", of: |own, _| own.blocked_rate_mbps, bounds: FROM_0 };
    /// Mean bit error rate of the users.
    pub const BER: Self = Self { name: "ber", of: |own, _| own.ber, bounds: SHARE };
    /// Closed loop: share of the users' time below their minimum rate.
    pub const OUTAGE_TIME: Self = Self { name: "outage_time", of: |own, _| 1.0 - own.met, bounds: SHARE };

    /// All figures.
    const ALL: [Self; 7] =
        [Self::SUM_RATE, Self::RATIO, Self::QOS_MET, Self::JAIN, Self::BLOCKED_RATE, Self::BER, Self::OUTAGE_TIME];

    /// The figure with this name in JSON and in CSV files.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|figure| figure.name == name)
    }

    /// An estimate of the figure, with the bounds that the figure has.
    pub fn bounded(self, estimate: Spread) -> Spread {
        estimate.within(self.bounds.0, self.bounds.1)
    }

    /// The figure in each state of each group of a run, beside the oracle on the same states.
    pub fn values(self, run: &[Vec<Sample>], oracle: &[Vec<Sample>]) -> Vec<Vec<f64>> {
        let of_group = |(own, best): (&Vec<Sample>, &Vec<Sample>)| -> Vec<f64> {
            own.iter().zip(best).map(|(own, best)| (self.of)(own, best)).collect()
        };
        run.iter().zip(oracle).map(of_group).collect()
    }

    /// The mean of the figure over the states of each group, beside the oracle on the same states; NaN where the
    /// figure is missing in all of them.
    pub fn means(self, run: &[Vec<Sample>], oracle: &[Vec<Sample>]) -> Vec<f64> {
        self.values(run, oracle).iter().map(|values| mean(&present(values))).collect()
    }

    /// Mean with interval over the runs of a policy, one for each actor, beside the oracle on the same states.
    pub fn spread(self, runs: &[&[Vec<Sample>]], oracle: &[Vec<Sample>]) -> Spread {
        let values: Vec<_> = runs.iter().map(|run| self.values(run, oracle)).collect();
        self.bounded(Spread::of(&values))
    }
}

fn ratio(own: &Sample, best: &Sample) -> f64 {
    if best.sum_rate_mbps > 0.0 { own.sum_rate_mbps / best.sum_rate_mbps } else { f64::NAN }
}

/// Evaluates angles with the complete channel: spill, the LED's panel and blocked paths.
#[derive(Clone)]
pub struct Evaluator {
    /// The channel of the rooms.
    model: ChannelModel,
    rates: Rates,
}

/// Buffers with one entry per user.
#[derive(Clone, Default)]
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

    /// The channel.
    pub fn model(&self) -> &ChannelModel {
        &self.model
    }

    /// Evaluates angles in a world, with its users and its true equipment. Without users the sum
    /// rate is 0, and the shares and means over users are NaN.
    pub fn evaluate_world(&mut self, world: &World, angles: &MirrorAngles) -> Sample {
        self.rates.sample_world(world, angles)
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
    fn sample_world(&mut self, world: &World, angles: &MirrorAngles) -> Sample {
        let users = world.scene().users();
        self.min_rate_bps.clear();
        self.min_rate_bps.extend_from_slice(world.min_rate_bps());
        self.sinr.resize(users, 0.0);
        self.rates_bps.resize(users, 0.0);
        self.sample(world.model(), world.scene(), angles)
    }

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_of_a_group_leaves_out_states_without_the_figure() {
        let sample = |sum_rate_mbps, blocked_rate_mbps| Sample {
            sum_rate_mbps,
            met: 1.0,
            jain: 1.0,
            blocked_rate_mbps,
            ber: 0.0,
        };
        let own = [vec![sample(4.0, f64::NAN), sample(8.0, 2.0)], vec![sample(1.0, f64::NAN)]];
        let oracle = [vec![sample(8.0, 1.0), sample(0.0, 1.0)], vec![sample(2.0, 1.0)]];
        assert_eq!(Figure::SUM_RATE.means(&own, &oracle), [6.0, 1.0]);
        assert_eq!(Figure::RATIO.means(&own, &oracle), [0.5, 0.5]);
        let blocked = Figure::BLOCKED_RATE.means(&own, &oracle);
        assert!(blocked[0] == 2.0 && blocked[1].is_nan(), "{blocked:?}");
    }

    #[test]
    fn a_state_in_which_no_user_has_a_rate_has_no_index_of_fairness() {
        let sample = |sum_rate_mbps, jain| Sample { sum_rate_mbps, met: 0.0, jain, blocked_rate_mbps: 0.0, ber: 0.5 };
        let (dark, lit) = (sample(0.0, f64::NAN), sample(4.0, 0.5));
        let draws = Sample::mean(&[dark, lit]);
        assert_eq!((draws.sum_rate_mbps, draws.jain, Sample::mean(&[dark]).jain.is_nan()), (2.0, 0.5, true));
        let group = [vec![dark, lit, sample(9.0, 1.0)]];
        assert_eq!(Figure::JAIN.means(&group, &group), [0.75]);
    }
}
