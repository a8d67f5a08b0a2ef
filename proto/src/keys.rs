//! Where each message travels: key expressions under a room's name, with the contract's version in the key.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Longest name of a room in bytes.
pub const MAX_ROOM_NAME: usize = 64;

const PREFIX: &str = "heliostat/v1";

/// A sort of process that takes part in a room.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum NodeKind {
    /// Decides the angles.
    #[default]
    Controller,
    /// Simulates a whole room: users, receivers, mirrors.
    SimNode,
    /// Drives a real array.
    Driver,
    /// Finds real users and obstacles.
    Tracker,
    /// Only reads: user interfaces, recorders, the command line.
    Viewer,
}

impl NodeKind {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Controller, Self::SimNode, Self::Driver, Self::Tracker, Self::Viewer];

    /// The name in keys.
    pub fn name(self) -> &'static str {
        match self {
            Self::Controller => "controller",
            Self::SimNode => "sim-node",
            Self::Driver => "driver",
            Self::Tracker => "tracker",
            Self::Viewer => "viewer",
        }
    }

    /// The node with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|node| node.name() == name)
    }
}

impl fmt::Display for NodeKind {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}

/// Why a text cannot name a room.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum RoomError {
    /// Nothing there.
    #[error("the name of the room is empty: wanted 1 to {MAX_ROOM_NAME} letters, digits, '-' or '_'")]
    Empty,
    /// Longer than allowed.
    #[error("the name of the room has {found} bytes: wanted at most {MAX_ROOM_NAME}")]
    TooLong {
        /// Bytes found.
        found: usize,
    },
    /// A character that could mean something else in a key.
    #[error("the name of the room \"{name}\" contains {found:?}: wanted only ASCII letters, digits, '-' and '_'")]
    BadCharacter {
        /// The name.
        name: String,
        /// The character.
        found: char,
    },
}

/// The name of a room: 1 to 64 ASCII letters, digits, '-' or '_'. It gives the keys of everything said in the room.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Room {
    name: String,
}

impl Room {
    /// Checks the name.
    ///
    /// # Errors
    /// [`RoomError`] names what is wrong with it.
    pub fn new(name: &str) -> Result<Self, RoomError> {
        let allowed = |c: &char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_');
        if name.is_empty() {
            return Err(RoomError::Empty);
        }
        if let Some(found) = name.chars().find(|c| !allowed(c)) {
            return Err(RoomError::BadCharacter { name: name.to_owned(), found });
        }
        if name.len() > MAX_ROOM_NAME {
            return Err(RoomError::TooLong { found: name.len() });
        }
        Ok(Self { name: name.to_owned() })
    }

    /// The name.
    pub fn name(&self) -> &str {
        &self.name
    }

    fn key(&self, rest: &str) -> String {
        format!("{PREFIX}/{}/{rest}", self.name)
    }

    /// [`UserReport`](crate::UserReport)s.
    pub fn users(&self) -> String {
        self.key("users")
    }

    /// [`ChannelReport`](crate::ChannelReport)s.
    pub fn channel(&self) -> String {
        self.key("channel")
    }

    /// [`ObstacleReport`](crate::ObstacleReport)s.
    pub fn obstacles(&self) -> String {
        self.key("obstacles")
    }

    /// [`RoomTruth`](crate::RoomTruth), from simulated rooms only.
    pub fn truth(&self) -> String {
        self.key("truth")
    }

    /// [`MirrorCommand`](crate::MirrorCommand)s.
    pub fn command(&self) -> String {
        self.key("mirrors/command")
    }

    /// [`MirrorTelemetry`](crate::MirrorTelemetry).
    pub fn telemetry(&self) -> String {
        self.key("mirrors/telemetry")
    }

    /// [`Capabilities`](crate::Capabilities), published and queryable.
    pub fn capabilities(&self) -> String {
        self.key("mirrors/capabilities")
    }

    /// [`EmergencyStop`](crate::EmergencyStop).
    pub fn stop(&self) -> String {
        self.key("mirrors/stop")
    }

    /// [`Calibration`](crate::Calibration).
    pub fn calibration(&self) -> String {
        self.key("mirrors/calibration")
    }

    /// [`SimulatorControl`](crate::SimulatorControl), for simulated rooms only.
    pub fn simulator_control(&self) -> String {
        self.key("sim/control")
    }

    /// [`ControllerControl`](crate::ControllerControl).
    pub fn controller_control(&self) -> String {
        self.key("controller/control")
    }

    /// [`NodeStatus`](crate::NodeStatus) of one sort of process.
    pub fn status(&self, node: NodeKind) -> String {
        self.key(&format!("status/{node}"))
    }

    /// Pattern of every process's status.
    pub fn all_status(&self) -> String {
        self.key("status/*")
    }

    /// Liveliness token of one instance; `source` is the id in its stamps.
    pub fn alive(&self, node: NodeKind, source: u64) -> String {
        self.key(&format!("alive/{node}/{source:016x}"))
    }

    /// Pattern of the liveliness tokens of one sort of process.
    pub fn alive_of(&self, node: NodeKind) -> String {
        self.key(&format!("alive/{node}/*"))
    }

    /// Pattern of everything said in the room, for recorders; liveliness tokens are no part of it.
    pub fn everything(&self) -> String {
        self.key("**")
    }

    /// Pattern of every liveliness token of the room.
    pub fn all_alive(&self) -> String {
        self.key("alive/*/*")
    }
}

impl fmt::Display for Room {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.name)
    }
}

impl FromStr for Room {
    type Err = RoomError;

    fn from_str(name: &str) -> Result<Self, RoomError> {
        Self::new(name)
    }
}

/// The node and the source id in the key of a liveliness token; nothing where it is no such key.
pub fn parse_alive(key: &str) -> Option<(NodeKind, u64)> {
    let mut parts = key.strip_prefix(PREFIX)?.strip_prefix('/')?.split('/');
    let (_room, alive, node, source) = (parts.next()?, parts.next()?, parts.next()?, parts.next()?);
    if alive != "alive" || parts.next().is_some() {
        return None;
    }
    Some((NodeKind::from_name(node)?, u64::from_str_radix(source, 16).ok()?))
}
