//! The common part of the metaheuristics: a population of candidate angles, the objective, and the
//! budget.
//!
//! A candidate is the roll and yaw of every mirror, within the range of commands. Its objective is
//! problem P on the observation: the sum of rates by the true evaluation, less [`QOS_PENALTY`]
//! bit/s for each bit/s that a user is short of the minimum rate.
//!
//! Each decision draws new uniform candidates, except that the first candidate has the present
//! angles, so that no proposal is worse than these. It ends with the trials or the time, whichever
//! runs out first. Time comes from the caller: without a time limit (`control.search_time_us = 0`)
//! the proposals depend on the seed alone.

use heliostat_channel::{ChannelModel, mirrors::MirrorAngles, solver::QOS_PENALTY};
use heliostat_proto::MAX_USERS;
use heliostat_scenario::{Control, Scenario};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::proposal::{Policy, PolicyMemory, PolicyResult, TimeSource};
use crate::{observe::observation::Observation, output::safety::Limits};

/// Candidates; the usual number of the literature is 20 to 50, and a short budget asks for few.
const POPULATION: usize = 20;

/// How a candidate moves from round to round.
pub(super) trait Rule: Send {
    /// The first round was evaluated: discard the memory of the last decision.
    fn begin(&mut self, places: &[MirrorAngles], objectives: &[f64]);

    /// Moves a candidate; the caller clamps it to the range.
    fn step(&mut self, place: &mut MirrorAngles, round: &Round<'_>, generator: &mut ChaCha8Rng);

    /// A moved candidate was evaluated.
    fn evaluated(&mut self, index: usize, place: &MirrorAngles, objective: f64);
}

/// The state of a search when a candidate moves.
pub(super) struct Round<'a> {
    /// Index of the candidate that moves.
    pub index: usize,
    /// The best of all so far.
    pub best: &'a MirrorAngles,
    /// Share of the budget that is spent, below 1.
    pub spent: f64,
}

/// A metaheuristic: the candidates, and how they move.
pub(super) struct Search<R> {
    name: &'static str,
    population: Population,
    rule: R,
}

impl<R> Search<R> {
    /// With the budget and the seed of a scenario; `rule` gets the candidates, for a memory of each.
    pub fn new(
        name: &'static str,
        scenario: &Scenario,
        monotonic_ns: TimeSource,
        rule: impl FnOnce(&[MirrorAngles]) -> R,
    ) -> Self {
        let population = Population::new(scenario, monotonic_ns);
        Self { name, rule: rule(&population.places), population }
    }
}

impl<R: Rule> Policy for Search<R> {
    fn name(&self) -> &str {
        self.name
    }

    fn act(&mut self, model: &ChannelModel, observation: &Observation, out: &mut MirrorAngles) -> PolicyResult {
        self.population.search(model, observation, &mut self.rule, out);
        Ok(())
    }

    /// Each decision draws new candidates.
    fn memory(&self) -> PolicyMemory {
        PolicyMemory { words: self.population.generator.get_word_pos(), ..PolicyMemory::default() }
    }

    fn restore(&mut self, memory: &PolicyMemory) {
        self.population.generator.set_word_pos(memory.words);
    }
}

/// A population with its buffers, reused at each decision.
struct Population {
    /// The budget of one decision is in it.
    control: Control,
    range_rad: f64,
    generator: ChaCha8Rng,
    places: Vec<MirrorAngles>,
    objectives: Vec<f64>,
    best: MirrorAngles,
    best_objective: f64,
    rates_bps: Vec<f64>,
    monotonic_ns: TimeSource,
    begun_ns: u64,
    evaluations: u32,
}

impl Population {
    fn new(scenario: &Scenario, monotonic_ns: TimeSource) -> Self {
        let flat = MirrorAngles::flat(scenario.mirror_count());
        Self {
            control: scenario.control.clone(),
            range_rad: Limits::new(&scenario.control).range_rad(),
            generator: ChaCha8Rng::seed_from_u64(scenario.seed),
            places: vec![flat.clone(); POPULATION],
            objectives: vec![f64::NEG_INFINITY; POPULATION],
            best: flat,
            best_objective: f64::NEG_INFINITY,
            rates_bps: Vec::with_capacity(MAX_USERS),
            monotonic_ns,
            begun_ns: 0,
            evaluations: 0,
        }
    }

    /// Searches until the budget is spent, and writes the best candidate of all.
    fn search(&mut self, model: &ChannelModel, observation: &Observation, rule: &mut dyn Rule, out: &mut MirrorAngles) {
        self.draw(observation);
        for index in 0..POPULATION {
            if self.spent() < 1.0 {
                self.evaluate(model, observation, index);
            }
        }
        rule.begin(&self.places, &self.objectives);
        'search: loop {
            for index in 0..POPULATION {
                let spent = self.spent();
                if spent >= 1.0 {
                    break 'search;
                }
                let place = &mut self.places[index];
                rule.step(place, &Round { index, best: &self.best, spent }, &mut self.generator);
                for angle in place.axes_mut() {
                    *angle = angle.clamp(-self.range_rad, self.range_rad);
                }
                self.evaluate(model, observation, index);
                rule.evaluated(index, &self.places[index], self.objectives[index]);
            }
        }
        out.copy_from(&self.best);
    }

    fn draw(&mut self, observation: &Observation) {
        self.begun_ns = (self.monotonic_ns)();
        self.evaluations = 0;
        self.best_objective = f64::NEG_INFINITY;
        self.objectives.fill(f64::NEG_INFINITY);
        let (first, others) = self.places.split_at_mut(1);
        first[0].copy_from(&observation.angles);
        self.best.copy_from(&observation.angles);
        let range = -self.range_rad..=self.range_rad;
        for angle in others.iter_mut().flat_map(MirrorAngles::axes_mut) {
            *angle = self.generator.random_range(range.clone());
        }
    }

    /// Share of the budget that is spent.
    fn spent(&self) -> f64 {
        let Control { search_evaluations, search_time_us, .. } = self.control;
        let trials = f64::from(self.evaluations) / f64::from(search_evaluations);
        if search_time_us <= 0.0 {
            return trials;
        }
        trials.max((self.monotonic_ns)().saturating_sub(self.begun_ns) as f64 / (1e3 * search_time_us))
    }

    fn evaluate(&mut self, model: &ChannelModel, observation: &Observation, index: usize) {
        self.evaluations += 1;
        let place = &self.places[index];
        self.rates_bps.resize(observation.users(), 0.0);
        observation.scene.rates_bps(model, place, &mut self.rates_bps);
        let users = self.rates_bps.iter().zip(&observation.min_rate_bps);
        let objective = users.map(|(rate, min_rate)| rate - QOS_PENALTY * (min_rate - rate).max(0.0)).sum();
        self.objectives[index] = objective;
        if objective > self.best_objective {
            self.best_objective = objective;
            self.best.copy_from(place);
        }
    }
}
