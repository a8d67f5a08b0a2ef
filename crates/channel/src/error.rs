//! Why a channel model cannot be built: the value that was found and the value that was expected.

use thiserror::Error;

/// Why a [`ChannelModel`](crate::ChannelModel) or one of its parts cannot be built.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ChannelError {
    /// A number outside its domain.
    #[error("{quantity} is {value}: expected {expected}")]
    OutOfRange {
        /// The quantity, with its unit.
        quantity: &'static str,
        /// The number found.
        value: f64,
        /// The domain, in words.
        expected: &'static str,
    },
    /// Too few or too many of something.
    #[error("{count} {things}: expected {expected}")]
    Count {
        /// What is counted.
        things: &'static str,
        /// The number found.
        count: usize,
        /// The numbers allowed, in words.
        expected: &'static str,
    },
    /// An LED that the array cannot face.
    #[error(
        "LED {led} is {distance_m} m in front of the mirror wall: expected more than 0 m; move the LED or choose another wall"
    )]
    LedBehindWall {
        /// Index of the LED.
        led: usize,
        /// Its distance from the wall's plane in m, negative behind the wall.
        distance_m: f64,
    },
}
