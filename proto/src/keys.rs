//! Key expressions of a room: the room's name, the contract's version, and one key for each
//! message.

use std::fmt;
use std::str::FromStr;

use thiserror::Error;

use crate::enumerations::NodeKind;
use crate::kind::Kind;
use crate::limits::MAX_ARRAYS;
use crate::table::message_table;

/// Longest name of a room in bytes.
pub const MAX_ROOM_NAME: usize = 64;

const PREFIX: &str = "heliostat/v1";

/// Why a text is not the name of a room.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum RoomError {
    /// The name is empty.
    #[error("the name of the room is empty: expected 1 to {MAX_ROOM_NAME} letters, digits, '-' or '_'")]
    Empty,
    /// The name is too long.
    #[error("the name of the room has {found} bytes: expected at most {MAX_ROOM_NAME}")]
    TooLong {
        /// Length found, in bytes.
        found: usize,
    },
    /// The name contains a character that has or could get a meaning in keys.
    #[error("the name of the room \"{name}\" contains {found:?}: expected only ASCII letters, digits, '-' and '_'")]
    BadCharacter {
        /// The name.
        name: String,
        /// The character.
        found: char,
    },
}

/// The name of a room, 1 to 64 ASCII letters, digits, '-' or '_'; it gives the keys of the room's
/// messages.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Room {
    name: String,
}

/// Expands the message table to the methods that give the keys.
macro_rules! message_keys {
    ($(
        $(#[$meta:meta])*
        message $message:ident(
            kind: $number:literal, name: $name:literal,
            key: $key:ident $(($argument:ident: $type:ty))? = $path:literal
        ) $fields:tt
        $(requires $relations:tt)?
    )*) => {
        /// The key of each message.
        impl Room {
            $(
                #[doc = concat!("Key of [`", stringify!($message), "`](crate::", stringify!($message), ").")]
                pub fn $key(&self $(, $argument: $type)?) -> String {
                    self.key(format_args!($path))
                }
            )*

            /// Kind of the messages under a key, also under that of a later array; `None` for a key that the contract
            /// does not have.
            pub fn kind_of(&self, key: &str) -> Option<Kind> {
                let (_, first) = self.first_array_key(key);
                let rest = first.strip_prefix(&self.key(format_args!("")))?;
                let mut kinds = [$(($path, Kind::$message)),*].into_iter();
                kinds.find(|(path, _)| is_path(path, rest)).map(|(_, kind)| kind)
            }
        }
    };
}

message_table!(message_keys);

/// Whether a path of the message table has this part of a key, after that of the room. What is in braces stands for the
/// name of a process.
fn is_path(path: &str, rest: &str) -> bool {
    let is_process = |name: &str| NodeKind::from_name(name).is_some() || driver_index(name).is_some();
    match path.split_once('{') {
        Some((start, _)) => rest.strip_prefix(start).is_some_and(is_process),
        None => path == rest,
    }
}

impl Room {
    /// Checks the name.
    ///
    /// # Errors
    /// [`RoomError`] names the fault.
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

    fn key(&self, rest: fmt::Arguments<'_>) -> String {
        format!("{PREFIX}/{}/{rest}", self.name)
    }

    /// Pattern for the status of every process.
    pub fn all_status(&self) -> String {
        self.key(format_args!("status/*"))
    }

    /// Pattern for the geometry that each process announces.
    pub fn all_geometry(&self) -> String {
        self.key(format_args!("geometry/*"))
    }

    /// Key of the liveliness token of one instance; `source` is the id in its stamps.
    pub fn alive(&self, node: NodeKind, source: u64) -> String {
        self.key(format_args!("alive/{node}/{source:016x}"))
    }

    /// Pattern for the liveliness tokens of one kind of process.
    pub fn alive_of(&self, node: NodeKind) -> String {
        self.key(format_args!("alive/{node}/*"))
    }

    /// Pattern for every liveliness token of the room.
    pub fn all_alive(&self) -> String {
        self.key(format_args!("alive/*/*"))
    }

    /// Pattern for every message of the room, for recorders; it does not include liveliness tokens.
    pub fn everything(&self) -> String {
        self.key(format_args!("**"))
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

/// Node and source id in the key of a liveliness token; `None` for any other key. The token of a
/// driver may name its array, as `driver-1`.
pub fn parse_alive(key: &str) -> Option<(NodeKind, u64)> {
    let (node, source) = split_alive(key)?;
    let node = NodeKind::from_name(node).or_else(|| driver_index(node).map(|_| NodeKind::Driver))?;
    Some((node, source))
}

/// Pattern for the liveliness tokens of every room.
pub fn alive_in_every_room() -> String {
    format!("{PREFIX}/*/alive/*/*")
}

/// The room in the key of a liveliness token; `None` for any other key.
pub fn parse_alive_room(key: &str) -> Option<Room> {
    parse_alive(key)?;
    Room::new(key.strip_prefix(PREFIX)?.strip_prefix('/')?.split('/').next()?).ok()
}

/// Index of the array and source id in the key of a liveliness token of a driver; `None` for any
/// other key.
pub fn parse_driver_alive(key: &str) -> Option<(usize, u64)> {
    let (node, source) = split_alive(key)?;
    Some((driver_index(node)?, source))
}

/// Index of the array and source id in the key of a liveliness token of a process with mirrors; `None` for any other
/// key. A simulator has no index: it drives every array of its room.
pub fn parse_array_alive(key: &str) -> Option<(Option<usize>, u64)> {
    let driver = parse_driver_alive(key).map(|(array, source)| (Some(array), source));
    driver.or_else(|| parse_alive(key).filter(|(node, _)| *node == NodeKind::SimNode).map(|(_, source)| (None, source)))
}

/// The part that names the process, and the source id, in the key of a liveliness token.
fn split_alive(key: &str) -> Option<(&str, u64)> {
    let mut parts = key.strip_prefix(PREFIX)?.strip_prefix('/')?.split('/');
    let (_room, alive, node, source) = (parts.next()?, parts.next()?, parts.next()?, parts.next()?);
    if alive != "alive" || parts.next().is_some() {
        return None;
    }
    Some((node, parse_source(source)?))
}

/// The source id in a liveliness token, from the only text that it has: with a second one, the end of that token would
/// count as the end of the process.
fn parse_source(text: &str) -> Option<u64> {
    let source = u64::from_str_radix(text, 16).ok()?;
    (format!("{source:016x}") == text).then_some(source)
}

/// Index of the array that the name of a driver in a key states: `driver`, or `driver-n` from 1.
pub(crate) fn driver_index(name: &str) -> Option<usize> {
    let array = name.strip_prefix(NodeKind::Driver.name())?;
    if array.is_empty() { Some(0) } else { later_index(array.strip_prefix('-')?) }
}

/// The index of an array after the first, as keys have it.
pub(crate) fn later_index(text: &str) -> Option<usize> {
    let index = text.parse().ok().filter(|index| (1..MAX_ARRAYS).contains(index))?;
    // Only one text names an array: neither "+1" nor "01" does.
    (index.to_string() == text).then_some(index)
}
