//! The table of policies: names, help texts, and how each policy is built for a room.

use clap::ValueEnum;
use heliostat_channel::solver::SolverError;
use heliostat_scenario::{Fallback, Scenario};
use thiserror::Error;

use super::actor::Actor;
use super::actor_file::{ActorError, ActorFile};
use super::engine::Engine;
use super::proposal::{Policy, TimeSource};
use crate::output::safety::Limits;
use Recipe::{Direct, Learned};

/// Why a policy cannot be built for a room.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum BuildError {
    /// The actor is missing or does not fit.
    #[error(transparent)]
    Actor(#[from] ActorError),
    /// The search space is too large, or continuous.
    #[error(
        "an exhaustive search cannot run here: {0}; use the policy oracle, which gives the same assignments in small rooms"
    )]
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

/// Declares the policies: one row yields the name on the command line, the help text, and how the
/// policy is built.
macro_rules! policies {
    ($($(#[$attribute:meta])* $kind:ident: $recipe:expr,)*) => {
        /// The policies by name.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
        pub enum PolicyKind {
            $($(#[$attribute])* $kind,)*
        }

        impl PolicyKind {
            fn recipe(self) -> Recipe {
                match self {
                    $(Self::$kind => $recipe,)*
                }
            }
        }
    };
}

policies! {
    /// Learned: DDPG with one weight per user (ONNX, as all learned policies)
    #[value(alias = "actor")]
    Ddpg: Learned,
    /// Learned: DDPG on the angles of all mirrors, as in the paper
    DdpgRaw: Learned,
    /// Learned: by the gradient through the channel model
    Analytic: Learned,
    /// Learned: deep Q-learning on a codebook of angles
    Dql: Learned,
    /// Learned: Q-learning with a table
    QLearning: Learned,
    /// Learned: SARSA with a table
    Sarsa: Learned,
    /// Model-based: aims mirrors by weights of the users, adjusted until they fit the rates (fixed point)
    FixedPoint: Direct(|room| super::model_based::ModelBased::fixed_point(room.users, room.mirrors).boxed()),
    /// Model-based: as fixed-point, then moves single mirrors to other users where that adds rate
    Greedy: Direct(|room| super::model_based::ModelBased::greedy(room.users, room.mirrors).boxed()),
    /// Model-based: the oracle's search on the controller's estimate instead of the true state; far slower than a tick
    Oracle: Direct(|room| super::model_based::ModelBased::oracle(room.users, room.mirrors).boxed()),
    /// Model-based: every assignment of mirrors to users; for about nine mirrors and three users
    Exhaustive: Direct(|room| super::exhaustive::Exhaustive::new(room.scenario).map_err(BuildError::Search)?.boxed()),
    /// Metaheuristic: the sine cosine algorithm on the angles of all mirrors
    SineCosine: Direct(|room| super::sine_cosine::sine_cosine(room.scenario, room.monotonic_ns).boxed()),
    /// Metaheuristic: particle swarm optimisation on the angles of all mirrors
    Pso: Direct(|room| super::pso::pso(room.scenario, room.monotonic_ns).boxed()),
    /// Each mirror serves the user to whom it brings the most light
    Nearest: Direct(|_| super::nearest::Nearest::new().boxed()),
    /// One random draw per mirror, the same for the complete run
    Random: Direct(|room| super::fixed::Fixed::random(room.mirrors, room.range_rad, room.scenario.seed).boxed()),
    /// Every mirror faces straight into the room
    Flat: Direct(|room| super::fixed::Fixed::flat(room.mirrors).boxed()),
    /// Every mirror is turned away from all users
    NoIrs: Direct(|room| super::fixed::Fixed::no_irs(room.mirrors, room.range_rad).boxed()),
    /// Publish the last angles again
    Hold: Direct(|_| super::fixed::Hold.boxed()),
}

/// How a policy is built.
enum Recipe {
    /// From the file of an actor.
    Learned,
    /// From the scenario alone.
    Direct(fn(&RoomFacts<'_>) -> Built),
}

type Built = Result<Box<dyn Policy>, BuildError>;

/// What the recipes read.
struct RoomFacts<'a> {
    scenario: &'a Scenario,
    users: usize,
    mirrors: usize,
    /// Largest angle of each axis, plus and minus, in rad.
    range_rad: f64,
    monotonic_ns: TimeSource,
}

/// Boxes a policy, for the rows of the table.
trait Boxed {
    fn boxed(self) -> Built;
}

impl<T: Policy + 'static> Boxed for T {
    fn boxed(self) -> Built {
        Ok(Box::new(self))
    }
}

impl PolicyKind {
    /// The policy where no other is named: it needs no actor, fits every room and decides within the
    /// latency budget.
    pub const DEFAULT: Self = Self::FixedPoint;

    /// The name on the command line and in file names.
    pub fn name(self) -> String {
        self.to_possible_value().map(|value| value.get_name().to_owned()).expect("every policy has a name")
    }

    /// Whether the policy is a trained network, stored as an ONNX file.
    pub fn is_learned(self) -> bool {
        matches!(self.recipe(), Learned)
    }

    /// Whether the shipped file of a learned policy serves any array and any number of users: its
    /// network is applied to each user.
    pub fn fits_any_array(self) -> bool {
        matches!(self, Self::Ddpg | Self::Analytic)
    }

    /// The names of all learned policies, separated by commas.
    pub fn learned_names() -> String {
        let learned = Self::value_variants().iter().filter(|kind| kind.is_learned());
        learned.map(|kind| kind.name()).collect::<Vec<_>>().join(", ")
    }
}

/// Builds a policy for a room.
///
/// # Errors
/// [`BuildError`] where a learned policy's actor is missing or does not fit the room, or the search
/// space is too large.
pub fn build(kind: PolicyKind, scenario: &Scenario, resources: &Resources<'_>) -> Result<Box<dyn Policy>, BuildError> {
    match kind.recipe() {
        Learned => {
            let actor = resources.actor.ok_or_else(|| BuildError::ActorExpected { policy: kind.name() })?;
            Actor::load(actor, scenario, resources.engine)?.named(kind.name()).boxed()
        }
        Direct(build) => build(&RoomFacts {
            scenario,
            users: scenario.users.count,
            mirrors: scenario.mirror_count(),
            range_rad: Limits::new(&scenario.control).range_rad(),
            monotonic_ns: resources.monotonic_ns,
        }),
    }
}

/// Builds the policy that decides when another fails; `None` for `hold`, which publishes no
/// command.
pub fn build_fallback(fallback: Fallback, scenario: &Scenario) -> Option<Box<dyn Policy>> {
    let (users, mirrors) = (scenario.users.count, scenario.mirror_count());
    match fallback {
        Fallback::FixedPoint => Some(Box::new(super::model_based::ModelBased::fixed_point(users, mirrors))),
        Fallback::Nearest => Some(Box::new(super::nearest::Nearest::new())),
        Fallback::Flat => Some(Box::new(super::fixed::Fixed::flat(mirrors))),
        Fallback::LastGood => Some(Box::new(super::fixed::Hold)),
        Fallback::Hold => None,
    }
}
