//! The policies by name, and how each is built for a room.

use clap::ValueEnum;
use heliostat_channel::solver::SolverError;
use heliostat_scenario::{Fallback, Scenario};
use thiserror::Error;

use super::actor::Actor;
use super::actor_file::{ActorError, ActorFile};
use super::exhaustive::Exhaustive;
use super::fixed::{Fixed, Hold};
use super::model_based::ModelBased;
use super::nearest::Nearest;
use super::network::Engine;
use super::pso::Pso;
use super::sine_cosine::SineCosine;
use super::{Policy, TimeSource};
use crate::safety::Limits;

/// Why there is no such policy for a room.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum BuildError {
    /// The actor is missing or does not fit.
    #[error(transparent)]
    Actor(#[from] ActorError),
    /// There is too much to search.
    #[error("an exhaustive search cannot run here: {0}; take --policy oracle, whose answers equal it where it can run")]
    Search(SolverError),
    /// A learned policy was to be built without its file.
    #[error("policy {policy} is learned: expected the file of its actor, found none")]
    ActorExpected {
        /// The policy's name.
        policy: String,
    },
}

/// What policies need from outside the pure core.
#[derive(Clone, Copy)]
pub struct Resources<'a> {
    /// The file of a learned policy.
    pub actor: Option<&'a ActorFile>,
    /// Evaluates learned policies.
    pub engine: &'a dyn Engine,
    /// Time source of policies with a time budget.
    pub monotonic_ns: TimeSource,
}

/// The policies by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum PolicyKind {
    /// Learned: DDPG with one weight a user (ONNX, as all that is learned)
    #[value(alias = "actor")]
    Ddpg,
    /// Learned: DDPG on the angles of all mirrors, as the paper has it
    DdpgRaw,
    /// Learned: the same, with a critic that sees smooth patterns of the angles
    DdpgBasis,
    /// Learned: by the gradient through the channel itself
    Analytic,
    /// Learned: deep Q-learning on a codebook of angles
    Dql,
    /// Learned: Q-learning with a table
    QLearning,
    /// Learned: SARSA with a table
    Sarsa,
    /// Model-based: damped fixed point over the users' weights
    FixedPoint,
    /// Model-based: the fixed point, then passes of single mirror moves
    Greedy,
    /// Model-based: the search that everything is measured by, from many starts; far slower than a tick
    Oracle,
    /// Model-based: every assignment of mirrors to users; for about nine mirrors and three users
    Exhaustive,
    /// Metaheuristic: the sine cosine algorithm on the angles of all mirrors
    SineCosine,
    /// Metaheuristic: particle swarm optimisation on the angles of all mirrors
    Pso,
    /// Each mirror serves the user to whom it can give most
    Nearest,
    /// One random draw a mirror, held for the run
    Random,
    /// Every mirror faces straight into the room
    Flat,
    /// Every mirror is turned away from everybody
    NoIrs,
    /// Every mirror stays as it was commanded last
    Hold,
}

impl PolicyKind {
    /// The name on the command line and in file names.
    pub fn name(self) -> String {
        self.to_possible_value().map(|value| value.get_name().to_owned()).expect("no policy is hidden")
    }

    /// Whether the policy is a trained network, to be had as an ONNX file.
    pub fn is_learned(self) -> bool {
        use PolicyKind::{Analytic, Ddpg, DdpgBasis, DdpgRaw, Dql, QLearning, Sarsa};
        matches!(self, Ddpg | DdpgRaw | DdpgBasis | Analytic | Dql | QLearning | Sarsa)
    }

    /// The names of all learned policies, with commas between them.
    pub fn learned_names() -> String {
        let learned = Self::value_variants().iter().filter(|kind| kind.is_learned());
        learned.map(|kind| kind.name()).collect::<Vec<_>>().join(", ")
    }
}

/// Builds a policy for a room.
///
/// # Errors
/// [`BuildError`] where the policy is learned and its actor is missing or does not fit, or where it searches more than can be searched.
pub fn build(kind: PolicyKind, scenario: &Scenario, resources: &Resources<'_>) -> Result<Box<dyn Policy>, BuildError> {
    let (users, mirrors) = (scenario.users.count, scenario.mirror_count());
    let range_rad = Limits::new(&scenario.control).range_rad();
    Ok(match kind {
        PolicyKind::Ddpg
        | PolicyKind::DdpgRaw
        | PolicyKind::DdpgBasis
        | PolicyKind::Analytic
        | PolicyKind::Dql
        | PolicyKind::QLearning
        | PolicyKind::Sarsa => {
            let actor = resources.actor.ok_or_else(|| BuildError::ActorExpected { policy: kind.name() })?;
            Box::new(Actor::load(actor, scenario, resources.engine)?.named(kind.name()))
        }
        PolicyKind::FixedPoint => Box::new(ModelBased::fixed_point(users, mirrors)),
        PolicyKind::Greedy => Box::new(ModelBased::greedy(users, mirrors)),
        PolicyKind::Oracle => Box::new(ModelBased::oracle(users, mirrors)),
        PolicyKind::Exhaustive => Box::new(Exhaustive::new(scenario).map_err(BuildError::Search)?),
        PolicyKind::SineCosine => Box::new(SineCosine::new(scenario, resources.monotonic_ns)),
        PolicyKind::Pso => Box::new(Pso::new(scenario, resources.monotonic_ns)),
        PolicyKind::Nearest => Box::new(Nearest::new(users)),
        PolicyKind::Random => Box::new(Fixed::random(mirrors, range_rad, scenario.seed)),
        PolicyKind::Flat => Box::new(Fixed::flat(mirrors)),
        PolicyKind::NoIrs => Box::new(Fixed::no_irs(mirrors, range_rad)),
        PolicyKind::Hold => Box::new(Hold),
    })
}

/// Builds the policy that answers when another fails; `None` where no command is to be sent then.
pub fn build_fallback(fallback: Fallback, scenario: &Scenario) -> Option<Box<dyn Policy>> {
    let (users, mirrors) = (scenario.users.count, scenario.mirror_count());
    match fallback {
        Fallback::FixedPoint => Some(Box::new(ModelBased::fixed_point(users, mirrors))),
        Fallback::Nearest => Some(Box::new(Nearest::new(users))),
        Fallback::Flat => Some(Box::new(Fixed::flat(mirrors))),
        Fallback::LastGood => Some(Box::new(Hold)),
        Fallback::Hold => None,
    }
}
