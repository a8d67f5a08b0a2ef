//! The kinds of messages, from the message table.

use std::fmt;

use crate::table::message_table;

/// Expands the message table to [`Kind`].
macro_rules! kinds {
    ($(
        $(#[$meta:meta])*
        message $message:ident(kind: $number:literal, name: $name:literal, key: $($key:tt)*) $fields:tt
        $(requires $relations:tt)?
    )*) => {
        /// Kind of message; its number is the second byte of a payload.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        #[repr(u8)]
        pub enum Kind {
            $(
                #[doc = concat!("[`", stringify!($message), "`](crate::", stringify!($message), ")")]
                $message = $number,
            )*
        }

        impl Kind {
            /// All kinds of this version, in the order of their numbers.
            pub const ALL: [Self; [$($number),*].len()] = [$(Self::$message),*];

            /// Name of the kind in messages to users.
            pub fn name(self) -> &'static str {
                match self {
                    $(Self::$message => $name,)*
                }
            }
        }
    };
}

message_table!(kinds);

impl Kind {
    /// The number in the second byte of a payload.
    pub fn number(self) -> u8 {
        self as u8
    }

    /// The kind with this number.
    pub fn from_number(number: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.number() == number)
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}
