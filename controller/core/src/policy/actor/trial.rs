//! The trial of an actor when it is loaded: does the engine evaluate the network correctly, and is
//! the actor better than flat mirrors?
//!
//! The trial ends after [`TIME_MAX_NS`], so that a slow network does not delay the start.

use heliostat_channel::{ChannelModel, mirrors::MirrorAngles};
use heliostat_onnx::{ModelProto, reference::Reference};
use heliostat_scenario::Scenario;
use prost::Message;

use super::{
    Actor,
    samples::{self, TIME_MAX_NS},
    widen,
};
use crate::{
    observe::observation::Observation,
    output::safety::{Limits, check_finite},
    policy::{
        actor_file::{ActorError, ActorFile, INPUT_NAME},
        proposal::TimeSource,
    },
};

/// Sampled observations.
const OBSERVATIONS: usize = 32;
/// The observations on which engine and reference are compared.
const COMPARED: usize = 8;
/// Fewer observations are too few to judge the sum rate.
const JUDGED_MIN: usize = 4;
/// Angles that differ by less, in rad, count as equal: both evaluations round to f32.
const SAME_ANGLE_RAD: f32 = 1e-3;
/// Largest share of the angles of one observation that may differ: where a network selects between
/// nearly equal values, rounding decides.
const DIFFERING_MAX: f64 = 0.02;

/// A result of a trial.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Finding {
    /// For the log.
    Note(String),
    /// For the operator.
    Warning(String),
}

impl Actor {
    /// Runs the actor of a file on sampled observations of a scenario.
    ///
    /// # Errors
    /// [`ActorError::Disagrees`] where the engine and the reference evaluation differ on most
    /// observations.
    pub fn try_out(
        &mut self,
        file: &ActorFile,
        scenario: &Scenario,
        monotonic_ns: TimeSource,
    ) -> Result<Vec<Finding>, ActorError> {
        // A room without a channel is refused elsewhere.
        let Ok(model) = scenario.channel_model() else { return Ok(Vec::new()) };
        let mut trial = Trial::new(file, scenario, &model);
        let started_ns = monotonic_ns();
        for index in 0..OBSERVATIONS {
            samples::observe(scenario, &model, index, &mut trial.observation);
            trial.run(self, &model);
            if monotonic_ns().saturating_sub(started_ns) > TIME_MAX_NS {
                break;
            }
        }
        trial.finish(file, self)
    }
}

/// A trial in progress.
struct Trial {
    reference: Result<Reference, String>,
    limits: Limits,
    observation: Observation,
    vector: Vec<f32>,
    flat: MirrorAngles,
    proposed: MirrorAngles,
    rates_bps: Vec<f64>,
    /// Observations, and those without angles with the last reason.
    observations: usize,
    failures: usize,
    last_failure: String,
    compared: usize,
    differing: usize,
    last_difference: String,
    /// Sums of the sum rates in bit/s over the observations with angles.
    sum_rate_bps: f64,
    flat_bps: f64,
}

impl Trial {
    fn new(file: &ActorFile, scenario: &Scenario, model: &ChannelModel) -> Self {
        let parsed = ModelProto::decode(file.bytes.as_ref()).map_err(|error| error.to_string());
        let (users, mirrors) = (scenario.users.count, model.mirrors.len());
        Self {
            reference: parsed.and_then(|file| Reference::new(&file)),
            limits: Limits::new(&scenario.control),
            observation: Observation::new(model, users),
            vector: Vec::new(),
            flat: MirrorAngles::flat(mirrors),
            proposed: MirrorAngles::flat(mirrors),
            rates_bps: vec![0.0; users],
            observations: 0,
            failures: 0,
            last_failure: String::new(),
            compared: 0,
            differing: 0,
            last_difference: String::new(),
            sum_rate_bps: 0.0,
            flat_bps: 0.0,
        }
    }

    /// Runs the network on the observation, compares it with the reference, and evaluates the
    /// angles.
    fn run(&mut self, actor: &mut Actor, model: &ChannelModel) {
        self.observations += 1;
        if let Err(failure) = self.propose(actor, model) {
            self.failures += 1;
            self.last_failure = failure;
            return;
        }
        self.limits.bound(&self.flat, f64::INFINITY, &mut self.proposed);
        let scene = &self.observation.scene;
        for (angles, sum_bps) in [(&self.proposed, &mut self.sum_rate_bps), (&self.flat, &mut self.flat_bps)] {
            scene.rates_bps(model, angles, &mut self.rates_bps);
            *sum_bps += self.rates_bps.iter().sum::<f64>();
        }
    }

    fn propose(&mut self, actor: &mut Actor, model: &ChannelModel) -> Result<(), String> {
        let input = actor.network.input_mut();
        actor.encoder.encode(model, &self.observation, input).map_err(|error| error.to_string())?;
        self.vector.clear();
        self.vector.extend_from_slice(input);
        let found = actor.network.run().map_err(|error| error.to_string())?;
        let mirrors = self.flat.roll.len();
        if found.len() != 2 * mirrors {
            return Err(format!("the output of the network has a length of {}, expected {}", found.len(), 2 * mirrors));
        }
        widen(&found[..mirrors], &mut self.proposed.roll);
        widen(&found[mirrors..], &mut self.proposed.yaw);
        let found = found.to_vec();
        self.compare(&found);
        check_finite(&self.proposed).map_err(|error| error.to_string())
    }

    /// Compares the engine's output with that of the reference.
    fn compare(&mut self, found: &[f32]) {
        if self.compared == COMPARED {
            return;
        }
        let evaluated = self.reference.as_ref().map_err(Clone::clone).and_then(|it| it.run(INPUT_NAME, &self.vector));
        let expected = match evaluated {
            Ok(expected) => expected,
            Err(reason) => {
                self.reference = Err(reason);
                return;
            }
        };
        self.compared += 1;
        // Values that are not finite are equal only to others of the kind.
        let differs = |(found, expected): (&f32, &f32)| {
            found.is_finite() != expected.is_finite() || (found - expected).abs() > SAME_ANGLE_RAD
        };
        let places = || {
            (0..found.len()).filter(|&place| expected.get(place).is_none_or(|value| differs((&found[place], value))))
        };
        if places().count() as f64 > DIFFERING_MAX * found.len() as f64
            && let Some(place) = places().next()
        {
            self.differing += 1;
            let expected = expected.get(place).map_or("nothing".into(), f32::to_string);
            let found = found[place];
            self.last_difference = format!("output {place}: {found} by the engine, {expected} by the reference");
        }
    }

    fn finish(self, file: &ActorFile, actor: &Actor) -> Result<Vec<Finding>, ActorError> {
        let origin = &file.origin;
        let (differing, compared) = (self.differing, self.compared);
        if 2 * differing > compared {
            let (origin, example) = (origin.clone(), self.last_difference);
            return Err(ActorError::Disagrees { origin, differing, compared, example });
        }
        let mut findings = Vec::new();
        if let Err(reason) = &self.reference {
            findings.push(Finding::Note(format!(
                "{origin}: the engine was not compared with a reference evaluation, which does not support {reason}"
            )));
        }
        if differing > 0 {
            findings.push(Finding::Warning(format!(
                "{origin}: the inference engine and the reference evaluation differ on {differing} of {compared} observations ({})",
                self.last_difference
            )));
        }
        if self.failures > 0 {
            findings.push(Finding::Warning(format!(
                "{origin}: {} gave no angles on {} of {} sampled observations: {}; the fallback decides in such cases",
                actor.name, self.failures, self.observations, self.last_failure
            )));
        }
        let judged = self.observations - self.failures;
        if judged >= JUDGED_MIN && self.sum_rate_bps < self.flat_bps {
            let mbps = |sum_bps: f64| 1e-6 * sum_bps / judged as f64;
            findings.push(Finding::Warning(format!(
                "{origin}: {} is worse than flat mirrors in this scenario: a sum rate of {:.2} Mbit/s against {:.2} Mbit/s, \
                 means of {judged} sampled observations; train it for this scenario, or choose the policy fixed-point",
                actor.name,
                mbps(self.sum_rate_bps),
                mbps(self.flat_bps),
            )));
        }
        Ok(findings)
    }
}
