//! The policies of a comparison: by the controller's name, by the path of an ONNX file, a function in
//! Python, or the policy that gives the upper bound of the codebook.

use std::path::PathBuf;

use clap::ValueEnum;
use heliostat_channel::MirrorAngles;
use heliostat_core::belief::conditions::Condition;
use heliostat_core::observation::Observation;
use heliostat_core::policy::{Policy, PolicyKind};
use heliostat_core::safety::Limits;
use heliostat_models::{ActorSource, build, source};
use heliostat_room::World;
use heliostat_scenario::{Belief, Scenario, similar};
use thiserror::Error;

use super::{ceiling::Known, python_policy::PythonFunction, trained};
use crate::environment::codebook::BestCodeword;
use crate::environment::room::observe;

/// The name of the policy that evaluates every codeword of the codebook.
const CODEBOOK: &str = "codebook";

/// Suffix of a policy without telemetry of unusable mirrors.
const UNAWARE_SUFFIX: &str = "-unaware";

/// No policy has this name.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{0}")]
pub struct UnknownPolicy(String);

#[derive(Clone, Debug)]
enum Origin {
    Kind(PolicyKind, ActorSource),
    Codebook,
    Python(PythonFunction),
}

/// One policy of a comparison.
#[derive(Clone, Debug)]
pub struct EvaluatedPolicy {
    name: String,
    origin: Origin,
    /// Replaces the scenario's belief.
    belief: Option<Belief>,
    /// Replaces reports and belief by the true room.
    known: Option<Known>,
    /// Whether telemetry leaves the unusable mirrors unnamed.
    unaware: bool,
}

impl EvaluatedPolicy {
    /// Finds a policy by its name or by the path of its ONNX file; `ddpg` is the actor of the
    /// policy of that name.
    ///
    /// # Errors
    /// [`UnknownPolicy`], which lists the known names, or says what to use for a removed one.
    pub fn parse(name: &str, ddpg: &ActorSource) -> Result<Self, UnknownPolicy> {
        let origin = if name == CODEBOOK {
            Origin::Codebook
        } else if let Some(function) = PythonFunction::parse(name) {
            Origin::Python(function)
        } else if name.ends_with(".onnx") {
            Origin::Kind(PolicyKind::Ddpg, ActorSource::Path(PathBuf::from(name)))
        } else {
            let unknown = || {
                let names = Self::names();
                let (known, hint) = (names.join(", "), similar::hint(name, names.iter().map(String::as_str)));
                format!(
                    "unknown policy \"{name}\": expected {known}, the path of a file FILE.onnx, or FILE.py:FUNCTION{hint}"
                )
            };
            let kind = PolicyKind::from_str(name, false).map_err(|_| UnknownPolicy(unknown()))?;
            Origin::Kind(kind, if kind == PolicyKind::Ddpg { ddpg.clone() } else { ActorSource::Shipped })
        };
        Ok(Self { name: name.into(), origin, belief: None, known: None, unaware: false })
    }

    /// The names of all policies.
    pub fn names() -> Vec<String> {
        let values = PolicyKind::value_variants().iter().filter_map(PolicyKind::to_possible_value);
        let names = values.flat_map(|value| value.get_name_and_aliases().map(String::from).collect::<Vec<_>>());
        names.chain([CODEBOOK.into()]).collect()
    }

    /// The same policy with this belief about the users, for closed loop; it replaces the
    /// scenario's. `None` for policies that do not observe the users.
    pub fn with_belief(&self, belief: Belief) -> Option<Self> {
        (!self.is_blind()).then(|| Self {
            name: format!("{}+{belief}", self.name),
            belief: Some(belief),
            ..self.clone()
        })
    }

    /// The same policy in closed loop, with the true room in place of reports. `None` for policies
    /// that do not observe the users.
    pub fn knowing(&self, known: Known) -> Option<Self> {
        let name = format!("{}+{}", self.name, known.name());
        (!self.is_blind()).then(|| Self { name, known: Some(known), ..self.clone() })
    }

    /// The time of the true room that the policy knows; `None`: it observes reports.
    pub(super) fn known(&self) -> Option<Known> {
        self.known
    }

    /// The belief with which the policy observes the users of a room; `None` for policies that do
    /// not observe them, or not by reports.
    pub(super) fn belief(&self, scenario: &Scenario) -> Option<Belief> {
        let by_reports = self.known.is_none() && !self.is_blind();
        by_reports.then(|| self.belief.unwrap_or(scenario.control.belief))
    }

    /// Whether the policy does not observe the users.
    fn is_blind(&self) -> bool {
        use PolicyKind::{Flat, Hold, NoIrs, Random};
        matches!(self.origin, Origin::Kind(Flat | Hold | NoIrs | Random, _))
    }

    /// The same row of a report in a room without mirrors, where all policies are equal.
    pub fn without_mirrors(&self) -> Self {
        let origin = Origin::Kind(PolicyKind::NoIrs, ActorSource::Shipped);
        Self { origin, belief: None, known: None, ..self.clone() }
    }

    /// The same policy in closed loop without telemetry of unusable mirrors. `None` for policies that
    /// assign no mirrors to users.
    pub fn unaware(&self) -> Option<Self> {
        let name = format!("{}{UNAWARE_SUFFIX}", self.name);
        (!self.is_blind()).then(|| Self { name, unaware: true, ..self.clone() })
    }

    /// Whether telemetry names the unusable mirrors.
    pub(super) fn is_aware(&self) -> bool {
        !self.unaware
    }

    /// The name in reports.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The same policy once for each training seed with an actor, or for the given seed
    /// only. A policy that is not learned, or comes from a file, is returned unchanged.
    pub(super) fn trainings(&self, scenario: &Scenario, only: Option<u32>) -> Vec<Self> {
        let Origin::Kind(kind, ActorSource::Shipped) = self.origin else { return vec![self.clone()] };
        let seeds = match only {
            _ if !kind.is_learned() => vec![],
            Some(seed) => vec![seed],
            None => trained::seeds(kind, scenario),
        };
        if seeds.is_empty() {
            return vec![self.clone()];
        }
        let of_seed = |seed| Self { origin: Origin::Kind(kind, trained::source(kind, scenario, seed)), ..self.clone() };
        seeds.into_iter().map(of_seed).collect()
    }

    /// Whether the policy is learned.
    pub(super) fn is_learned(&self) -> bool {
        matches!(self.origin, Origin::Kind(kind, _) if kind.is_learned())
    }

    /// Whether the policy can be built for a room.
    pub fn fits(&self, scenario: &Scenario) -> bool {
        self.check_fits(scenario).is_ok()
    }

    /// Checks that the policy can be built for a room.
    ///
    /// # Errors
    /// The file is missing or does not fit the room, or no actor is built in.
    pub fn check_fits(&self, scenario: &Scenario) -> anyhow::Result<()> {
        self.build(scenario, scenario.seed).map(drop)
    }

    /// Checks that the policy's file, if it comes from one, can be read.
    ///
    /// # Errors
    /// The file is missing or cannot be read.
    pub fn check_file(&self) -> anyhow::Result<()> {
        match &self.origin {
            Origin::Kind(_, ActorSource::Path(path)) => Ok(source::read(path).map(drop)?),
            Origin::Python(function) => function.check_file(),
            _ => Ok(()),
        }
    }

    /// The angles for the true state of a room, within the controller's limits.
    ///
    /// # Errors
    /// The policy cannot be built for the room, or it fails.
    pub fn angles(&self, scenario: &Scenario, world: &World) -> anyhow::Result<MirrorAngles> {
        let mut seen = Observation::new(world.model(), scenario.users.count);
        seen.min_rate_bps.copy_from_slice(world.min_rate_bps());
        observe(world, &mut seen);
        let mut angles = MirrorAngles::flat(seen.mirrors());
        self.build(scenario, scenario.seed)?.act(world.model(), &seen, &mut angles)?;
        Limits::new(&scenario.control).bound(&seen.angles, f64::INFINITY, &mut angles);
        Ok(angles)
    }

    /// What the policy does not do in a room.
    pub(super) fn conditions(&self, scenario: &Scenario) -> Vec<Condition> {
        match &self.origin {
            Origin::Kind(kind, _) => kind.conditions(scenario),
            Origin::Codebook | Origin::Python(_) => Vec::new(),
        }
    }

    /// Whether the policy is a random draw, which is averaged over several.
    pub(super) fn is_random(&self) -> bool {
        matches!(self.origin, Origin::Kind(PolicyKind::Random, _))
    }

    /// Whether the parts of a comparison may run at the same time: a function in Python has one process, and a search
    /// that the clock ends needs a processor of its own.
    pub(super) fn is_parallel(&self, scenario: &Scenario) -> bool {
        match &self.origin {
            Origin::Kind(kind, _) => !kind.is_ended_by_clock(scenario),
            Origin::Codebook => true,
            Origin::Python(_) => false,
        }
    }

    /// The scenario of the policy's controller.
    pub(super) fn scenario(&self, scenario: &Scenario) -> Scenario {
        let mut scenario = scenario.clone();
        scenario.control.belief = self.belief.unwrap_or(scenario.control.belief);
        scenario
    }

    /// A new policy; its random choices come from `seed`.
    pub(super) fn build(&self, scenario: &Scenario, seed: u64) -> anyhow::Result<Box<dyn Policy>> {
        match &self.origin {
            Origin::Kind(kind, actor) => Ok(build(*kind, &Scenario { seed, ..scenario.clone() }, actor)?),
            Origin::Codebook => Ok(Box::new(BestCodeword::new(scenario)?)),
            Origin::Python(function) => function.policy(&self.name, scenario),
        }
    }

    /// Lets a function forget what it has seen: an episode begins, or the next state of a static comparison. Call it
    /// behind the warm-up of the policy that [`EvaluatedPolicy::build`] returned.
    ///
    /// # Errors
    /// The process of the function has ended.
    pub(super) fn begin_episode(&self) -> anyhow::Result<()> {
        match &self.origin {
            Origin::Python(function) => function.begin_episode(),
            Origin::Kind(..) | Origin::Codebook => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_of_the_documents_has_each_policy_with_its_needs_its_condition_and_where_it_is_accepted() {
        let (_, section) =
            include_str!("../../../../docs/evaluation.md").split_once("## The policies").expect("the section");
        let rows = section.lines().skip_while(|line| !line.starts_with('|')).skip(2);
        let crowded = Scenario::builtin("hall").unwrap().with_overrides(&["users.count=12"]).unwrap();
        let mut listed = Vec::new();
        for row in rows.take_while(|line| line.starts_with('|')) {
            let cells: Vec<&str> = row.trim_matches(['|', ' ']).split(" | ").collect();
            let [policies, _, needs, condition, place] = cells[..] else { panic!("{row}") };
            for name in policies.split('`').skip(1).step_by(2) {
                listed.push(name.to_owned());
                let Ok(kind) = PolicyKind::from_str(name, false) else {
                    assert!(name != CODEBOOK || place == "`heliostat-lab eval`", "{row}");
                    continue;
                };
                let has_none = kind != PolicyKind::Exhaustive && kind.conditions(&crowded).is_empty();
                assert_eq!(condition == "none", has_none, "{row}");
                assert_eq!(needs.starts_with("an actor"), kind.is_learned(), "{row}");
                assert_eq!(needs.starts_with("an actor, built in for any array"), kind.fits_any_array(), "{row}");
                assert_eq!(place, "every program", "{row}");
            }
        }
        let mut expected = EvaluatedPolicy::names();
        expected.extend(["FILE.onnx", "FILE.py:FUNCTION"].map(String::from));
        listed.sort_unstable();
        expected.sort_unstable();
        assert_eq!(listed, expected);
    }

    #[test]
    fn names_aliases_and_files_are_found_and_the_error_lists_the_names() {
        let parse = |name: &str| EvaluatedPolicy::parse(name, &ActorSource::Shipped);
        for name in EvaluatedPolicy::names() {
            assert_eq!(parse(&name).unwrap().name(), name);
        }
        assert!(EvaluatedPolicy::names().contains(&"ddpg".to_string()));
        assert!(parse("random").unwrap().is_random() && !parse("some/where.onnx").unwrap().is_random());
        assert_eq!(
            parse("greedy").unwrap().with_belief(Belief::ConstantVelocity).unwrap().name(),
            "greedy+constant-velocity"
        );
        assert!(parse("flat").unwrap().with_belief(Belief::Filter).is_none());
        assert!(parse("no-irs").unwrap().unaware().is_none());
        assert_eq!(parse("greedy").unwrap().unaware().unwrap().name(), "greedy-unaware");
        let message = parse("gredy").unwrap_err().to_string();
        assert!(
            message.contains("\"gredy\"") && message.contains("greedy") && message.contains("exhaustive"),
            "{message}"
        );
    }
}
