//! The orders that a page can give.

use heliostat_proto::StopName;
use serde::{Deserialize, Deserializer};

/// An order of the page. Unknown fields are refused, except in a stop: every stop is obeyed.
///
/// Serde ignores further fields of a variant without braces, and refuses them for one with braces.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "order", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Order {
    /// Switch the controller to another policy.
    Policy {
        /// The policy's name on the controller's command line.
        name: String,
    },
    /// Change the optical power.
    Power {
        /// In W, more than 0.
        watts: f32,
    },
    /// Block the direct paths of the first users by order, and end this for the others.
    Blocked {
        /// Number of users.
        users: u32,
    },
    /// Change the walking speed of the users; at 0 they stand.
    Speed {
        /// Highest speed in m/s; the lowest is a twentieth of it.
        max_m_s: f32,
    },
    /// Make some of the mirrors stick at their present angles.
    Stick {
        /// Share of all mirrors, above 0 and at most 1.
        share: f32,
    },
    /// Make all mirrors follow commands again.
    Release {},
    /// Emergency stop.
    Stop,
    /// End of emergency stops.
    Rearm {
        /// Names of the stops that the page displayed.
        stops: Vec<StopLabel>,
    },
    /// Kill the controller's process.
    KillController {},
    /// Start a new controller; the previous one is killed if it still runs.
    RestartController {},
}

impl Order {
    /// What it sets: a later order of the same subject replaces it.
    pub(crate) fn subject(&self) -> &'static str {
        match self {
            Self::Policy { .. } => "policy",
            Self::Power { .. } => "power",
            Self::Blocked { .. } => "blocked",
            Self::Speed { .. } => "speed",
            Self::Stick { .. } | Self::Release {} => "faults",
            Self::Stop | Self::Rearm { .. } => "stop",
            Self::KillController {} | Self::RestartController {} => "controller",
        }
    }
}

/// An order for the program that started the processes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProcessOrder {
    /// Kill the controller without a request to end.
    KillController,
    /// Start a controller, in place of one that still runs.
    RestartController,
}

/// The name of a stop in an order, as the page displays it: source in hexadecimal, a slash, sequence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StopLabel(pub StopName);

impl std::str::FromStr for StopLabel {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || format!("invalid stop \"{text}\": expected SOURCE/SEQUENCE, for example 0000000000000003/4");
        let (source, sequence) = text.split_once('/').ok_or_else(expected)?;
        let source = u64::from_str_radix(source, 16).map_err(|_| expected())?;
        Ok(Self(StopName { source, sequence: sequence.parse().map_err(|_| expected())? }))
    }
}

impl<'de> Deserialize<'de> for StopLabel {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        text.parse().map_err(serde::de::Error::custom)
    }
}
