//! Why a command that displays a room ends, for its open pages.

use std::fmt;
use std::time::Duration;

/// Time between two looks for a reason to end.
pub const WATCH_EVERY: Duration = Duration::from_millis(50);

/// Why a command ends.
#[derive(Debug)]
pub enum Ending {
    /// Ctrl-C, or another signal.
    Signal,
    /// A key in the full-screen view.
    Key,
    /// The time of `--seconds` is over.
    Time(Duration),
}

impl Ending {
    /// The reason in words; without one, the command ends by an error.
    pub fn reason(ending: Option<&Self>) -> String {
        ending.map_or_else(|| "by an error, which its terminal names".to_owned(), Self::to_string)
    }
}

impl fmt::Display for Ending {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Signal => formatter.write_str("by Ctrl-C or a signal"),
            Self::Key => formatter.write_str("by a key in its terminal"),
            Self::Time(time) => write!(formatter, "after its {} s", time.as_secs_f64()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_reason_follows_the_words_that_a_command_has_ended() {
        let endings = [Ending::Signal, Ending::Key, Ending::Time(Duration::from_millis(2500))];
        let expected = ["by Ctrl-C or a signal", "by a key in its terminal", "after its 2.5 s"];
        assert_eq!(endings.map(|ending| ending.to_string()), expected);
    }
}
