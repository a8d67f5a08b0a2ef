//! Who takes part: a policy of the controller by its name, an ONNX file by its path, or the ceiling of the learners' codebook.

use std::path::PathBuf;

use clap::ValueEnum;
use heliostat_channel::MirrorAngles;
use heliostat_decide::observation::Observation;
use heliostat_decide::policy::{Policy, PolicyKind};
use heliostat_decide::safety::Limits;
use heliostat_engine::{ActorSource, build, shipped};
use heliostat_scenario::{Prediction, Scenario};
use heliostat_sim::World;
use thiserror::Error;

use crate::codebook::BestEntry;
use crate::env::observe;

/// The name of the best possible policy of the codebook.
const CODEBOOK: &str = "codebook";

/// Added to the name of an entrant that predicts the users.
const PREDICTION_SUFFIX: &str = "+prediction";

/// Added to the name of an entrant that is not told which mirrors do not follow.
const UNAWARE_SUFFIX: &str = "-unaware";

/// No policy has this name.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("no policy \"{name}\"; there are {}, and any FILE.onnx", Entrant::names().join(", "))]
pub struct UnknownPolicy {
    /// The name that was given.
    pub name: String,
}

#[derive(Clone, Debug)]
enum Way {
    Kind(PolicyKind, ActorSource),
    Codebook,
}

/// One policy of a comparison.
#[derive(Clone, Debug)]
pub struct Entrant {
    name: String,
    way: Way,
    prediction: Option<Prediction>,
    /// Telemetry does not name the mirrors that do not follow.
    unaware: bool,
}

impl Entrant {
    /// Finds a policy by its name or by the path of its ONNX file; `ddpg` is the file of the policy of that name, if not the built-in one.
    ///
    /// # Errors
    /// [`UnknownPolicy`], which lists those there are.
    pub fn parse(name: &str, ddpg: &ActorSource) -> Result<Self, UnknownPolicy> {
        let way = if name == CODEBOOK {
            Way::Codebook
        } else if name.ends_with(".onnx") {
            Way::Kind(PolicyKind::Ddpg, ActorSource::Path(PathBuf::from(name)))
        } else {
            let kind = PolicyKind::from_str(name, false).map_err(|_| UnknownPolicy { name: name.into() })?;
            Way::Kind(kind, if kind == PolicyKind::Ddpg { ddpg.clone() } else { ActorSource::Shipped })
        };
        Ok(Self { name: name.into(), way, prediction: None, unaware: false })
    }

    /// The names of all policies.
    pub fn names() -> Vec<String> {
        let values = PolicyKind::value_variants().iter().filter_map(PolicyKind::to_possible_value);
        let names = values.flat_map(|value| value.get_name_and_aliases().map(String::from).collect::<Vec<_>>());
        names.chain([CODEBOOK.into()]).collect()
    }

    /// The same policy with constant-velocity prediction of the users, whatever the scenario says; for a closed loop. `None` for
    /// policies that look at nobody.
    pub fn predicted(&self) -> Option<Self> {
        use PolicyKind::{Flat, Hold, NoIrs, Random};
        let blind = matches!(self.way, Way::Kind(Flat | Hold | NoIrs | Random, _));
        (!blind).then(|| Self {
            name: format!("{}{PREDICTION_SUFFIX}", self.name),
            prediction: Some(Prediction::ConstantVelocity),
            ..self.clone()
        })
    }

    /// The same policy without being told which mirrors do not follow; for a closed loop.
    pub fn unaware(&self) -> Self {
        Self { name: format!("{}{UNAWARE_SUFFIX}", self.name), unaware: true, ..self.clone() }
    }

    /// Whether it is told which mirrors do not follow.
    pub(super) fn is_aware(&self) -> bool {
        !self.unaware
    }

    /// The name in reports.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The same policy once for each training seed of which an actor is built in, or only for the one given; itself where it was not
    /// learned or comes from a file.
    pub(super) fn trainings(&self, scenario: &Scenario, only: Option<u32>) -> Vec<Self> {
        let Way::Kind(kind, ActorSource::Shipped) = self.way else { return vec![self.clone()] };
        let seeds = match only {
            _ if !kind.is_learned() => vec![],
            Some(seed) => vec![seed],
            None => shipped::training_seeds(kind, scenario),
        };
        if seeds.is_empty() {
            return vec![self.clone()];
        }
        let of_seed = |seed| Self { way: Way::Kind(kind, ActorSource::ShippedSeed(seed)), ..self.clone() };
        seeds.into_iter().map(of_seed).collect()
    }

    /// Whether the policy was learned.
    pub(super) fn is_learned(&self) -> bool {
        matches!(self.way, Way::Kind(kind, _) if kind.is_learned())
    }

    /// Whether the policy can be had for a room.
    pub fn fits(&self, scenario: &Scenario) -> bool {
        self.build(scenario, scenario.seed).is_ok()
    }

    /// The angles for a room as it truly stands, within the controller's limits.
    ///
    /// # Errors
    /// A policy that cannot be had for the room, or that fails in it.
    pub fn angles(&self, scenario: &Scenario, world: &World) -> anyhow::Result<MirrorAngles> {
        let mut seen = Observation::new(world.model(), scenario.users.count);
        seen.min_rate_bps.copy_from_slice(world.min_rate_bps());
        observe(world, &mut seen);
        let mut angles = MirrorAngles::flat(seen.mirrors());
        self.build(scenario, scenario.seed)?.act(world.model(), &seen, &mut angles)?;
        Limits::new(&scenario.control).bound(&seen.angles, f64::INFINITY, &mut angles);
        Ok(angles)
    }

    /// Whether the policy is a random draw, to be averaged over many.
    pub(super) fn is_random(&self) -> bool {
        matches!(self.way, Way::Kind(PolicyKind::Random, _))
    }

    /// The scenario as the entrant's controller has it.
    pub(super) fn scenario(&self, scenario: &Scenario) -> Scenario {
        let mut scenario = scenario.clone();
        scenario.control.prediction = self.prediction.unwrap_or(scenario.control.prediction);
        scenario
    }

    /// A fresh policy; what it draws comes from `seed`.
    pub(super) fn build(&self, scenario: &Scenario, seed: u64) -> anyhow::Result<Box<dyn Policy>> {
        match &self.way {
            Way::Kind(kind, actor) => Ok(build(*kind, &Scenario { seed, ..scenario.clone() }, actor)?),
            Way::Codebook => Ok(Box::new(BestEntry::new(scenario)?)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_aliases_and_files_are_found_and_others_are_told_what_there_is() {
        let parse = |name: &str| Entrant::parse(name, &ActorSource::Shipped);
        for name in Entrant::names() {
            assert_eq!(parse(&name).unwrap().name(), name);
        }
        assert!(Entrant::names().contains(&"ddpg".to_string()));
        assert!(parse("random").unwrap().is_random() && !parse("some/where.onnx").unwrap().is_random());
        assert_eq!(parse("greedy").unwrap().predicted().unwrap().name(), "greedy+prediction");
        assert!(parse("flat").unwrap().predicted().is_none());
        let message = parse("gredy").unwrap_err().to_string();
        assert!(
            message.contains("\"gredy\"") && message.contains("greedy") && message.contains("exhaustive"),
            "{message}"
        );
    }
}
