//! The messages: structs with their readers, writers and checks, from the message table.
//!
//! Positions are in m in the room's frame: origin at the centre of the floor, z up. Angles are in
//! rad and mechanical.

use serde::{Deserialize, Serialize};

use crate::codec::{BufferFull, Message, Reader, Writer};
use crate::enumerations::{ArrayState, Feedback, NodeKind, StopAction, ValidityClock};
use crate::error::CodecError;
use crate::fields::{
    Bounds, Place, Value, field_name, implement_value, mirrors_within_limit, same_length, same_length_or_empty,
};
use crate::kind::Kind;
use crate::limits::{
    MAX_ENTRIES, MAX_GEOMETRY, MAX_INPUTS, MAX_LED_GAINS, MAX_MIRRORS, MAX_OBSTACLES, MAX_STATE, MAX_STOPS, MAX_USERS,
    Nanos, cut,
};
use crate::structures::{
    AxisLimits, ControllerInput, Counters, LatchedStopReport, LedGain, MirrorFault, Obstacle, Quantiles, Stamp,
    StopName, SumRates, TruthUser, UserBelief, UserBranches, UserChannel, UserLeds, UserOrientation, UserState,
};
use crate::table::message_table;

/// Expands the message table to structs, and to their readers, writers and checks. Serde gives their fields by name,
/// for other notations than the bytes.
macro_rules! define_messages {
    ($(
        $(#[$meta:meta])*
        message $message:ident(kind: $number:literal, name: $name:literal, key: $($key:tt)*) {
            $( $(#[$field_meta:meta])* $field:ident: $type:ty $(where $($rule:ident $(($limit:expr))?)and+)?, )*
        }
        $(requires { $($relation:ident($($of:ident),+)),+ $(,)? })?
    )*) => { $(
        $(#[$meta])*
        #[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct $message {
            $( $(#[$field_meta])* pub $field: $type, )*
        }

        implement_value!(
            $message, [message],
            { $( $field [$($($rule $(($limit))?)*)?] )* },
            [$($( $relation($($of),+) )*)?]
        );

        impl Message for $message {
            const KIND: Kind = Kind::$message;

            fn read(&mut self, reader: &mut Reader<'_>) -> Result<(), CodecError> {
                Value::read(self, reader, Place::message(Self::KIND), Bounds::NONE)
            }

            fn write(&self, writer: &mut Writer<'_>) -> Result<(), BufferFull> {
                Value::write(self, writer)
            }

            fn check(&self) -> Result<(), CodecError> {
                Value::check(self, Place::message(Self::KIND), Bounds::NONE)
            }
        }
    )* };
}

message_table!(define_messages);

/// Bits of [`MirrorTelemetry::faults`].
pub mod fault {
    /// The device does not answer.
    pub const LINK: u32 = 1;
    /// At least one mirror does not follow commands; see
    /// [`unusable`](super::MirrorTelemetry::unusable).
    pub const MIRROR: u32 = 1 << 1;
    /// The temperature is outside its range.
    pub const TEMPERATURE: u32 = 1 << 2;
    /// The supply or drive voltage is outside its range.
    pub const SUPPLY: u32 = 1 << 3;
    /// The calibration is missing or was refused.
    pub const CALIBRATION: u32 = 1 << 4;
    /// The clocks of driver and controller differ by more than the validity of a command.
    pub const CLOCK: u32 = 1 << 5;
    /// A latched stop that the device has not executed.
    pub const STOP: u32 = 1 << 6;

    /// Each bit with its name for operators and metrics.
    pub const NAMES: [(u32, &str); 7] = [
        (LINK, "link"),
        (MIRROR, "mirror"),
        (TEMPERATURE, "temperature"),
        (SUPPLY, "supply"),
        (CALIBRATION, "calibration"),
        (CLOCK, "clock"),
        (STOP, "stop"),
    ];

    /// The names of the faults in a bit set.
    pub fn names(bits: u32) -> Vec<&'static str> {
        NAMES.into_iter().filter(|(bit, _)| bits & bit != 0).map(|(_, name)| name).collect()
    }
}

/// Gives reports about users a buffer.
macro_rules! buffers {
    ($($report:ident)*) => { $(
        impl $report {
            /// An empty report with memory for the largest number of users, to fill or to decode into.
            pub fn buffer() -> Self {
                Self { users: Vec::with_capacity(MAX_USERS), ..Self::default() }
            }
        }
    )* };
}

buffers! { UserReport ChannelReport OrientationReport BeliefReport }

impl LedReport {
    /// An empty report with memory for the largest number of users and gains, to decode into.
    pub fn buffer() -> Self {
        let (users, gains) = (Vec::with_capacity(MAX_USERS), Vec::with_capacity(MAX_LED_GAINS));
        Self { users, gains, ..Self::default() }
    }
}

/// Gives messages of one array a check of their number of mirrors.
macro_rules! check_mirrors {
    ($($message:ident: $found:expr;)*) => { $(
        impl $message {
            /// Checks that the message is of an array of this number of mirrors.
            ///
            /// # Errors
            /// [`CodecError::WrongMirrors`].
            pub fn check_mirrors(&self, expected: usize) -> Result<(), CodecError> {
                let count: fn(&Self) -> usize = $found;
                match count(self) {
                    found if found == expected => Ok(()),
                    found => Err(CodecError::WrongMirrors { kind: Kind::$message, found, expected }),
                }
            }
        }
    )* };
}

check_mirrors! {
    MirrorCommand: |command| command.roll.len();
    MirrorTelemetry: |telemetry| telemetry.roll_commanded.len();
    Capabilities: Capabilities::mirrors;
    Calibration: |calibration| calibration.roll_offset_rad.len();
}

impl Stamp {
    /// The name of a control message in the last problem of the process that refuses it.
    pub fn order_name(&self) -> String {
        format!("order {} of {:016x}", self.sequence, self.source)
    }
}

impl ControllerInput {
    /// Number of bits by which the index of an array is shifted in the sequence number of telemetry.
    pub const ARRAY_SHIFT: u32 = 56;

    /// The sequence number of an input that is telemetry of an array, with this one in its stamp; that of another
    /// message has the index 0.
    pub fn sequence_of(array: usize, sequence: u64) -> u64 {
        sequence.wrapping_add((array as u64) << Self::ARRAY_SHIFT)
    }
}

impl EmergencyStop {
    /// The name of a stop.
    pub fn name(&self) -> StopName {
        StopName { source: self.stamp.source, sequence: self.stamp.sequence }
    }
}

impl StopRepetition {
    /// The name of the stop that it repeats.
    pub fn name(&self) -> StopName {
        StopName { source: self.stop_source, sequence: self.stop_sequence }
    }
}

impl Rearm {
    /// The name of the stop that it releases.
    pub fn name(&self) -> StopName {
        StopName { source: self.stop_source, sequence: self.stop_sequence }
    }
}

impl SafetyReport {
    /// The name of the stop that was latched last; `None` where none is in force.
    pub fn name(&self) -> Option<StopName> {
        self.stopped.then_some(StopName { source: self.stop_source, sequence: self.stop_sequence })
    }

    /// That stop, as a stop report lists it.
    pub fn stop(&self) -> Option<LatchedStopReport> {
        let name = self.name()?;
        let (operator, reason) = (self.operator.clone(), self.reason.clone());
        let StopName { source, sequence } = name;
        Some(LatchedStopReport { source, sequence, arrived_ns: self.stopped_ns, operator, reason })
    }
}

impl StopReport {
    /// Whether the array has latched a stop: its list has the name, or a stop in it stands for those that it cannot
    /// list.
    pub fn is_latched(&self, name: StopName) -> bool {
        self.lists(name) || self.stands_for_unlisted()
    }

    /// Whether the list is full, and the stop without sender in it stands for those that it does not name.
    pub fn stands_for_unlisted(&self) -> bool {
        self.stops.len() == MAX_STOPS && self.lists(StopName::default())
    }

    /// Whether the list has this name.
    pub fn lists(&self, name: StopName) -> bool {
        self.stops.iter().any(|stop| stop.name() == name)
    }
}

impl NodeStatus {
    /// Name of a controller's counter of decisions on position reports.
    pub const DECISIONS: &'static str = "decisions";
    /// Name of the counter that has the epoch of a controller; 0 before the first.
    pub const EPOCH: &'static str = "epoch";
    /// Name of the counter that is 1 while a controller stands by.
    pub const STANDBY: &'static str = "standby";
    /// Name of the counter that is 1 in the last status of a controller that ends in order.
    pub const ENDING: &'static str = "ending";
    /// Name of the counter that is 1 while a controller sees no other one, although one has gone that did not end in
    /// order.
    pub const STANDBY_MISSING: &'static str = "standby_missing";
    /// Beginning of the names of a controller's counters of the events of its tenure.
    pub const TENURE: &'static str = "epoch:";
    /// Name of the counter of arrays whose driver is absent, of a controller.
    pub const DRIVER_ABSENT: &'static str = "driver_absent";

    /// Beginning of the names of a controller's counters of decisions in a degraded mode.
    pub const DEGRADED: &'static str = "fallback:";
    /// The degraded modes in which the array takes no command of this controller. They are no fallbacks.
    pub const WITHHELD: [&'static str; 2] = ["standby", "withheld"];

    /// Name of the counter of arrays whose emergency stop is not in its record; 0 when all are.
    pub const STOP_UNRECORDED: &'static str = "stop_unrecorded";

    /// Name of the counter that is 1 while an array does not fit the scenario of a controller.
    pub const ARRAY_UNFIT: &'static str = "array_unfit";
    /// Beginning of the names of the counters of the arrays that do not fit, where another array fits.
    pub const ARRAY_UNFIT_OF: &'static str = "array_unfit:";

    /// Name of the counter of other processes with mirrors, simulators and drivers, that are in the room of a simulator
    /// at present.
    pub const OTHER_PROCESSES: &'static str = "other_processes";

    /// State of a controller that refuses every position report; the last problem has the reason.
    pub const REPORTS_REFUSED: &'static str = "position reports refused";

    /// Beginning of the problem of a controller whose commands reach no driver; keys follow, unless no array has one.
    pub const NO_DRIVER: &'static str = "no driver receives the commands";

    /// Beginning of the state and of the problem of a controller that withholds its commands because of stops.
    pub const WITHHELD_BY: &'static str = "withheld by ";
    /// Beginning of the problem of a controller for which a second process announces an array.
    pub const FOREIGN_ARRAY: &'static str = "an announcement of an array that is not followed ";

    /// Beginning of the name of the counter that names the host of a controller.
    pub const HOST: &'static str = "host:";

    /// Beginning of the name of the counter that has the hash of the network of a learned policy.
    pub const ACTOR: &'static str = "actor:";

    /// Beginning of the name of the counter that names the source on whose position reports a controller decides.
    const ROOM_SOURCE: &'static str = "room_source:";

    /// What a fallback is: the help of page, status and metrics.
    pub const FALLBACKS_MEANING: &'static str = "Decisions without the policy's own angles or on incomplete reports";
    /// What a withheld command is. It is no fallback.
    pub const WITHHELD_MEANING: &'static str =
        "Decisions without a command to an array: it follows another controller, is stopped or does not fit";

    /// Number of decisions of a controller without the policy's own angles, or on incomplete reports.
    pub fn fallbacks(&self) -> u64 {
        let is_fallback =
            |name: &str| name.strip_prefix(Self::DEGRADED).is_some_and(|mode| !Self::WITHHELD.contains(&mode));
        self.counters.iter().filter(|(name, _)| is_fallback(name)).map(|(_, count)| count).sum()
    }

    /// The keys of the arrays that do not fit the scenario of a controller, so that it sends them no commands: none
    /// are named where no array fits. `None` where each one fits.
    pub fn unfit_arrays(&self) -> Option<Vec<&str>> {
        let is_unfit = self.counter(Self::ARRAY_UNFIT).is_some_and(|count| count > 0);
        let key = |(name, _): &'_ (String, u64)| name.starts_with(Self::ARRAY_UNFIT_OF);
        let named = self.counters.iter().filter(|counter| key(counter));
        is_unfit.then(|| named.map(|(name, _)| &name[Self::ARRAY_UNFIT_OF.len()..]).collect())
    }

    /// The name of the controller's host, if it gives one.
    pub fn host(&self) -> Option<&str> {
        self.counters.iter().find_map(|(name, _)| name.strip_prefix(Self::HOST))
    }

    /// Name and value of the counter of the source on whose position reports a controller decides.
    pub fn room_source_counter(source: u64) -> (String, u64) {
        (format!("{}{source:016x}", Self::ROOM_SOURCE), 1)
    }

    /// The source on whose position reports the controller decides; `None` before the first report.
    pub fn room_source(&self) -> Option<u64> {
        let source = self.counters.iter().find_map(|(name, _)| name.strip_prefix(Self::ROOM_SOURCE))?;
        u64::from_str_radix(source, 16).ok()
    }

    /// The hash of the network of the policy in use; `None` for a policy that is not learned.
    pub fn actor(&self) -> Option<&str> {
        self.counters.iter().find_map(|(name, _)| name.strip_prefix(Self::ACTOR))
    }

    /// The count with this name.
    pub fn counter(&self, name: &str) -> Option<u64> {
        self.counters.iter().find(|(counter, _)| counter == name).map(|(_, count)| *count)
    }

    /// The present value with this name.
    pub fn gauge(&self, name: &str) -> Option<f64> {
        self.gauges.iter().find(|(gauge, _)| gauge == name).map(|(_, value)| *value)
    }

    /// Sets the latest problem, cut to the length that a message may hold.
    pub fn set_problem(&mut self, problem: &str) {
        self.last_problem.clear();
        self.last_problem.push_str(cut(problem));
    }
}

impl Capabilities {
    /// Number of mirrors.
    pub fn mirrors(&self) -> usize {
        (self.rows as usize).saturating_mul(self.columns as usize)
    }
}
