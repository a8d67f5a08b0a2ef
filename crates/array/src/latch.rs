//! The latch of the emergency stops, and the text that keeps it over a restart.
//!
//! A latched stop has a name: source and sequence number of the message that caused it. A re-arm of
//! kind 13 releases the stop that it names. A re-arm of kind 9 releases each stop whose time is
//! earlier. The time of a stop is at most its arrival, so a stop from a fast clock can be released.
//!
//! ```toml
//! version = 2
//! count = 1                    # of the stops; a text that is cut off between two of them has fewer
//! device = "servo board, 4 x 6 mirrors"  # absent where the writer knows none
//! stopped = true
//!
//! [[stops]]                    # absent where stopped is false
//! source = "123456789abcdef0"  # hexadecimal
//! sequence = "300"             # texts, because TOML has no unsigned integers of 64 bits
//! time_ns = "1767323045678000000"
//! arrived_ns = "1767323045678000000"
//! operator = "ann"
//! reason = "test"
//! ```

use heliostat_files::{TomlError, from_toml};
use heliostat_proto::{
    EmergencyStop, LatchedStopReport, MAX_STOPS, MAX_TEXT, Nanos, StopName, StopRepetition, UNLISTED_STOPS, cut,
};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::refusal::RearmRefusal;

/// Version of the text.
const VERSION: u32 = 2;

/// The version with a single stop, as the table `[stop]`.
const VERSION_OF_ONE: u32 = 1;

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

    /// The stop of a repetition that arrived at this time.
    pub fn repeated(order: &StopRepetition, arrived_ns: Nanos) -> Self {
        let StopName { source, sequence } = order.name();
        let (operator, reason) = (order.operator.clone(), order.reason.clone());
        Self { source, sequence, time_ns: arrived_ns, arrived_ns, operator, reason }
    }

    /// Its name.
    pub fn name(&self) -> StopName {
        StopName { source: self.source, sequence: self.sequence }
    }

    /// The stop as a stop report lists it.
    pub fn report(&self) -> LatchedStopReport {
        let Self { source, sequence, arrived_ns, operator, reason, .. } = self.clone();
        LatchedStopReport { source, sequence, arrived_ns, operator, reason }
    }

    /// A stop without sender, as at a start in state stopped.
    pub fn without_sender(reason: &str, now_ns: Nanos) -> Self {
        Self { time_ns: now_ns, arrived_ns: now_ns, reason: cut(reason).to_owned(), ..Self::default() }
    }

    /// The same stop after a restart at `now_ns`: a clock that was set back must not delay a re-arm.
    pub fn restored(mut self, now_ns: Nanos) -> Self {
        self.time_ns = self.time_ns.min(now_ns);
        self
    }
}

/// The latch: the stops in force, in the order of their arrival.
///
/// Stops of different senders are held side by side. A stop with a higher sequence number replaces the
/// earlier one of its sender. When there are more senders than [`MAX_STOPS`], one stop without sender stands for
/// those that are not listed.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct Latch {
    stops: Vec<LatchedStop>,
}

/// Why a text is not the state of a latch.
#[derive(Debug, Error)]
pub enum LatchTextError {
    /// A key is unknown, missing or of another type. In one line, because it is the reason of a stop.
    #[error("no valid record: {0}")]
    Toml(#[from] TomlError),
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
    #[error("stopped is {stopped}: expected at least one stop if and only if it is true")]
    Contradiction {
        /// The state.
        stopped: bool,
    },
    /// Stops are missing, as in a text that was cut off.
    #[error("{found} stops: expected {expected}, the count in the text")]
    Count {
        /// Their number.
        found: usize,
        /// The count in the text.
        expected: usize,
    },
    /// There are more stops than a latch holds.
    #[error("{found} stops: expected at most {MAX_STOPS}")]
    TooMany {
        /// Their number.
        found: usize,
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
    /// Number of the stops; absent in older records. Before `stopped`, so that no cut leaves it out.
    #[serde(skip_serializing_if = "Option::is_none")]
    count: Option<usize>,
    /// The device whose stops they are; absent in older records. Before `stopped` for the same reason.
    #[serde(skip_serializing_if = "Option::is_none")]
    device: Option<String>,
    stopped: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    stop: Option<StopText>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    stops: Vec<StopText>,
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
        Self { stops: vec![stop] }
    }

    /// The stop that arrived last.
    pub fn stop(&self) -> Option<&LatchedStop> {
        self.stops.last()
    }

    /// The stops in force, in the order of their arrival.
    pub fn stops(&self) -> &[LatchedStop] {
        &self.stops
    }

    /// The same latch after a restart at `now_ns`.
    pub fn restored(self, now_ns: Nanos) -> Self {
        Self { stops: self.stops.into_iter().map(|stop| stop.restored(now_ns)).collect() }
    }

    /// Latches a stop, and never makes the time of one that it replaces earlier.
    pub(crate) fn engage(&mut self, mut stop: LatchedStop) {
        // A stop that arrives late or again must not take the name of a later one of its sender: a re-arm
        // of it would release the later one.
        if let Some(held) = self.stops.iter_mut().find(|held| held.name().replaces(stop.name())) {
            held.time_ns = held.time_ns.max(stop.time_ns);
            return;
        }
        if let Some(index) = self.stops.iter().position(|held| held.name().is_of_sender(stop.name())) {
            stop.time_ns = stop.time_ns.max(self.stops.remove(index).time_ns);
        }
        let named = self.stops.iter().filter(|held| held.name() != StopName::default()).count();
        // The last place is that of a stop without sender.
        if named + 1 < MAX_STOPS || stop.name() == StopName::default() {
            self.stops.push(stop);
            return;
        }
        // One that is there, as after a start in state stopped, stands for the others from now on.
        let former = self.stops.iter_mut().find(|held| held.name() == StopName::default());
        if let Some(former) = former.filter(|former| !former.reason.starts_with(UNLISTED_STOPS)) {
            former.reason = cut(&format!("{UNLISTED_STOPS}; {}", former.reason)).to_owned();
        }
        let reason = format!("{UNLISTED_STOPS}; one is {} of {:?}", stop.name(), stop.operator);
        let unlisted = LatchedStop::without_sender(&reason, stop.arrived_ns);
        self.engage(LatchedStop { time_ns: stop.time_ns, ..unlisted });
    }

    /// Whether a repetition adds nothing: the stop, or a later one of its sender, is latched, or the list
    /// is full, and a stop without sender stands for those that are not in it.
    pub(crate) fn covers(&self, name: StopName) -> bool {
        let is_full = self.stops.len() == MAX_STOPS && self.has(StopName::default());
        is_full || self.stops.iter().any(|held| held.name().replaces(name))
    }

    fn has(&self, name: StopName) -> bool {
        self.stops.iter().any(|held| held.name() == name)
    }

    /// Releases the stop of this name.
    pub(crate) fn release(&mut self, name: StopName) -> Result<(), RearmRefusal> {
        let latest = self.stop().ok_or(RearmRefusal::NotStopped)?.name();
        let index = self.stops.iter().position(|stop| stop.name() == name);
        self.stops.remove(index.ok_or(RearmRefusal::OtherStop { found: name, latest })?);
        Ok(())
    }

    /// Releases the stops that are earlier than a re-arm of kind 9, which names none; returns their
    /// names.
    pub(crate) fn release_by_time(&mut self, found_ns: Nanos) -> Result<Vec<StopName>, RearmRefusal> {
        let earliest = self.stops.iter().map(|stop| stop.time_ns).min();
        let stopped_ns = earliest.ok_or(RearmRefusal::NotStopped)?;
        if found_ns <= stopped_ns {
            return Err(RearmRefusal::TooEarly { found_ns, stopped_ns });
        }
        let released = self.stops.extract_if(.., |stop| stop.time_ns < found_ns);
        Ok(released.map(|stop| stop.name()).collect())
    }

    /// The text that [`Latch::parse`] reads, without a device.
    pub fn to_toml(&self) -> String {
        self.to_toml_of("")
    }

    /// The text of the stops of a device, for [`Latch::parse_of`]; the empty name stands for none.
    ///
    /// # Panics
    /// Never: every latch can be written as TOML.
    pub fn to_toml_of(&self, device: &str) -> String {
        let stops: Vec<StopText> = self.stops.iter().map(StopText::of).collect();
        let count = Some(stops.len());
        let device = (!device.is_empty()).then(|| device.to_owned());
        let text = LatchText { version: VERSION, count, device, stopped: !stops.is_empty(), stop: None, stops };
        toml::to_string(&text).expect("texts and numbers of 32 bits can be written as TOML")
    }

    /// Reads the state from its text.
    ///
    /// # Errors
    /// [`LatchTextError`]: the state is unknown, so the array must start stopped.
    pub fn parse(text: &str) -> Result<Self, LatchTextError> {
        Self::parse_of(text).map(|(latch, _)| latch)
    }

    /// Reads the state from its text, and the device whose state it is, where the text has one.
    ///
    /// # Errors
    /// As for [`Latch::parse`].
    pub fn parse_of(text: &str) -> Result<(Self, Option<String>), LatchTextError> {
        let LatchText { version, count, device, stopped, stop, stops } = from_toml(text)?;
        let stops = match version {
            VERSION_OF_ONE if stops.is_empty() => stop.into_iter().collect(),
            VERSION if stop.is_none() => stops,
            VERSION | VERSION_OF_ONE => return Err(LatchTextError::Contradiction { stopped }),
            found => return Err(LatchTextError::Version { found }),
        };
        if stopped == stops.is_empty() {
            return Err(LatchTextError::Contradiction { stopped });
        }
        if let Some(expected) = count.filter(|count| *count != stops.len()) {
            return Err(LatchTextError::Count { found: stops.len(), expected });
        }
        if stops.len() > MAX_STOPS {
            return Err(LatchTextError::TooMany { found: stops.len() });
        }
        Ok((Self { stops: stops.into_iter().map(StopText::read).collect::<Result<_, _>>()? }, device))
    }
}

impl StopText {
    fn of(stop: &LatchedStop) -> Self {
        Self {
            source: format!("{:016x}", stop.source),
            sequence: stop.sequence.to_string(),
            time_ns: stop.time_ns.to_string(),
            arrived_ns: stop.arrived_ns.to_string(),
            operator: stop.operator.clone(),
            reason: stop.reason.clone(),
        }
    }

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
        let mut both = Latch::stopped(stop());
        both.engage(LatchedStop { source: 5, ..stop() });
        assert_eq!(both.stops().len(), 2);
        for latch in [Latch::default(), Latch::stopped(stop()), Latch::stopped(LatchedStop::default()), both] {
            assert_eq!(Latch::parse_of(&latch.to_toml()).unwrap(), (latch.clone(), None), "{}", latch.to_toml());
            let of_device = latch.to_toml_of("\"board\"\n, 4 x 6 mirrors");
            let device = Some("\"board\"\n, 4 x 6 mirrors".to_owned());
            assert_eq!(Latch::parse_of(&of_device).unwrap(), (latch, device), "{of_device}");
        }
    }

    #[test]
    fn a_text_that_is_cut_off_or_changed_is_no_state() {
        let text = Latch::stopped(stop()).to_toml();
        let of_device = Latch::default().to_toml_of("board, 4 x 6 mirrors");
        for text in [text.clone(), latch_of(3).to_toml(), Latch::default().to_toml(), of_device] {
            for end in 0..text.trim_end().len() {
                if text.is_char_boundary(end) {
                    let refusal = Latch::parse(&text[..end]).err().map(|error| error.to_string());
                    let is_one_line = refusal.as_ref().is_some_and(|refusal| !refusal.contains('\n'));
                    assert!(is_one_line, "cut off at {end}: {}: {refusal:?}", &text[..end]);
                }
            }
        }
        let wrong = |from: &str, to: &str| {
            let changed = text.replace(from, to);
            assert_ne!(changed, text, "{from}");
            Latch::parse(&changed).unwrap_err().to_string()
        };
        assert!(wrong("version = 2", "version = 3").contains("version 3: expected 2"));
        assert!(wrong("stopped = true", "stopped = false").contains("expected at least one stop"));
        assert!(wrong("\"ffffffffffffffff\"", "\"-1\"").contains("invalid source \"-1\""));
        assert!(wrong("stopped = true", "stopped = true\narmed = true").contains("armed"));
        assert!(Latch::parse("version = 1\nstopped = true\n").is_err());
        let former = text.replace("count = 1\n", "");
        assert_eq!(Latch::parse(&former).unwrap(), Latch::stopped(stop()), "a record without a count");
        let former = former.replace("version = 2", "version = 1").replace("[[stops]]", "[stop]");
        assert_eq!(Latch::parse(&former).unwrap(), Latch::stopped(stop()), "a record of the former version");
        let long = Latch::stopped(LatchedStop { reason: "x".repeat(MAX_TEXT + 1), ..LatchedStop::default() });
        assert!(Latch::parse(&long.to_toml()).unwrap_err().to_string().contains("1025 bytes"));
    }

    #[test]
    fn a_reason_is_cut_at_the_limit_of_a_message() {
        let stop = LatchedStop::without_sender(&"é".repeat(MAX_TEXT), 7);
        assert_eq!((stop.reason.len(), stop.source, stop.sequence, stop.time_ns), (MAX_TEXT, 0, 0, 7));
    }

    /// A latch with the stops of so many senders.
    fn latch_of(senders: u64) -> Latch {
        let mut latch = Latch::default();
        (1..=senders).for_each(|source| latch.engage(LatchedStop { source, sequence: 5, time_ns: source, ..stop() }));
        latch
    }

    #[test]
    fn each_stop_stays_until_it_is_released_by_its_name() {
        let mut latch = latch_of(2);
        latch.engage(LatchedStop { source: 1, sequence: 7, time_ns: 0, ..stop() });
        let names: Vec<_> = latch.stops().iter().map(|stop| (stop.source, stop.sequence)).collect();
        assert_eq!(names, [(2, 5), (1, 7)], "a later stop of a sender replaces its earlier one");
        latch.engage(LatchedStop { source: 1, sequence: 6, time_ns: 0, ..stop() });
        assert!(latch.has(StopName { source: 1, sequence: 7 }), "an earlier one that is late does not replace it");
        assert!(
            latch.covers(StopName { source: 1, sequence: 6 }) && !latch.covers(StopName { source: 3, sequence: 1 })
        );
        assert!(latch.release(StopName { source: 1, sequence: 5 }).is_err());
        latch.release(StopName { source: 1, sequence: 7 }).unwrap();
        assert_eq!(latch.stops().len(), 1);
        assert_eq!(latch.release_by_time(2).unwrap_err().name(), "too-early");
        assert_eq!(latch.release_by_time(3).unwrap(), [StopName { source: 2, sequence: 5 }]);
        assert_eq!(latch, Latch::default());
    }

    #[test]
    fn no_stop_of_a_sender_replaces_the_one_without_sender() {
        let (unlisted, numbered) = (StopName::default(), StopName { source: 0, sequence: 9 });
        for order in [[unlisted, numbered], [numbered, unlisted]] {
            let mut latch = Latch::default();
            for StopName { source, sequence } in order {
                assert!(!latch.covers(StopName { source, sequence }));
                latch.engage(LatchedStop { source, sequence, ..stop() });
            }
            assert_eq!(latch.stops().iter().map(LatchedStop::name).collect::<Vec<_>>(), order);
            latch.release(numbered).unwrap();
            assert_eq!(latch.stop().map(LatchedStop::name), Some(unlisted), "the unlisted stops hold the array");
        }
    }

    #[test]
    fn more_stops_than_the_list_holds_leave_one_that_has_to_be_released() {
        let mut latch = latch_of(3 * MAX_STOPS as u64);
        assert_eq!(latch.stops().len(), MAX_STOPS);
        assert!(latch.covers(StopName { source: 40, sequence: 1 }), "a repetition adds nothing to a full list");
        for source in 1..MAX_STOPS as u64 {
            latch.release(StopName { source, sequence: 5 }).unwrap();
        }
        let left = latch.stop().expect("the unlisted stops hold the array");
        assert!(!latch.covers(StopName { source: 40, sequence: 1 }), "a repetition finds a place again");
        assert!(left.name() == StopName::default() && left.reason.contains("more stops"), "{left:?}");
        latch.release(StopName::default()).unwrap();
        assert_eq!(latch.stop(), None);
    }

    #[test]
    fn a_stop_without_sender_that_was_there_before_states_that_it_stands_for_others_too() {
        for reason in ["the last state is unknown".to_owned(), "é".repeat(MAX_TEXT)] {
            let mut latch = Latch::stopped(LatchedStop::without_sender(&reason, 7));
            let former = latch.stops()[0].reason.clone();
            let engage = |latch: &mut Latch, source| latch.engage(LatchedStop { source, sequence: 5, ..stop() });
            (1..MAX_STOPS as u64).for_each(|source| engage(&mut latch, source));
            assert_eq!((latch.stops().len(), &latch.stops()[0].reason), (MAX_STOPS, &former), "each one is listed");
            for source in 40..42 {
                engage(&mut latch, source);
                let reason = &latch.stops()[0].reason;
                assert_eq!((latch.stops().len(), &**reason), (MAX_STOPS, cut(&format!("{UNLISTED_STOPS}; {former}"))));
                assert!(Latch::parse(&latch.to_toml()).is_ok(), "{} bytes", reason.len());
            }
        }
    }
}
