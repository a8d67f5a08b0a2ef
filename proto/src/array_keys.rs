//! Keys of each mirror array of a room.
//!
//! The first array, with the index 0, has the keys of the message table: `mirrors/command` and so
//! on. Array n from 1 has the same messages under `mirrors-n/`. Stop and re-arm concern all arrays
//! of a room, so they have one key.

use crate::enumerations::NodeKind;
use crate::keys::{Room, driver_index, later_index};
use crate::messages::NodeStatus;

/// First part of the keys of an array, after that of the room.
const ARRAY: &str = "mirrors";

/// The keys of one array of a room.
///
/// ```
/// use heliostat_proto::Room;
///
/// let room = Room::new("lab")?;
/// assert_eq!(room.array(0).command(), room.command());
/// assert_eq!(room.array(2).command(), "heliostat/v1/lab/mirrors-2/command");
/// # Ok::<(), heliostat_proto::RoomError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ArrayKeys {
    room: Room,
    /// First part of its keys, after that of the room.
    own: String,
    /// The part of its drivers' liveliness tokens that names the kind of process.
    driver: String,
}

impl Room {
    /// The keys of the array with this index from 0.
    pub fn array(&self, index: usize) -> ArrayKeys {
        self.arrays_named(&if index == 0 { String::new() } else { format!("-{index}") })
    }

    /// Patterns for the keys of all arrays but the first.
    pub fn later_arrays(&self) -> ArrayKeys {
        self.arrays_named("-$*")
    }

    /// Index of the array to which a key belongs, and the same key of the first array. A key that
    /// belongs to no array is returned as it is, with the index 0.
    pub fn first_array_key(&self, key: &str) -> (usize, String) {
        let start = self.first_part();
        let later =
            key.strip_prefix(&start).and_then(|rest| rest.strip_prefix('-')).and_then(|rest| rest.split_once('/'));
        match later.and_then(|(index, rest)| Some((later_index(index)?, rest))) {
            Some((index, rest)) => (index, format!("{start}/{rest}")),
            None => (0, key.to_owned()),
        }
    }

    /// Index of the array to which a key belongs, where the same key of the first array is `first`; `None` for any other
    /// key, also for one whose array no room has.
    pub fn array_of(&self, key: &str, first: &str) -> Option<usize> {
        let (array, found) = self.first_array_key(key);
        (found == first).then_some(array)
    }

    /// Index of the array of the driver that publishes this status under this key, and 0 for a process of another kind;
    /// `None` where the key is not one of its kind of process: a role may publish under the keys of its own kind only.
    pub fn status_array(&self, key: &str, status: &NodeStatus) -> Option<usize> {
        let node = key.strip_prefix(self.all_status().strip_suffix('*')?)?;
        match status.node {
            NodeKind::Driver => driver_index(node),
            other => (node == other.name()).then_some(0),
        }
    }

    fn arrays_named(&self, suffix: &str) -> ArrayKeys {
        ArrayKeys {
            own: format!("{}{suffix}", self.first_part()),
            driver: format!("{}{suffix}", NodeKind::Driver),
            room: self.clone(),
        }
    }

    /// The keys of the first array up to the second part.
    fn first_part(&self) -> String {
        let command = self.command();
        command.strip_suffix("/command").unwrap_or_default().to_owned()
    }
}

/// The keys of messages that each array has.
macro_rules! array_keys {
    ($($key:ident: $message:ident,)*) => {
        impl ArrayKeys {
            $(
                #[doc = concat!("Key of [`", stringify!($message), "`](crate::", stringify!($message), ").")]
                pub fn $key(&self) -> String {
                    self.own(self.room.$key())
                }
            )*
        }
    };
}

array_keys! {
    command: MirrorCommand,
    telemetry: MirrorTelemetry,
    capabilities: Capabilities,
    calibration: Calibration,
    safety: SafetyReport,
    stops: StopReport,
    stop_repetition: StopRepetition,
}

impl ArrayKeys {
    /// Key of the [`NodeStatus`] of a driver of this array.
    pub fn driver_status(&self) -> String {
        let start = self.room.all_status();
        format!("{}{}", start.strip_suffix('*').unwrap_or_default(), self.driver)
    }

    /// Key of the liveliness token of a driver of this array; `source` is the id in its stamps.
    pub fn driver_alive(&self, source: u64) -> String {
        self.driver_token(&format!("{source:016x}"))
    }

    /// Pattern for the liveliness tokens of the drivers of this array.
    pub fn drivers_alive(&self) -> String {
        self.driver_token("*")
    }

    /// The same key of this array.
    fn own(&self, first: String) -> String {
        let kind = first.rsplit_once('/').map_or("", |(_, kind)| kind);
        format!("{}/{kind}", self.own)
    }

    fn driver_token(&self, source: &str) -> String {
        let start = self.room.all_alive();
        format!("{}{}/{source}", start.strip_suffix("*/*").unwrap_or_default(), self.driver)
    }
}

/// The name of an array in counters and messages: `mirrors`, or `mirrors-n` for array n from 1.
pub fn array_name(index: usize) -> String {
    if index == 0 { ARRAY.to_owned() } else { format!("{ARRAY}-{index}") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::keys::parse_driver_alive;

    #[test]
    fn the_first_array_has_the_keys_of_the_message_table() {
        // The name of the room must not be taken for a part of the key.
        let room = Room::new("mirrors").unwrap();
        let first = room.array(0);
        let keys = [first.command(), first.telemetry(), first.capabilities(), first.calibration(), first.safety()];
        let table = [room.command(), room.telemetry(), room.capabilities(), room.calibration(), room.safety()];
        assert_eq!(keys, table);
        assert_eq!(first.drivers_alive(), room.alive_of(NodeKind::Driver));
        assert_eq!(first.driver_alive(10), room.alive(NodeKind::Driver, 10));
        assert_eq!(first.driver_status(), room.status(NodeKind::Driver));
    }

    #[test]
    fn each_later_array_has_keys_of_its_own() {
        let room = Room::new("mirrors").unwrap();
        let third = room.array(2);
        assert_eq!(third.safety(), "heliostat/v1/mirrors/mirrors-2/safety");
        assert_eq!(third.drivers_alive(), "heliostat/v1/mirrors/alive/driver-2/*");
        assert_eq!(third.driver_status(), "heliostat/v1/mirrors/status/driver-2");
        assert_eq!(room.array_of(&third.stops(), &room.array(0).stops()), Some(2));
        assert_eq!(room.array_of(&third.stops(), &room.array(0).safety()), None);
        assert_eq!(parse_driver_alive(&third.driver_alive(10)), Some((2, 10)));
        assert_eq!(parse_driver_alive(&room.alive(NodeKind::Driver, 10)), Some((0, 10)));
        assert_eq!(room.first_array_key(&third.telemetry()), (2, room.telemetry()));
        assert_eq!(room.later_arrays().command(), "heliostat/v1/mirrors/mirrors-$*/command");
    }

    #[test]
    fn other_keys_belong_to_no_later_array() {
        let room = Room::new("lab").unwrap();
        assert_eq!(parse_driver_alive(&room.alive(NodeKind::SimNode, 10)), None);
        assert_eq!(parse_driver_alive(&room.array(20).driver_alive(10)), None);
        for key in
            ["mirrors/stop", "users", "mirrors-0/command", "mirrors-16/command", "mirrors-01/command", "mirrors-+1/x"]
        {
            let key = format!("heliostat/v1/lab/{key}");
            assert_eq!(room.first_array_key(&key), (0, key.clone()));
            assert_eq!(room.array_of(&key, &room.command()), None, "{key}");
        }
        let other_room = "heliostat/v1/hall/mirrors-1/command";
        assert_eq!(room.first_array_key(other_room), (0, other_room.to_owned()));
    }

    #[test]
    fn a_status_counts_under_the_keys_of_its_kind_of_process_only() {
        let room = Room::new("lab").unwrap();
        let array = |node, key: &str| room.status_array(key, &NodeStatus { node, ..NodeStatus::default() });
        for node in NodeKind::ALL {
            assert_eq!(array(node, &room.status(node)), Some(0), "{node}");
            for other in NodeKind::ALL.into_iter().filter(|other| *other != node) {
                assert_eq!(array(node, &room.status(other)), None, "{node} under the key of {other}");
            }
        }
        assert_eq!(array(NodeKind::Driver, &room.array(2).driver_status()), Some(2));
        assert_eq!(array(NodeKind::Controller, &room.array(2).driver_status()), None);
        for key in [room.array(20).driver_status(), room.array(1).telemetry()] {
            assert_eq!(array(NodeKind::Driver, &key), None, "{key}");
        }
    }
}
