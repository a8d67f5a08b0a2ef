//! The metadata of an actor's ONNX file, and whether the actor fits a room; read before the network
//! is built.
//!
//! The inference engine returns no metadata, so the file is parsed with its protobuf types. Every
//! refusal names the file, the value found, the value expected and what to do.

use std::borrow::Cow;

use heliostat_onnx::{
    ModelProto, ValueInfoProto, describe,
    standard::{VersionError, check_versions},
    tensor::first_not_finite,
};
use heliostat_scenario::Scenario;
use prost::Message;
use thiserror::Error;

use super::removed::{Removed, removed};
use crate::observe::observation::{OBSERVATION_VERSION, ObservationEncoder};

/// Longest text of a file that a message repeats, in characters.
const QUOTED_MAX: usize = 64;

/// Name of the network's only input.
pub const INPUT_NAME: &str = "observation";
/// Name of the network's only output.
pub const OUTPUT_NAME: &str = "angles";

/// The action of a network that gives the angles; that of a file without an entry.
pub const ANGLES: &str = "angles";

/// The keys of the metadata that every actor carries.
pub mod key {
    /// Beginning of all keys.
    pub const PREFIX: &str = "heliostat.";
    /// Version of the observation's layout.
    pub const OBSERVATION_VERSION: &str = "heliostat.observation_version";
    /// Largest number of users.
    pub const USERS_MAX: &str = "heliostat.users_max";
    /// Number of mirrors.
    pub const MIRRORS: &str = "heliostat.mirrors";
    /// What the output is: [`ANGLES`](super::ANGLES), also where the entry is missing.
    pub const ACTION: &str = "heliostat.action";
    /// Channel mode that the actor was trained in.
    pub const MODE: &str = "heliostat.mode";
    /// Hash of the optical geometry.
    pub const GEOMETRY: &str = "heliostat.geometry";
    /// Command that made the file.
    pub const TRAINING_COMMAND: &str = "heliostat.training_command";
    /// Seed of the training.
    pub const SEED: &str = "heliostat.seed";
    /// Scenario of the training.
    pub const SCENARIO: &str = "heliostat.scenario";
    /// Scores on held-out states.
    pub const SCORES: &str = "heliostat.scores";
    /// Licence of the weights.
    pub const LICENCE: &str = "heliostat.licence";
}

/// Why an actor cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum ActorError {
    /// The bytes are not an ONNX model.
    #[error("{origin} is not an ONNX model: {message}")]
    NotOnnx {
        /// The file.
        origin: String,
        /// Why.
        message: String,
    },
    /// The version of the format or of the operators is not known.
    #[error("{origin} has {unknown}")]
    Version {
        /// The file.
        origin: String,
        /// The version found and those expected.
        unknown: VersionError,
    },
    /// No policy has the action.
    #[error(
        "{origin} has the unknown action {found}, expected \"{ANGLES}\": \
         correct its metadata \"{}\", or export the actor again with `heliostat train`",
        key::ACTION
    )]
    Action {
        /// The file.
        origin: String,
        /// The action found.
        found: String,
    },
    /// The action was removed.
    #[error("{origin}: {removed}")]
    RemovedAction {
        /// The file.
        origin: String,
        /// What was removed.
        removed: Removed,
    },
    /// Inputs or outputs have other names or another number.
    #[error("{origin} has {side} {found:?}, expected exactly one, \"{expected}\"")]
    Ports {
        /// The file.
        origin: String,
        /// "inputs" or "outputs".
        side: &'static str,
        /// The names found.
        found: Vec<String>,
        /// The name expected.
        expected: &'static str,
    },
    /// The input or output has another shape or element type.
    #[error(
        "{origin}: \"{port}\" is {found}, expected f32 [1, {expected}] for users.count = {users_max} and an array of size {mirrors}; \
         export the actor again with `heliostat train`"
    )]
    Shape {
        /// The file.
        origin: String,
        /// The input or output.
        port: &'static str,
        /// Type and shape found.
        found: String,
        /// Length expected.
        expected: usize,
        /// Users by the metadata.
        users_max: usize,
        /// Mirrors by the metadata.
        mirrors: usize,
    },
    /// The file has no metadata of an actor at all.
    #[error(
        "{origin} is an ONNX file without the metadata of an actor (\"{}\" and others): add the entries that \
         `heliostat config --as-json actor` prints for the scenario, or export an actor with `heliostat train`",
        key::OBSERVATION_VERSION
    )]
    NoMetadata {
        /// The file.
        origin: String,
    },
    /// A tensor holds a value that is not finite.
    #[error(
        "{origin}: the tensor {tensor} holds a value that is not finite, expected finite weights; \
         export the actor again, or train it again if the training diverged"
    )]
    NotFinite {
        /// The file.
        origin: String,
        /// The tensor's name.
        tensor: String,
    },
    /// The engine computes other angles than the reference evaluation.
    #[error(
        "{origin}: the inference engine and the reference evaluation give other angles on {differing} of {compared} \
         observations ({example}), expected equal ones; check the network for invalid operations such as 0/0, and \
         export it again with other operators"
    )]
    Disagrees {
        /// The file.
        origin: String,
        /// Observations on which the angles differ.
        differing: usize,
        /// Observations compared.
        compared: usize,
        /// One of the differences.
        example: String,
    },
    /// Two engines compute other angles.
    #[error(
        "{origin}: the engines {} and {} give other angles on {differing} of {compared} observations ({example}), \
         expected equal ones; check the network for invalid operations such as 0/0, and export it again",
        engines[0], engines[1]
    )]
    EnginesDisagree {
        /// The file.
        origin: String,
        /// The names of the engines, or of the reference evaluation.
        engines: [&'static str; 2],
        /// Observations on which the angles differ.
        differing: usize,
        /// Observations compared.
        compared: usize,
        /// One of the differences.
        example: String,
    },
    /// A metadata entry is missing or unreadable.
    #[error(
        "{origin} has no usable metadata \"{key}\" (found {found}), expected the entries that \
         `heliostat config --as-json actor` prints; export the actor again with `heliostat train`",
        found = found.as_ref().map_or("none".to_owned(), |value| quoted(value))
    )]
    Metadata {
        /// The file.
        origin: String,
        /// The entry.
        key: &'static str,
        /// The value found.
        found: Option<String>,
    },
    /// The actor was made for something else.
    #[error("{origin} was made for {what} {found}, expected {expected} as in this room; {advice}")]
    Unfit {
        /// The file.
        origin: String,
        /// What differs.
        what: &'static str,
        /// The actor's value.
        found: String,
        /// The room's value.
        expected: String,
        /// What to do.
        advice: &'static str,
    },
    /// The inference engine refused the network.
    #[error("{origin}: the inference engine refused the network: {message}")]
    Engine {
        /// The file.
        origin: String,
        /// The engine's message.
        message: String,
    },
}

/// The bytes of an actor and where they came from.
#[derive(Clone, Debug)]
pub struct ActorFile {
    /// Where the bytes came from, for messages.
    pub origin: String,
    /// The ONNX model.
    pub bytes: Cow<'static, [u8]>,
}

/// The metadata of an actor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ActorInfo {
    origin: String,
    /// Version of the observation's layout.
    pub observation_version: u32,
    /// Largest number of users.
    pub users_max: usize,
    /// Number of mirrors.
    pub mirrors: usize,
    /// Channel mode it was trained in.
    pub mode: String,
    /// Hash of the optical geometry it was trained in.
    pub geometry: String,
    /// Every metadata entry, in the file's order.
    pub entries: Vec<(String, String)>,
}

impl ActorInfo {
    /// Reads metadata and shapes, and checks that they agree with each other.
    ///
    /// # Errors
    /// [`ActorError`] where the bytes are not an ONNX model, or a model that no controller can run.
    pub fn read(file: &ActorFile) -> Result<Self, ActorError> {
        let origin = file.origin.clone();
        let not_onnx = |message: String| ActorError::NotOnnx { origin: origin.clone(), message };
        let model = ModelProto::decode(file.bytes.as_ref()).map_err(|error| not_onnx(error.to_string()))?;
        let (versions, not_finite) = (check_versions(&model), first_not_finite(&model));
        let graph = model.graph.ok_or_else(|| not_onnx("it holds no graph".into()))?;
        versions.map_err(|unknown| ActorError::Version { origin: origin.clone(), unknown })?;
        if let Some(tensor) = not_finite {
            return Err(ActorError::NotFinite { origin: file.origin.clone(), tensor });
        }
        let entries: Vec<_> = model.metadata_props.into_iter().map(|entry| (entry.key, entry.value)).collect();
        if !entries.iter().any(|(key, _)| key.starts_with(key::PREFIX)) {
            return Err(ActorError::NoMetadata { origin: file.origin.clone() });
        }
        let reader = MetadataReader { origin: &file.origin, entries: &entries };
        if let Some(action) = reader.find(key::ACTION).filter(|action| *action != ANGLES) {
            return Err(match removed(action) {
                Some(removed) => ActorError::RemovedAction { origin: origin.clone(), removed },
                None => ActorError::Action { origin: origin.clone(), found: quoted(action) },
            });
        }
        let info = Self {
            observation_version: reader.number(key::OBSERVATION_VERSION)?,
            users_max: reader.number(key::USERS_MAX)?,
            mirrors: reader.number(key::MIRRORS)?,
            mode: reader.text(key::MODE)?,
            geometry: reader.text(key::GEOMETRY)?,
            entries: entries.clone(),
            origin: file.origin.clone(),
        };
        // Weights may be listed as inputs too, in files written for old versions of the format.
        let is_weight = |port: &&ValueInfoProto| graph.initializer.iter().any(|weight| weight.name == port.name);
        let inputs: Vec<_> = graph.input.iter().filter(|port| !is_weight(port)).collect();
        let outputs: Vec<_> = graph.output.iter().collect();
        // An input of another version has another length. `check_fits` refuses it by its version.
        if info.observation_version == OBSERVATION_VERSION {
            info.check_port("inputs", INPUT_NAME, &inputs, info.encoder().len())?;
        }
        info.check_port("outputs", OUTPUT_NAME, &outputs, 2 * info.mirrors)?;
        Ok(info)
    }

    /// Where the file came from, for messages.
    pub fn origin(&self) -> &str {
        &self.origin
    }

    /// The encoder that fills this actor's input.
    pub fn encoder(&self) -> ObservationEncoder {
        ObservationEncoder::new(self.users_max, self.mirrors)
    }

    /// Checks that the actor fits a room.
    ///
    /// # Errors
    /// [`ActorError::Unfit`] with the first difference.
    pub fn check_fits(&self, scenario: &Scenario) -> Result<(), ActorError> {
        let unfit = |what, found: String, expected: String, advice| {
            Err(ActorError::Unfit { origin: self.origin.clone(), what, found, expected, advice })
        };
        let train = "train an actor for this scenario with `heliostat train`, or choose the policy fixed-point, which needs no file";
        if self.observation_version != OBSERVATION_VERSION {
            let (found, expected) = (self.observation_version.to_string(), OBSERVATION_VERSION.to_string());
            return unfit("observation version", found, expected, "train it again with this release of heliostat");
        }
        if self.mirrors != scenario.mirror_count() {
            let expected = format!("{} ({})", scenario.mirror_count(), scenario.mirrors);
            return unfit("a number of mirrors of", self.mirrors.to_string(), expected, train);
        }
        if scenario.users.count > self.users_max {
            let found = self.users_max.to_string();
            return unfit("a number of users of at most", found, scenario.users.count.to_string(), train);
        }
        let mode = scenario.channel.mode.name();
        if self.mode != mode {
            return unfit("the channel mode", self.mode.clone(), mode.into(), train);
        }
        let geometry = scenario.geometry_hash();
        if self.geometry != geometry {
            let advice = "room, access points, array or receiver differ from those of the training; \
                          train an actor for them with `heliostat train`, or choose the policy fixed-point, which needs no file";
            return unfit("the optical geometry", self.geometry.clone(), geometry, advice);
        }
        Ok(())
    }

    fn check_port(
        &self,
        side: &'static str,
        expected: &'static str,
        ports: &[&ValueInfoProto],
        length: usize,
    ) -> Result<(), ActorError> {
        let [port] = ports else { return Err(self.wrong_ports(side, expected, ports)) };
        if port.name != expected {
            return Err(self.wrong_ports(side, expected, ports));
        }
        let found = describe(port);
        if found == format!("f32 [1, {length}]") {
            return Ok(());
        }
        let (origin, users_max, mirrors) = (self.origin.clone(), self.users_max, self.mirrors);
        Err(ActorError::Shape { origin, port: expected, found, expected: length, users_max, mirrors })
    }

    fn wrong_ports(&self, side: &'static str, expected: &'static str, ports: &[&ValueInfoProto]) -> ActorError {
        let found = ports.iter().map(|port| port.name.clone()).collect();
        ActorError::Ports { origin: self.origin.clone(), side, found, expected }
    }
}

/// The beginning of a text of a file, in quotation marks and without control characters.
fn quoted(text: &str) -> String {
    format!("{:?}", text.chars().take(QUOTED_MAX).collect::<String>())
}

struct MetadataReader<'a> {
    origin: &'a str,
    entries: &'a [(String, String)],
}

impl MetadataReader<'_> {
    fn find(&self, key: &str) -> Option<&String> {
        self.entries.iter().find(|(name, _)| name == key).map(|(_, value)| value)
    }

    fn text(&self, key: &'static str) -> Result<String, ActorError> {
        self.find(key).cloned().ok_or_else(|| self.unusable(key))
    }

    fn number<T: std::str::FromStr>(&self, key: &'static str) -> Result<T, ActorError> {
        self.find(key).and_then(|value| value.parse().ok()).ok_or_else(|| self.unusable(key))
    }

    fn unusable(&self, key: &'static str) -> ActorError {
        ActorError::Metadata { origin: self.origin.into(), key, found: self.find(key).cloned() }
    }
}
