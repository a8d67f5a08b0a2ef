//! Enumerations in the fields of messages, with their numbers on the wire.

use std::fmt;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error as _};

use crate::codec::{BufferFull, Reader, Unreadable, Writer};
use crate::error::CodecError;
use crate::fields::{Bounds, Place, Value};

/// Defines enumerations with their numbers on the wire and their names, and reads and writes them.
macro_rules! enumerations {
    ($(
        $(#[$meta:meta])*
        enumeration $enumeration:ident {
            $( $(#[$variant_meta:meta])* $variant:ident = $number:literal $name:literal, )*
        }
    )*) => { $(
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
        pub enum $enumeration {
            $( $(#[$variant_meta])* $variant = $number, )*
        }

        impl $enumeration {
            /// All values, in the order of their numbers.
            pub const ALL: [Self; [$($number),*].len()] = [$(Self::$variant),*];

            /// Name in keys, in counters and on command lines.
            pub fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $name,)*
                }
            }

            /// The value with this name.
            pub fn from_name(name: &str) -> Option<Self> {
                Self::ALL.into_iter().find(|value| value.name() == name)
            }

            fn from_number(number: u32) -> Option<Self> {
                Self::ALL.into_iter().find(|value| *value as u32 == number)
            }
        }

        /// As its number on the wire.
        impl Serialize for $enumeration {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.serialize_u32(*self as u32)
            }
        }

        impl<'de> Deserialize<'de> for $enumeration {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                let number = u32::deserialize(deserializer)?;
                Self::from_number(number).ok_or_else(|| D::Error::custom(unknown(number)))
            }
        }

        impl Value for $enumeration {
            fn read(&mut self, reader: &mut Reader<'_>, place: Place, _: Bounds) -> Result<(), CodecError> {
                let mut number = 0u32;
                number.read(reader, place, Bounds::NONE)?;
                *self =
                    Self::from_number(number).ok_or_else(|| place.unreadable(Unreadable::Invalid(unknown(number))))?;
                Ok(())
            }

            fn write(&self, writer: &mut Writer<'_>) -> Result<(), BufferFull> {
                (*self as u32).write(writer)
            }

            fn check(&self, _: Place, _: Bounds) -> Result<(), CodecError> {
                Ok(())
            }
        }
    )* };
}

/// An enumeration that is not on the wire, the list of its variants, and the name of each.
#[macro_export]
macro_rules! named {
    ($(#[$about:meta])* pub enum $Type:ident { $($(#[$of:meta])* $Variant:ident = $name:literal,)+ }) => {
        $(#[$about])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum $Type {
            $($(#[$of])* $Variant,)+
        }

        impl $Type {
            /// All variants, in the order of their counters.
            pub const ALL: [Self; [$($name),+].len()] = [$(Self::$Variant),+];

            /// The name in counters, messages and files.
            pub fn name(self) -> &'static str {
                match self {
                    $(Self::$Variant => $name,)+
                }
            }
        }
    };
}

/// The problem of a number that no value has.
fn unknown(number: u32) -> String {
    format!("no value has the number {number}")
}

enumerations! {
    /// State of the array.
    enumeration ArrayState {
        /// At the park position: no command yet, or none for longer than the driver holds the last
        /// one.
        #[default]
        Parked = 0 "parked",
        /// Moving to, or at, the angles of a valid command.
        Following = 1 "following",
        /// The last command is no longer valid; the mirrors keep their angles until they park.
        Holding = 2 "holding",
        /// An emergency stop is latched; the driver refuses commands until it is re-armed.
        Stopped = 3 "stopped",
        /// The hardware cannot follow commands; the fault bits give the reason.
        Fault = 4 "fault",
    }

    /// Whether the hardware measures the angles of its mirrors.
    enumeration Feedback {
        /// It does not: telemetry has no measured angles.
        #[default]
        OpenLoop = 0 "open-loop",
        /// It measures each angle.
        ClosedLoop = 1 "closed-loop",
    }

    /// Clock from which a driver counts the validity of a command.
    enumeration ValidityClock {
        /// From the time of the command; the driver's clock is synchronised to UTC.
        #[default]
        SourceTime = 0 "source-time",
        /// From the arrival of the command; the driver has no such clock and cannot detect delayed
        /// commands.
        Arrival = 1 "arrival",
    }

    /// Action of an emergency stop message.
    enumeration StopAction {
        /// Stop at once, and refuse commands from now on.
        #[default]
        Stop = 0 "stop",
        /// Accept commands again.
        Rearm = 1 "re-arm",
    }

    /// Fault of simulated mirrors.
    enumeration FaultKind {
        /// No fault: ends all faults of the mirrors except delay, offline and reboot, which concern
        /// the array.
        #[default]
        Healed = 0 "healed",
        /// Both axes keep their angles.
        Stuck = 1 "stuck",
        /// Roll loses its drive and returns to 0.
        DeadRoll = 2 "dead-roll",
        /// Yaw loses its drive and returns to 0.
        DeadYaw = 3 "dead-yaw",
        /// Roll turns in the opposite direction.
        FlippedRoll = 4 "flipped-roll",
        /// Yaw turns in the opposite direction.
        FlippedYaw = 5 "flipped-yaw",
        /// The array does not answer for a while; its mirrors keep their angles.
        Offline = 6 "offline",
        /// Each command reaches the mirrors after a delay; a delay of 0 s ends the fault.
        Late = 7 "late",
        /// The array restarts: its mirrors return to 0, and it does not answer for a while.
        Reboot = 8 "reboot",
    }

    /// Input of a controller.
    enumeration InputKind {
        /// It accepted a user report.
        #[default]
        Users = 0 "users",
        /// It accepted a channel report.
        Channel = 1 "channel",
        /// It accepted an obstacle report.
        Obstacles = 2 "obstacles",
        /// It accepted a telemetry message.
        Telemetry = 3 "telemetry",
        /// It decided in time for the newest user report.
        Decision = 4 "decision",
        /// It decided for the newest user report after the deadline.
        LateDecision = 5 "late-decision",
        /// It decided because a user report was too old.
        StaleDecision = 6 "stale-decision",
        /// It decided because no user report arrived.
        SilenceDecision = 7 "silence-decision",
        /// It accepted an orientation report.
        Orientation = 8 "orientation",
        /// It accepted an LED report.
        Leds = 9 "leds",
    }

    /// Kind of process that takes part in a room.
    enumeration NodeKind {
        /// Decides the mirror angles.
        #[default]
        Controller = 0 "controller",
        /// Simulates a room: users, receivers and mirrors.
        SimNode = 1 "sim-node",
        /// Drives a real array.
        Driver = 2 "driver",
        /// Measures the positions of real users and obstacles.
        Tracker = 3 "tracker",
        /// Only receives: user interfaces, recorders, the command line.
        Viewer = 4 "viewer",
    }
}

impl fmt::Display for NodeKind {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}
