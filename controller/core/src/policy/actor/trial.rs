//! The trial of an actor in its room: does it give angles, and is it better than flat mirrors?
//!
//! The trial ends after [`TIME_MAX_NS`], so that a slow network does not delay the start.

use heliostat_channel::{ChannelModel, mirrors::MirrorAngles};
use heliostat_scenario::Scenario;

use super::{
    Actor,
    samples::{self, TIME_MAX_NS},
};
use crate::{
    observe::observation::Observation,
    output::safety::Limits,
    policy::{
        actor_file::{ActorError, ActorProblem},
        proposal::{Policy, TimeSource},
    },
};

/// Sampled observations.
const OBSERVATIONS: usize = 32;
/// Fewer observations are too few to judge the sum rate.
const JUDGED_MIN: usize = 4;

/// A result of a trial.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Finding {
    /// For the log.
    Note(String),
    /// For the operator.
    Warning(String),
}

impl Actor {
    /// Runs the actor on sampled observations of a scenario.
    ///
    /// # Errors
    /// [`ActorProblem::NoAngles`] where it gives no angles on any observation.
    pub fn try_out(&mut self, scenario: &Scenario, monotonic_ns: TimeSource) -> Result<Vec<Finding>, ActorError> {
        // A room without a channel is refused elsewhere.
        let Ok(model) = scenario.channel_model() else { return Ok(Vec::new()) };
        let memory = self.memory();
        let mut trial = Trial::new(scenario, &model);
        let started_ns = monotonic_ns();
        for index in 0..OBSERVATIONS {
            samples::observe(scenario, &model, index, &mut trial.observation);
            trial.run(self, &model);
            if monotonic_ns().saturating_sub(started_ns) > TIME_MAX_NS {
                break;
            }
        }
        self.restore(&memory);
        trial.finish(self)
    }
}

/// A trial in progress.
struct Trial {
    limits: Limits,
    observation: Observation,
    flat: MirrorAngles,
    proposed: MirrorAngles,
    rates_bps: Vec<f64>,
    /// Observations, and those without angles with the last reason.
    observations: usize,
    failures: usize,
    last_failure: String,
    /// Sums of the sum rates in bit/s over the observations with angles.
    sum_rate_bps: f64,
    flat_bps: f64,
}

impl Trial {
    fn new(scenario: &Scenario, model: &ChannelModel) -> Self {
        let (users, mirrors) = (scenario.users.count, model.mirrors.len());
        Self {
            limits: Limits::new(&scenario.control),
            observation: Observation::new(model, users),
            flat: MirrorAngles::flat(mirrors),
            proposed: MirrorAngles::flat(mirrors),
            rates_bps: vec![0.0; users],
            observations: 0,
            failures: 0,
            last_failure: String::new(),
            sum_rate_bps: 0.0,
            flat_bps: 0.0,
        }
    }

    /// Lets the actor decide for the observation, and evaluates the angles.
    fn run(&mut self, actor: &mut Actor, model: &ChannelModel) {
        self.observations += 1;
        if let Err(failure) = actor.act(model, &self.observation, &mut self.proposed) {
            self.failures += 1;
            self.last_failure = failure.to_string();
            return;
        }
        self.limits.bound(&self.flat, f64::INFINITY, &mut self.proposed);
        let scene = &self.observation.scene;
        for (angles, sum_bps) in [(&self.proposed, &mut self.sum_rate_bps), (&self.flat, &mut self.flat_bps)] {
            scene.rates_bps(model, angles, &mut self.rates_bps);
            *sum_bps += self.rates_bps.iter().sum::<f64>();
        }
    }

    fn finish(self, actor: &Actor) -> Result<Vec<Finding>, ActorError> {
        let origin = actor.info.origin();
        let Self { failures, observations, last_failure, .. } = self;
        if failures == observations {
            return Err(actor.info.refused(ActorProblem::NoAngles { failures, example: last_failure }));
        }
        let mut findings = Vec::new();
        if !actor.is_verified {
            findings.push(Finding::Note(format!(
                "{origin} is not verified: its metadata has no outputs of the trainer's network to compare with"
            )));
        }
        if failures > 0 {
            findings.push(Finding::Warning(format!(
                "{origin} gave no angles on {failures} of {observations} sampled observations: {last_failure}; \
                 the fallback decides in such cases"
            )));
        }
        let judged = observations - failures;
        if judged >= JUDGED_MIN && self.sum_rate_bps < self.flat_bps {
            let mbps = |sum_bps: f64| 1e-6 * sum_bps / judged as f64;
            findings.push(Finding::Warning(format!(
                "{origin} is worse than flat mirrors in this scenario: a sum rate of {:.2} Mbit/s against {:.2} Mbit/s, \
                 means of {judged} sampled observations; train it for this scenario, or choose the policy fixed-point",
                mbps(self.sum_rate_bps),
                mbps(self.flat_bps),
            )));
        }
        Ok(findings)
    }
}
