//! The metadata of an actor's ONNX file, and whether the actor fits a room; read before the network
//! is built.
//!
//! A file is an observation kind, an action kind and a network between them ([`ObservationKind`],
//! [`ActionKind`]); the network alone is in the graph. Every refusal names the file, the value
//! found, the value expected and what to do.

mod error;
mod foreign;
mod kind;
mod metadata;

use std::borrow::Cow;

use heliostat_onnx::{
    GraphProto, ModelProto, ValueInfoProto, describe, f32_extents, is_f32, standard::check_versions,
    tensor::first_not_finite,
};
use heliostat_scenario::{Scenario, short_hash};
use prost::Message;

use crate::observe::observation::{OBSERVATION_VERSION, ObservationEncoder, USERS_CAPACITY};
use metadata::{MetadataReader, quoted};

pub use error::{ActorError, ActorProblem};
pub use kind::{ActionKind, CODEBOOK, ObservationKind, WEIGHTS};
pub use metadata::key;

/// Name of the network's only input.
pub const INPUT_NAME: &str = "observation";

/// The action of a network that gives the angles, and its only output; that of a file without an entry.
pub const ANGLES: &str = "angles";

/// The metadata of an actor for at most `users_max` users of a scenario's room.
pub fn room_entries(scenario: &Scenario, users_max: usize) -> Vec<(String, String)> {
    let entries = [
        (key::OBSERVATION_VERSION, OBSERVATION_VERSION.to_string()),
        (key::USERS_MAX, users_max.to_string()),
        (key::MIRRORS, scenario.mirror_count().to_string()),
        (key::MODE, scenario.channel.mode.name().to_owned()),
        (key::GEOMETRY, scenario.geometry_hash()),
    ];
    entries.map(|(key, value)| (key.to_owned(), value)).into()
}

/// The bytes of an actor and where they came from.
#[derive(Clone, Debug)]
pub struct ActorFile {
    /// Where the bytes came from, for messages.
    pub origin: String,
    /// The ONNX model.
    pub bytes: Cow<'static, [u8]>,
}

impl ActorFile {
    /// The [`short_hash`] of the bytes.
    pub fn hash(&self) -> String {
        short_hash(&self.bytes)
    }

    /// The refusal of this file.
    pub(super) fn refused(&self, problem: ActorProblem) -> ActorError {
        ActorError { origin: self.origin.clone(), problem }
    }
}

/// The metadata of an actor.
#[derive(Clone, Debug, PartialEq)]
pub struct ActorInfo {
    origin: String,
    /// Version of the observation's layout.
    pub observation_version: u32,
    /// What the network reads.
    pub observation: ObservationKind,
    /// What the network gives.
    pub action: ActionKind,
    /// Largest number of users.
    pub users_max: usize,
    /// Number of mirrors and hash of the optical geometry it was trained in; `None` for a file that
    /// serves any array and room.
    pub array: Option<(usize, String)>,
    /// Channel mode it was trained in.
    pub mode: String,
    /// First extent of the input; `None` where it is open.
    pub rows: Option<usize>,
    /// Values of a row of the input.
    pub columns: usize,
    /// Every metadata entry, in the file's order.
    pub entries: Vec<(String, String)>,
}

impl ActorInfo {
    /// Reads metadata and shapes, and checks that they agree with each other.
    ///
    /// # Errors
    /// [`ActorError`] where the bytes are not an ONNX model, or a model that no controller can run.
    pub fn read(file: &ActorFile) -> Result<Self, ActorError> {
        Self::of_file(file).map_err(|problem| file.refused(problem))
    }

    fn of_file(file: &ActorFile) -> Result<Self, ActorProblem> {
        if let Some(what) = foreign::foreign(&file.bytes) {
            return Err(ActorProblem::Foreign { what });
        }
        let not_onnx = |message: &str| ActorProblem::NotOnnx { message: message.into() };
        let unreadable = |_| not_onnx("its bytes are not in the format; copy or export it again");
        let model = ModelProto::decode(file.bytes.as_ref()).map_err(unreadable)?;
        let (versions, not_finite) = (check_versions(&model), first_not_finite(&model));
        let graph = model.graph.ok_or_else(|| not_onnx("it holds no graph"))?;
        versions.map_err(|unknown| ActorProblem::Version { unknown })?;
        if let Some(tensor) = not_finite {
            return Err(ActorProblem::NotFinite { tensor });
        }
        let entries: Vec<_> = model.metadata_props.into_iter().map(|entry| (entry.key, entry.value)).collect();
        if !entries.iter().any(|(key, _)| key.starts_with(key::PREFIX)) {
            return Err(ActorProblem::NoMetadata);
        }
        let mut info = Self::of_entries(&file.origin, entries)?;
        info.check_ports(&graph)?;
        Ok(info)
    }

    /// What the metadata says, before the ports of the graph are known.
    fn of_entries(origin: &str, entries: Vec<(String, String)>) -> Result<Self, ActorProblem> {
        let reader = MetadataReader(&entries);
        let action = match reader.find(key::ACTION).map_or(ANGLES, String::as_str) {
            ANGLES => ActionKind::Angles,
            WEIGHTS => ActionKind::Weights(reader.head()?),
            CODEBOOK => ActionKind::Codebook,
            other => return Err(ActorProblem::Action { found: quoted(other) }),
        };
        let name = reader.find(key::OBSERVATION).map_or(ObservationKind::Flat.name(), String::as_str);
        let observation = ObservationKind::ALL.into_iter().find(|kind| kind.name() == name);
        let observation = observation.ok_or_else(|| ActorProblem::Observation { found: quoted(name) })?;
        if !observation.actions().contains(&action.name()) {
            let expected = observation.actions().join(" or ");
            let (action, observation) = (action.name(), observation.name());
            return Err(ActorProblem::Combination { action, observation, expected });
        }
        let array = if observation.fits_any_array() {
            None
        } else {
            Some((reader.number(key::MIRRORS)?, reader.text(key::GEOMETRY)?))
        };
        let users_max = observation.users_max().map_or_else(|| reader.number(key::USERS_MAX), Ok)?;
        Ok(Self {
            observation_version: reader.number(key::OBSERVATION_VERSION)?,
            mode: reader.text(key::MODE)?,
            observation,
            action,
            users_max,
            array,
            rows: None,
            columns: 0,
            origin: origin.to_owned(),
            entries,
        })
    }

    /// Where the file came from, for messages.
    pub fn origin(&self) -> &str {
        &self.origin
    }

    /// The refusal of this actor.
    pub(super) fn refused(&self, problem: ActorProblem) -> ActorError {
        ActorError { origin: self.origin.clone(), problem }
    }

    /// A metadata entry.
    pub fn entry(&self, key: &str) -> Option<&str> {
        self.entries.iter().find(|(name, _)| name == key).map(|(_, value)| value.as_str())
    }

    /// The layout of the observation vector that describes a room to this actor.
    pub fn vector_encoder(&self, mirrors: usize) -> ObservationEncoder {
        let is_any = self.observation.fits_any_array();
        ObservationEncoder::new(if is_any { USERS_CAPACITY } else { self.users_max }, mirrors)
    }

    /// Checks that the actor fits a room.
    ///
    /// # Errors
    /// [`ActorProblem::Unfit`] with the first difference.
    pub fn check_fits(&self, scenario: &Scenario) -> Result<(), ActorError> {
        let unfit = |what, found: String, expected: String, advice| {
            Err(self.refused(ActorProblem::Unfit { what, found, expected, advice }))
        };
        let train = "train an actor for this scenario with `heliostat-lab train`, or choose the policy fixed-point, which needs no file";
        if self.observation_version != OBSERVATION_VERSION {
            let (found, expected) = (self.observation_version.to_string(), OBSERVATION_VERSION.to_string());
            return unfit("observation version", found, expected, "train it again with this release of heliostat");
        }
        let mirrors = self.array.as_ref().map(|(mirrors, _)| *mirrors);
        if let Some(mirrors) = mirrors.filter(|mirrors| *mirrors != scenario.mirror_count()) {
            let expected = format!("{} ({})", scenario.mirror_count(), scenario.mirrors);
            return unfit("a number of mirrors of", mirrors.to_string(), expected, train);
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
        if let Some((_, found)) = self.array.as_ref().filter(|(_, found)| *found != geometry) {
            let advice = "room, access points, array or receiver differ from those of the training; \
                          train an actor for them with `heliostat-lab train`, or choose the policy fixed-point, which needs no file";
            return unfit("the optical geometry", found.clone(), geometry, advice);
        }
        Ok(())
    }

    /// Checks inputs and outputs, and notes the shape of the input.
    fn check_ports(&mut self, graph: &GraphProto) -> Result<(), ActorProblem> {
        // Weights may be listed as inputs too, in files written for old versions of the format.
        let is_weight = |port: &&ValueInfoProto| graph.initializer.iter().any(|weight| weight.name == port.name);
        let inputs: Vec<_> = graph.input.iter().filter(|port| !is_weight(port)).collect();
        let input = self.only_port("inputs", INPUT_NAME, &inputs)?;
        let output = self.only_port("outputs", self.action.output(), &graph.output.iter().collect::<Vec<_>>())?;
        let mirrors = self.array.as_ref().map_or(0, |(mirrors, _)| *mirrors);
        let columns = self.observation.columns(self.users_max, mirrors);
        let (rows, found) = extents(input);
        // An input of another version has another length. `check_fits` refuses it by its version.
        let is_present = self.observation_version == OBSERVATION_VERSION;
        let has_rows = self.observation == ObservationKind::Codewords || matches!(rows, Some(None | Some(1)));
        let found = found.filter(|found| !is_present || (has_rows && columns.admit(*found)));
        self.columns = found.ok_or_else(|| self.wrong_shape(input, columns.text()))?;
        self.rows = rows.flatten();
        let columns = match self.action {
            ActionKind::Angles => Some(2 * mirrors),
            ActionKind::Weights(_) if self.observation == ObservationKind::Users => Some(1),
            ActionKind::Weights(_) => Some(self.users_max),
            // The codebook belongs to the room: the length is checked at the load.
            ActionKind::Codebook => None,
        };
        let (rows, found) = extents(output);
        let has_rows = self.action == ActionKind::Codebook || matches!(rows, Some(None | Some(1)));
        match columns {
            Some(columns) if !(has_rows && found == Some(columns)) => {
                Err(self.wrong_shape(output, columns.to_string()))
            }
            None if found.is_none() => Err(self.wrong_shape(output, "codewords".into())),
            _ => Ok(()),
        }
    }

    fn only_port<'a>(
        &self,
        side: &'static str,
        expected: &'static str,
        ports: &[&'a ValueInfoProto],
    ) -> Result<&'a ValueInfoProto, ActorProblem> {
        match ports {
            [port] if port.name == expected => Ok(port),
            _ => {
                let found = ports.iter().map(|port| port.name.clone()).collect();
                Err(ActorProblem::Ports { side, found, expected })
            }
        }
    }

    fn wrong_shape(&self, port: &ValueInfoProto, columns: String) -> ActorProblem {
        let rows = if self.observation == ObservationKind::Users { "rows" } else { "1" };
        let why = match &self.array {
            Some((mirrors, _)) => format!("for users.count = {} and an array of size {mirrors}", self.users_max),
            None => format!("for the observation {}", self.observation.name()),
        };
        let is_batch = matches!(extents(port).0, Some(Some(rows)) if rows != 1);
        let advice = if is_batch {
            "export it with a fixed batch of 1"
        } else if is_f32(port) {
            "export the actor in this shape"
        } else {
            "export the actor with 32-bit floats, in PyTorch after `module.float()`"
        };
        let (port, found) = (port.name.clone(), describe(port));
        ActorProblem::Shape { port, found, expected: format!("f32 [{rows}, {columns}] {why}"), advice }
    }
}

/// First and last extent of a table of 32-bit floats: `None` for another type or rank; the first is
/// `Some(None)` where it is open.
fn extents(port: &ValueInfoProto) -> (Option<Option<usize>>, Option<usize>) {
    match f32_extents(port).as_deref() {
        Some([rows, columns]) => (Some(*rows), *columns),
        _ => (None, None),
    }
}
