//! Which engine evaluates a learned policy.

use std::{fmt, str::FromStr};

use heliostat_core::policy::{
    self, Actor, DENSE, DenseEngine, Finding, Policy, PolicyKind, Resources,
    actor_file::{ActorError, ActorFile},
};
use heliostat_scenario::Scenario;
use thiserror::Error;

use crate::{
    embedded::{EMBEDDED, EmbeddedEngine},
    error::BuildError,
    source::ActorSource,
    time::monotonic_ns,
};

/// The names of all embedded engines, each with the build that has it.
const EMBEDDED_ENGINES: [(&str, &str); 3] = [
    ("tract", "a build with default features"),
    ("ort", "a build with `--no-default-features --features onnxruntime`"),
    ("reference", "a build with `--no-default-features`"),
];

/// Which engine evaluates a learned policy.
///
/// A dense graph is evaluated on 64 observations by both engines when it is loaded, whichever is
/// chosen. An actor on which they disagree is refused.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum EngineChoice {
    /// The dense engine for dense graphs, the embedded one for all others.
    #[default]
    Auto,
    /// The dense engine; other graphs are refused.
    Dense,
    /// The inference library of this build.
    Embedded,
}

/// No engine of this build has the name.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum UnknownEngine {
    /// No build has it.
    #[error("unknown engine \"{name}\": expected auto, dense or {EMBEDDED}")]
    Unknown {
        /// The name.
        name: String,
    },
    /// Another build has it.
    #[error(
        "the engine {name} is not part of this build, which has {EMBEDDED}: choose auto, dense or {EMBEDDED}, or use {build}"
    )]
    Absent {
        /// The name.
        name: String,
        /// The build that has it.
        build: &'static str,
    },
}

impl FromStr for EngineChoice {
    type Err = UnknownEngine;

    fn from_str(name: &str) -> Result<Self, UnknownEngine> {
        match name {
            "auto" => Ok(Self::Auto),
            DENSE => Ok(Self::Dense),
            EMBEDDED => Ok(Self::Embedded),
            _ => Err(match EMBEDDED_ENGINES.iter().find(|(known, _)| *known == name) {
                Some((_, build)) => UnknownEngine::Absent { name: name.into(), build },
                None => UnknownEngine::Unknown { name: name.into() },
            }),
        }
    }
}

impl fmt::Display for EngineChoice {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Auto => "auto",
            Self::Dense => DENSE,
            Self::Embedded => EMBEDDED,
        })
    }
}

impl EngineChoice {
    /// Builds a policy for a room; a learned one reads its file from `source`.
    ///
    /// # Errors
    /// [`BuildError`] where the file is missing, does not fit the room, or is given for a policy that
    /// reads none.
    pub fn build(
        self,
        kind: PolicyKind,
        scenario: &Scenario,
        source: &ActorSource,
    ) -> Result<Box<dyn Policy>, BuildError> {
        source.check_used_by(kind)?;
        if kind.is_learned() {
            let file = source.fetch(kind, scenario)?;
            return Ok(Box::new(self.load_policy(kind, &file, scenario)?));
        }
        let resources = Resources { actor: None, engine: &EmbeddedEngine, monotonic_ns };
        Ok(policy::build(kind, scenario, &resources)?)
    }

    /// Builds a policy for a room and, if it is learned, tries it on sampled observations: for a
    /// controller, and for checks before a run.
    ///
    /// # Errors
    /// As [`build`](Self::build), and where the engine does not evaluate the network as a reference
    /// evaluation does.
    pub fn build_tried(
        self,
        kind: PolicyKind,
        scenario: &Scenario,
        source: &ActorSource,
    ) -> Result<(Box<dyn Policy>, Vec<Finding>), BuildError> {
        if !kind.is_learned() {
            return Ok((self.build(kind, scenario, source)?, Vec::new()));
        }
        let file = source.fetch(kind, scenario)?;
        let mut actor = self.load_policy(kind, &file, scenario)?;
        let findings = actor.try_out(&file, scenario, monotonic_ns).map_err(policy::BuildError::from)?;
        Ok((Box::new(actor), findings))
    }

    fn load_policy(self, kind: PolicyKind, file: &ActorFile, scenario: &Scenario) -> Result<Actor, BuildError> {
        Ok(self.load_actor(file, scenario).map_err(policy::BuildError::from)?.named(kind.name()))
    }

    /// Loads an actor for a room, and compares the engines where its graph is dense.
    ///
    /// A dense graph that the embedded engine refuses is compared with the reference evaluation.
    ///
    /// # Errors
    /// [`ActorError`] where the file does not fit the room, the engine refuses it, or two engines
    /// disagree.
    pub fn load_actor(self, file: &ActorFile, scenario: &Scenario) -> Result<Actor, ActorError> {
        let embedded = || Actor::load(file, scenario, &EmbeddedEngine);
        let mut dense = match Actor::load(file, scenario, &DenseEngine) {
            Ok(dense) => dense,
            Err(ActorError::Engine { .. }) if self != Self::Dense => return embedded(),
            Err(refusal) => return Err(refusal),
        };
        match embedded() {
            Ok(mut embedded) => {
                dense.check_agrees_with(&mut embedded, scenario, monotonic_ns)?;
                Ok(if self == Self::Embedded { embedded } else { dense })
            }
            Err(refusal) if self == Self::Embedded => Err(refusal),
            Err(_) => {
                dense.check_agrees_with_reference(file, scenario, monotonic_ns)?;
                Ok(dense)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_and_an_engine_of_another_build_is_refused_with_what_to_do() {
        for choice in [EngineChoice::Auto, EngineChoice::Dense, EngineChoice::Embedded] {
            assert_eq!(choice.to_string().parse(), Ok(choice));
        }
        let (other, _) = EMBEDDED_ENGINES.into_iter().find(|(name, _)| *name != EMBEDDED).expect("two builds");
        let absent = other.parse::<EngineChoice>().expect_err("another build has it").to_string();
        assert!([other, EMBEDDED, "features"].iter().all(|word| absent.contains(word)), "{absent}");
        let unknown = "abacus".parse::<EngineChoice>().expect_err("no engine").to_string();
        assert!(["abacus", "auto", "dense", EMBEDDED].iter().all(|word| unknown.contains(word)), "{unknown}");
    }
}
