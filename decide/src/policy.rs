//! From an observation to mirror angles: one trait, many ways.
//!
//! A policy proposes; it neither limits nor checks its angles, which is the duty of [`crate::safety`]. It does not log, and reads no clock
//! save where a time budget is its definition. After the first few calls it does not allocate in our own code.

mod actor;
pub mod actor_file;
mod exhaustive;
mod fixed;
mod metaheuristic;
mod model_based;
mod nearest;
mod pso;
pub mod shipped;
mod sine_cosine;

use std::path::PathBuf;

use clap::ValueEnum;
use heliostat_channel::{ChannelModel, mirrors::MirrorAngles, solver::SolverError};
use heliostat_scenario::{Fallback, Scenario};
use thiserror::Error;

pub use actor::Actor;
pub use exhaustive::Exhaustive;
pub use fixed::{Fixed, Hold};
pub use model_based::ModelBased;
pub use nearest::Nearest;
pub use pso::Pso;
pub use sine_cosine::SineCosine;

use crate::{
    observation::{EncodeError, Observation},
    safety::{Limits, NotFinite},
};
use actor_file::{ActorError, ActorFile};

/// A way to turn the mirrors.
pub trait Policy: Send {
    /// The name on the command line and in summaries.
    fn name(&self) -> &str;

    /// Writes the angles for an observation; `out` has the size of the model's array.
    ///
    /// # Errors
    /// [`PolicyError`] where it cannot; `out` then holds nothing of use.
    fn act(
        &mut self,
        model: &ChannelModel,
        observation: &Observation,
        out: &mut MirrorAngles,
    ) -> Result<(), PolicyError>;

    /// Does what [`act`](Self::act) does, so that its code and data stay in the caches, and leaves behind nothing on which a later answer
    /// depends; `out` then holds nothing of use. A policy that remembers, and cannot undo it, does nothing here.
    fn rehearse(&mut self, _: &ChannelModel, _: &Observation, _out: &mut MirrorAngles) {}
}

/// Why a policy gave no angles.
#[derive(Debug, Error)]
pub enum PolicyError {
    /// The observation does not fit the network's input.
    #[error(transparent)]
    Observation(#[from] EncodeError),
    /// An angle is not a number, or infinite.
    #[error(transparent)]
    NotFinite(#[from] NotFinite),
    /// The search does not fit the room.
    #[error(transparent)]
    Search(#[from] SolverError),
    /// The inference engine failed.
    #[error("the inference engine failed: {message}")]
    Inference {
        /// The engine's own words.
        message: String,
    },
}

/// Why there is no such policy for a room.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum BuildError {
    /// The actor is missing or does not fit.
    #[error(transparent)]
    Actor(#[from] ActorError),
    /// There is too much to search.
    #[error("an exhaustive search cannot run here: {0}; take --policy oracle, whose answers equal it where it can run")]
    Search(SolverError),
    /// A file was given for a policy that reads none.
    #[error(
        "--model is the file of a learned policy, and {policy} reads none: leave it out, or take --policy {}",
        PolicyKind::learned_names()
    )]
    NoUseForModel {
        /// The policy's name.
        policy: String,
    },
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

    /// Refuses a file where the policy reads none.
    ///
    /// # Errors
    /// [`BuildError::NoUseForModel`].
    pub fn check_takes(self, actor: &ActorSource) -> Result<(), BuildError> {
        let useless = matches!(actor, ActorSource::Path(_)) && !self.is_learned();
        if useless { Err(BuildError::NoUseForModel { policy: self.name() }) } else { Ok(()) }
    }

    /// The names of all learned policies, with commas between them.
    pub fn learned_names() -> String {
        let learned = Self::value_variants().iter().filter(|kind| kind.is_learned());
        learned.map(|kind| kind.name()).collect::<Vec<_>>().join(", ")
    }
}

/// Where a learned policy's file comes from.
#[derive(Clone, Debug, Default)]
pub enum ActorSource {
    /// The built-in actor for the scenario's mode and array, of training seed 1.
    #[default]
    Shipped,
    /// The same of another training seed.
    ShippedSeed(u32),
    /// A file.
    Path(PathBuf),
    /// Bytes at hand.
    Bytes(ActorFile),
}

impl ActorSource {
    /// Fetches the bytes.
    ///
    /// # Errors
    /// [`ActorError`] where there is no such actor or it cannot be read.
    pub fn fetch(&self, policy: PolicyKind, scenario: &Scenario) -> Result<ActorFile, ActorError> {
        match self {
            Self::Shipped => shipped::find(policy, scenario, 1),
            Self::ShippedSeed(seed) => shipped::find(policy, scenario, *seed),
            Self::Path(path) => ActorFile::read(path),
            Self::Bytes(file) => Ok(file.clone()),
        }
    }
}

/// Builds a policy for a room.
///
/// # Errors
/// [`BuildError`] where the policy is learned and its actor is missing or does not fit, where it is not and one is given, or where it searches
/// more than can be searched.
pub fn build(kind: PolicyKind, scenario: &Scenario, actor: &ActorSource) -> Result<Box<dyn Policy>, BuildError> {
    kind.check_takes(actor)?;
    let (users, mirrors) = (scenario.users.count, scenario.mirror_count());
    let range_rad = Limits::new(&scenario.control).range_rad();
    Ok(match kind {
        PolicyKind::Ddpg
        | PolicyKind::DdpgRaw
        | PolicyKind::DdpgBasis
        | PolicyKind::Analytic
        | PolicyKind::Dql
        | PolicyKind::QLearning
        | PolicyKind::Sarsa => Box::new(Actor::load(&actor.fetch(kind, scenario)?, scenario)?.named(kind.name())),
        PolicyKind::FixedPoint => Box::new(ModelBased::fixed_point(users, mirrors)),
        PolicyKind::Greedy => Box::new(ModelBased::greedy(users, mirrors)),
        PolicyKind::Oracle => Box::new(ModelBased::oracle(users, mirrors)),
        PolicyKind::Exhaustive => Box::new(Exhaustive::new(scenario).map_err(BuildError::Search)?),
        PolicyKind::SineCosine => Box::new(SineCosine::new(scenario)),
        PolicyKind::Pso => Box::new(Pso::new(scenario)),
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
