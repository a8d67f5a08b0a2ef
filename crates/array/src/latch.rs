//! The latch of the emergency stop, and the text that keeps it over a restart.
//!
//! A latched stop has a name: source and sequence number of the message that caused it. A re-arm of
//! kind 13 releases the stop that it names. A re-arm of kind 9 releases it by its time, which must
//! be later than that of the stop. The time of a stop is at most its arrival, so a stop from a fast
//! clock can be released.
//!
//! ```toml
//! version = 1
//! stopped = true
//!
//! [stop]                       # absent where stopped is false
//! source = "123456789abcdef0"  # hexadecimal
//! sequence = "300"             # texts, because TOML has no unsigned integers of 64 bits
//! time_ns = "1767323045678000000"
//! arrived_ns = "1767323045678000000"
//! operator = "ann"
//! reason = "test"
//! ```

use heliostat_proto::{EmergencyStop, MAX_TEXT, Nanos, Rearm};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::refusal::RearmRefusal;

/// Version of the text.
const VERSION: u32 = 1;

/// An emergency stop in force.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct LatchedStop {
    /// Source of the stop; 0 for a stop without sender.
    pub source: u64,
    /// Sequence number of the stop; 0 for a stop without sender.
    pub sequence: u64,
    /// A re-arm of kind 9 must be later than this; at most the time of arrival.
    pub time_ns: Nanos,
    /// When it arrived.
    pub arrived_ns: Nanos,
    /// Name of the operator who sent it.
    pub operator: String,
    /// Reason for it.
    pub reason: String,
}

impl LatchedStop {
    /// The stop of a message that arrived at this time.
    pub fn new(order: &EmergencyStop, arrived_ns: Nanos) -> Self {
        let EmergencyStop { stamp, operator, reason, .. } = order;
        Self {
            source: stamp.source,
            sequence: stamp.sequence,
            time_ns: stamp.time_ns.min(arrived_ns),
            arrived_ns,
            operator: operator.clone(),
            reason: reason.clone(),
        }
    }

    /// A stop without sender, as at a start in state stopped.
    pub fn without_sender(reason: &str, now_ns: Nanos) -> Self {
        let end = (0..=reason.len().min(MAX_TEXT)).rev().find(|at| reason.is_char_boundary(*at)).unwrap_or(0);
        Self { time_ns: now_ns, arrived_ns: now_ns, reason: reason[..end].to_owned(), ..Self::default() }
    }

    /// The same stop after a restart at `now_ns`: a clock that was set back must not delay a re-arm.
    pub fn restored(mut self, now_ns: Nanos) -> Self {
        self.time_ns = self.time_ns.min(now_ns);
        self
    }
}

/// The latch: a stop, or none.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct Latch {
    stop: Option<LatchedStop>,
}

/// Why a text is not the state of a latch.
#[derive(Debug, Error)]
pub enum LatchTextError {
    /// A key is unknown, missing or of another type.
    #[error(transparent)]
    Toml(#[from] toml::de::Error),
    /// The text is of another version.
    #[error("version {found}: expected {VERSION}")]
    Version {
        /// The version.
        found: u32,
    },
    /// A number cannot be read.
    #[error("invalid {key} \"{text}\": expected an unsigned number of 64 bits{hint}")]
    Number {
        /// The key.
        key: &'static str,
        /// Its value.
        text: String,
        /// How it is written.
        hint: &'static str,
    },
    /// The state and the stop contradict each other.
    #[error("stopped is {stopped}: expected a table [stop] if and only if it is true")]
    Contradiction {
        /// The state.
        stopped: bool,
    },
    /// A text is too long for a message.
    #[error("{key} has {found} bytes: expected at most {MAX_TEXT}")]
    TooLong {
        /// The key.
        key: &'static str,
        /// Its length.
        found: usize,
    },
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct LatchText {
    version: u32,
    stopped: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    stop: Option<StopText>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StopText {
    source: String,
    sequence: String,
    time_ns: String,
    arrived_ns: String,
    operator: String,
    reason: String,
}

impl Latch {
    /// A latch with a stop.
    pub fn stopped(stop: LatchedStop) -> Self {
        Self { stop: Some(stop) }
    }

    /// The stop in force.
    pub fn stop(&self) -> Option<&LatchedStop> {
        self.stop.as_ref()
    }

    /// Latches a stop. It replaces the name of an earlier one, and never makes its time earlier.
    pub(crate) fn engage(&mut self, mut stop: LatchedStop) {
        stop.time_ns = stop.time_ns.max(self.stop.as_ref().map_or(0, |earlier| earlier.time_ns));
        self.stop = Some(stop);
    }

    /// Releases the stop that the re-arm names.
    pub(crate) fn release(&mut self, order: &Rearm) -> Result<(), RearmRefusal> {
        let stop = self.stop.as_ref().ok_or(RearmRefusal::NotStopped)?;
        let (found_source, found_sequence) = (order.stop_source, order.stop_sequence);
        let (source_id, sequence) = (stop.source, stop.sequence);
        if (found_source, found_sequence) != (source_id, sequence) {
            return Err(RearmRefusal::OtherStop { found_source, found_sequence, source_id, sequence });
        }
        self.stop = None;
        Ok(())
    }

    /// Releases the stop by a re-arm of kind 9, which names none.
    pub(crate) fn release_by_time(&mut self, found_ns: Nanos) -> Result<(), RearmRefusal> {
        let stopped_ns = self.stop.as_ref().ok_or(RearmRefusal::NotStopped)?.time_ns;
        if found_ns <= stopped_ns {
            return Err(RearmRefusal::TooEarly { found_ns, stopped_ns });
        }
        self.stop = None;
        Ok(())
    }

    /// The text that [`Latch::parse`] reads.
    ///
    /// # Panics
    /// Never: every latch can be written as TOML.
    pub fn to_toml(&self) -> String {
        let stop = self.stop.as_ref().map(|stop| StopText {
            source: format!("{:016x}", stop.source),
            sequence: stop.sequence.to_string(),
            time_ns: stop.time_ns.to_string(),
            arrived_ns: stop.arrived_ns.to_string(),
            operator: stop.operator.clone(),
            reason: stop.reason.clone(),
        });
        let text = LatchText { version: VERSION, stopped: stop.is_some(), stop };
        toml::to_string(&text).expect("texts and numbers of 32 bits can be written as TOML")
    }

    /// Reads the state from its text.
    ///
    /// # Errors
    /// [`LatchTextError`]: the state is unknown, so the array must start stopped.
    pub fn parse(text: &str) -> Result<Self, LatchTextError> {
        let LatchText { version, stopped, stop } = toml::from_str(text)?;
        if version != VERSION {
            return Err(LatchTextError::Version { found: version });
        }
        if stopped != stop.is_some() {
            return Err(LatchTextError::Contradiction { stopped });
        }
        Ok(Self { stop: stop.map(StopText::read).transpose()? })
    }
}

impl StopText {
    fn read(self) -> Result<LatchedStop, LatchTextError> {
        let number = |key, text: String, radix, hint| {
            u64::from_str_radix(&text, radix).map_err(|_| LatchTextError::Number { key, text, hint })
        };
        for (key, text) in [("operator", &self.operator), ("reason", &self.reason)] {
            if text.len() > MAX_TEXT {
                return Err(LatchTextError::TooLong { key, found: text.len() });
            }
        }
        Ok(LatchedStop {
            source: number("source", self.source, 16, ", hexadecimal")?,
            sequence: number("sequence", self.sequence, 10, "")?,
            time_ns: number("time_ns", self.time_ns, 10, "")?,
            arrived_ns: number("arrived_ns", self.arrived_ns, 10, "")?,
            operator: self.operator,
            reason: self.reason,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stop() -> LatchedStop {
        LatchedStop {
            source: u64::MAX,
            sequence: u64::MAX,
            time_ns: u64::MAX - 1,
            arrived_ns: u64::MAX,
            operator: "\"ann\"\n[stop]\u{7f}\0".into(),
            reason: "'''\\ é".repeat(100),
        }
    }

    #[test]
    fn a_written_state_can_be_read_with_any_numbers_and_texts() {
        for latch in [Latch::default(), Latch::stopped(stop()), Latch::stopped(LatchedStop::default())] {
            assert_eq!(Latch::parse(&latch.to_toml()).unwrap(), latch, "{}", latch.to_toml());
        }
    }

    #[test]
    fn a_text_that_is_cut_off_or_changed_is_no_state() {
        let text = Latch::stopped(stop()).to_toml();
        for end in 0..text.trim_end().len() {
            if text.is_char_boundary(end) {
                assert!(Latch::parse(&text[..end]).is_err(), "cut off at {end}: {}", &text[..end]);
            }
        }
        let wrong = |from: &str, to: &str| {
            let changed = text.replace(from, to);
            assert_ne!(changed, text, "{from}");
            Latch::parse(&changed).unwrap_err().to_string()
        };
        assert!(wrong("version = 1", "version = 2").contains("version 2: expected 1"));
        assert!(wrong("stopped = true", "stopped = false").contains("expected a table [stop]"));
        assert!(wrong("\"ffffffffffffffff\"", "\"-1\"").contains("invalid source \"-1\""));
        assert!(wrong("stopped = true", "stopped = true\narmed = true").contains("armed"));
        assert!(Latch::parse("version = 1\nstopped = true\n").is_err());
        let long = Latch::stopped(LatchedStop { reason: "x".repeat(MAX_TEXT + 1), ..LatchedStop::default() });
        assert!(Latch::parse(&long.to_toml()).unwrap_err().to_string().contains("1025 bytes"));
    }

    #[test]
    fn a_reason_is_cut_at_the_limit_of_a_message() {
        let stop = LatchedStop::without_sender(&"é".repeat(MAX_TEXT), 7);
        assert_eq!((stop.reason.len(), stop.source, stop.sequence, stop.time_ns), (MAX_TEXT, 0, 0, 7));
    }
}
