//! A recording as an MCAP file: written in complete chunks, readable up to the last complete chunk.
//!
//! | in the file | holds |
//! | --- | --- |
//! | metadata `heliostat` | room, scenario, versions: see [`Header`] |
//! | channels `heliostat/v1/...` | payloads as received, encoding [`WIRE_ENCODING`] |
//! | channel [`PRESENCE_TOPIC`] | processes that joined and left the room, as JSON |
//! | other channels | derived data for viewers, see [`crate::scene`] and [`crate::series`] |
//! | metadata `heliostat.account` | counts of received and missing messages, as JSON; absent if the recording was cut |

mod declared;
mod read;
mod write;

use std::collections::BTreeMap;
use std::fmt;

use heliostat_proto::{NodeKind, VERSION};
use serde::{Deserialize, Serialize};
use thiserror::Error;

pub use read::{Entry, Reading, open};
pub use write::{Recording, Storage};

/// Message encoding of the channels that hold payloads as received.
pub const WIRE_ENCODING: &str = "heliostat.v1";
/// Topic of [`Presence`].
pub const PRESENCE_TOPIC: &str = "/presence";

const HEADER_NAME: &str = "heliostat";
const ACCOUNT_NAME: &str = "heliostat.account";

/// An error of writing or reading a recording.
#[derive(Debug, Error)]
pub enum RecordingError {
    /// No space is left; the chunks written before are complete.
    #[error(
        "no space is left for the recording: it ends after {written} complete messages, and {lost} more are lost; free some space, or choose another disk"
    )]
    Full {
        /// Messages in complete chunks.
        written: u64,
        /// Messages that were accepted and not written.
        lost: u64,
    },
    /// Writing failed otherwise.
    #[error("the recording cannot be written ({problem}): it ends after {written} messages, and {lost} more are lost")]
    Write {
        /// The message of the operating system or of the library.
        problem: String,
        /// Messages in complete chunks.
        written: u64,
        /// Messages that were accepted and not written.
        lost: u64,
    },
    /// The path no longer leads to the file that is being written.
    #[error("the recording {0} is gone: it was deleted or moved while it was written")]
    Gone(String),
    /// The file cannot be opened.
    #[error("{0}")]
    Open(String),
    /// The file cannot be read, or is not an MCAP file.
    #[error("the recording cannot be read: {0}")]
    Read(String),
    /// A file of another kind.
    #[error("the file {0}")]
    OtherKind(String),
    /// An MCAP file that is not a recording of a room.
    #[error(
        "the file is not a recording of a room: its metadata \"heliostat\" is missing; expected a file made by `heliostat record`"
    )]
    Foreign,
    /// More bytes follow the end of the recording.
    #[error(
        "the file goes on after the end of its recording, by {bytes} bytes; expected one recording for each file: \
         separate files that were joined, or copy the file again"
    )]
    GoesOn {
        /// Number of these bytes.
        bytes: u64,
    },
    /// A recording of another version of the contract.
    #[error("the recording uses version {found} of the contract; expected version {VERSION}")]
    Version {
        /// The version in the file.
        found: String,
    },
}

/// Data known before the first message.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// Name of the room.
    pub room: String,
    /// Name of the scenario.
    pub scenario_name: String,
    /// Hash of the effective scenario.
    pub scenario_hash: String,
    /// The effective scenario as TOML.
    pub scenario: String,
    /// Version of the recording program.
    pub software: String,
    /// Version of the contract.
    pub contract: String,
    /// When the recording began, UTC in ns.
    pub started_ns: String,
}

/// A process joined the room, or left it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Presence {
    /// The kind of process, by the name of its variant.
    #[serde(with = "node_by_name")]
    pub node: NodeKind,
    /// The source id in its stamps.
    pub source: u64,
    /// Whether it is in the room.
    pub alive: bool,
}

impl fmt::Display for Presence {
    /// One line for the operator: a room can have several processes of a kind.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { node, source, alive } = self;
        write!(formatter, "{node} {source:016x} is {}", if *alive { "alive" } else { "gone" })
    }
}

/// A kind of process as the name of its variant, such as `SimNode`.
mod node_by_name {
    use heliostat_proto::NodeKind;
    use serde::{Deserialize, Deserializer, Serializer, de::Error as _};

    pub fn serialize<S: Serializer>(node: &NodeKind, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(&format_args!("{node:?}"))
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<NodeKind, D::Error> {
        let name = String::deserialize(deserializer)?;
        let node = NodeKind::ALL.into_iter().find(|node| format!("{node:?}") == name);
        node.ok_or_else(|| D::Error::custom(format!("unknown process {name:?}")))
    }
}

/// A channel for derived data.
#[derive(Clone, Copy, Debug)]
pub struct Topic<'a> {
    /// The topic.
    pub name: &'a str,
    /// How its messages are encoded: `json` or `protobuf`.
    pub encoding: &'a str,
    /// Name of the schema.
    pub schema: &'a str,
    /// Encoding of the schema: `jsonschema` or `protobuf`.
    pub schema_encoding: &'a str,
    /// The schema.
    pub schema_data: &'a [u8],
}

impl Header {
    fn to_map(&self) -> BTreeMap<String, String> {
        let value = serde_json::to_value(self).expect("a header serialises to JSON");
        serde_json::from_value(value).expect("a header holds text only")
    }

    fn from_map(map: &BTreeMap<String, String>) -> Result<Self, RecordingError> {
        let value = serde_json::to_value(map).expect("a map of text serialises to JSON");
        serde_json::from_value(value).map_err(|error| {
            RecordingError::Read(format!("its metadata: {error}; expected a file made by `heliostat record`"))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_presence_in_words_names_the_process() {
        let mut presence = Presence { node: NodeKind::Controller, source: 0x2a, alive: true };
        assert_eq!(presence.to_string(), "controller 000000000000002a is alive");
        presence.alive = false;
        assert_eq!(presence.to_string(), "controller 000000000000002a is gone");
    }

    #[test]
    fn presence_names_each_kind_of_process() {
        for (node, name) in NodeKind::ALL.into_iter().zip(["Controller", "SimNode", "Driver", "Tracker", "Viewer"]) {
            let presence = Presence { node, source: 7, alive: true };
            let text = format!(r#"{{"node":"{name}","source":7,"alive":true}}"#);
            assert_eq!(serde_json::to_string(&presence).unwrap(), text);
            assert_eq!(serde_json::from_str::<Presence>(&text).unwrap(), presence);
        }
        assert!(serde_json::from_str::<Presence>(r#"{"node":"Lamp","source":7,"alive":true}"#).is_err());
    }
}
