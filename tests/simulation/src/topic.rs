//! What is published, and which hosts subscribe to it.

use crate::plan::Role;

/// The key of a payload; for keys of an array with its index.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) enum Topic {
    Users,
    Channel,
    Obstacles,
    Orientation,
    Leds,
    Command(usize),
    Telemetry(usize),
    Capabilities(usize),
    Safety(usize),
    Stops(usize),
    Repetition(usize),
    Stop,
    Rearm,
    Geometry,
    /// A controller or operator asks for the last announcements of every array.
    Query,
}

impl Topic {
    /// Whether a host of this role subscribes to it.
    pub fn is_for(self, role: Role) -> bool {
        match role {
            Role::Tracker => false,
            Role::Array(own) => match self {
                Self::Command(array) | Self::Repetition(array) => array == own,
                Self::Stop | Self::Rearm | Self::Query => true,
                _ => false,
            },
            Role::Controller(_) => matches!(
                self,
                Self::Users
                    | Self::Channel
                    | Self::Obstacles
                    | Self::Orientation
                    | Self::Leds
                    | Self::Telemetry(_)
                    | Self::Capabilities(_)
                    | Self::Safety(_)
                    | Self::Stops(_)
                    | Self::Stop
            ),
            Role::Operator => {
                matches!(self, Self::Telemetry(_) | Self::Safety(_) | Self::Stops(_) | Self::Geometry)
            }
            Role::Calibration => matches!(
                self,
                Self::Users
                    | Self::Channel
                    | Self::Telemetry(_)
                    | Self::Capabilities(_)
                    | Self::Safety(_)
                    | Self::Repetition(_)
                    | Self::Stop
            ),
            Role::Attacker => {
                matches!(
                    self,
                    Self::Users
                        | Self::Channel
                        | Self::Obstacles
                        | Self::Orientation
                        | Self::Leds
                        | Self::Command(_)
                        | Self::Telemetry(_)
                        | Self::Stop
                        | Self::Rearm
                )
            }
        }
    }
}
