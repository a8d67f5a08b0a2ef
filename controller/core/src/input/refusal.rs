//! The reasons for refusing a message, counted by stream. Counting does not allocate.

use std::fmt;

use heliostat_proto::{CodecError, SPEED_MAX_M_S, UserState, named};

named! {
    /// A stream of reports.
    pub enum Stream {
        /// The users' positions; a report completes a tick.
        Users = "users",
        /// The users' measured gains.
        Channel = "channel",
        /// A survey of the obstacles.
        Obstacles = "obstacles",
        /// The state of the array.
        Telemetry = "telemetry",
        /// How the users hold their receivers.
        Orientation = "orientation",
        /// Which LEDs the users' receivers detect.
        Leds = "leds",
    }
}

named! {
    /// Why a message is refused.
    pub enum Refusal {
        /// The payload has another version of the contract.
        WrongVersion = "wrong-version",
        /// The payload is another kind of message than its key states.
        WrongKind = "wrong-kind",
        /// The payload ends too early.
        Truncated = "truncated",
        /// The payload goes on after its message.
        TrailingBytes = "trailing-bytes",
        /// The payload is larger than any message may be.
        Oversized = "oversized",
        /// A list is longer than the contract allows, or two lists differ in length.
        BadLength = "bad-length",
        /// A value is not a finite number.
        NotFinite = "not-finite",
        /// The payload does not decode for another reason.
        Malformed = "malformed",
        /// Another source owns the room.
        ForeignSource = "foreign-source",
        /// The source has left: its liveliness token ended before its last report arrived.
        SourceGone = "source-gone",
        /// The sequence number equals the last.
        Repeated = "repeated",
        /// The sequence number is lower than the last.
        OutOfOrder = "out-of-order",
        /// The sequence number is too far above the last.
        SequenceJump = "sequence-jump",
        /// Sampled too long ago.
        Stale = "stale",
        /// Sampled in the future: the clocks disagree.
        FromFuture = "from-future",
        /// Two entries for one user.
        DuplicateUser = "duplicate-user",
        /// Another number of mirrors than the scenario has.
        WrongMirrorCount = "wrong-mirror-count",
        /// A position outside the room.
        OutsideRoom = "outside-room",
        /// A value that is physically impossible, such as a negative gain.
        Implausible = "implausible",
    }
}

impl From<&CodecError> for Refusal {
    fn from(error: &CodecError) -> Self {
        match error {
            CodecError::Oversized { .. } => Self::Oversized,
            CodecError::NoHeader { .. } | CodecError::Truncated { .. } => Self::Truncated,
            CodecError::WrongVersion { .. } => Self::WrongVersion,
            CodecError::UnknownKind { .. } | CodecError::WrongKind { .. } => Self::WrongKind,
            CodecError::Malformed { .. } => Self::Malformed,
            CodecError::TrailingBytes { .. } => Self::TrailingBytes,
            CodecError::TooMany { .. } | CodecError::LengthMismatch { .. } => Self::BadLength,
            CodecError::NotFinite { .. } => Self::NotFinite,
            CodecError::OutOfDomain { .. } => Self::Implausible,
            CodecError::WrongMirrors { .. } => Self::WrongMirrorCount,
        }
    }
}

/// The last message that was refused.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LastRefusal {
    /// Its stream.
    pub stream: Stream,
    /// The array that telemetry describes; 0 for reports about the room.
    pub array: usize,
    /// Why.
    pub refusal: Refusal,
    /// The value that was refused.
    pub found: Found,
}

/// The value of a message for which it was refused, for the operator.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Found {
    /// The reason says it all.
    #[default]
    Nothing,
    /// The sizes of telemetry of another number of mirrors.
    Sizes(TelemetrySizes),
    /// How much older than the clock of this machine the sample is, in s; negative for one from the future.
    AgeS(f64),
    /// A source that does not own the room or the array.
    Source(u64),
    /// A user with an impossible position or value.
    User(LeftOut),
    /// A user with two entries.
    Twice(u32),
    /// A user with a gain that is no share of the transmitted light.
    Gain {
        /// The user.
        user: u32,
        /// The reported gain of the direct path.
        los_gain: f32,
    },
}

/// The result of a check: why a message is refused, and the value for which it is.
pub(crate) type Checked = Result<(), (Refusal, Found)>;

impl From<Refusal> for (Refusal, Found) {
    fn from(refusal: Refusal) -> Self {
        (refusal, Found::Nothing)
    }
}

/// Speed and minimum rate of a reported user.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UserValues {
    /// Speed in m/s, at most [`SPEED_MAX_M_S`].
    pub speed_m_s: f64,
    /// Minimum rate in bit/s, at least 0.
    pub min_rate_bps: f32,
}

impl From<&UserState> for UserValues {
    fn from(user: &UserState) -> Self {
        let [x, y] = user.velocity_m_s.map(f64::from);
        Self { speed_m_s: x.hypot(y), min_rate_bps: user.min_rate_bps }
    }
}

impl UserValues {
    /// Whether a user can have them.
    pub(crate) fn are_possible(&self) -> bool {
        self.min_rate_bps >= 0.0 && self.speed_m_s <= SPEED_MAX_M_S
    }
}

impl fmt::Display for UserValues {
    /// The value that is impossible, and what was expected.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { speed_m_s, min_rate_bps } = self;
        if *speed_m_s <= SPEED_MAX_M_S {
            return write!(f, "a minimum rate of {min_rate_bps} bit/s: expected 0 or more");
        }
        write!(f, "a speed of {speed_m_s:.4} m/s: expected at most {SPEED_MAX_M_S} m/s")
    }
}

/// The sizes of telemetry, and the one expected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TelemetrySizes {
    /// Number of commanded roll angles.
    pub roll: usize,
    /// Number of commanded yaw angles.
    pub yaw: usize,
    /// Number of mirrors of the array.
    pub expected: usize,
}

/// The counters of refusals, and the last refusal.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Refused {
    counts: [[u64; Refusal::ALL.len()]; Stream::ALL.len()],
    last: Option<LastRefusal>,
    left_out: u64,
    last_left_out: Option<LeftOut>,
}

/// A user whom a report of positions names, and who was left out, perhaps with the complete report.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LeftOut {
    /// The user.
    pub user: u32,
    /// Why.
    pub refusal: Refusal,
    /// The reported position in m.
    pub position_m: [f32; 3],
    /// The other reported values.
    pub values: UserValues,
}

impl LeftOut {
    /// The user of an entry, with the reason.
    pub(crate) fn new(user: &UserState, refusal: Refusal) -> Self {
        Self { user: user.user, refusal, position_m: user.position_m, values: UserValues::from(user) }
    }
}

impl Refused {
    /// Counts one refusal of a stream, and of an array for telemetry.
    pub fn count(&mut self, (stream, array): (Stream, usize), refusal: Refusal) {
        self.counts[stream as usize][refusal as usize] += 1;
        self.last = Some(LastRefusal { stream, array, refusal, found: Found::Nothing });
    }

    /// Counts one refusal, and keeps the value that was refused.
    pub(crate) fn count_found(&mut self, place: (Stream, usize), refusal: Refusal, found: Found) {
        self.count(place, refusal);
        self.last = self.last.map(|last| LastRefusal { found, ..last });
    }

    /// Counts a user who was left out of an accepted report.
    pub(crate) fn count_left_out(&mut self, left_out: LeftOut) {
        self.left_out += 1;
        self.last_left_out = Some(left_out);
    }

    /// Users who were left out of accepted reports of positions.
    pub fn left_out(&self) -> u64 {
        self.left_out
    }

    /// The last user who was left out.
    pub fn last_left_out(&self) -> Option<LeftOut> {
        self.last_left_out
    }

    /// How often messages of the stream were refused for this reason.
    pub fn get(&self, stream: Stream, refusal: Refusal) -> u64 {
        self.counts[stream as usize][refusal as usize]
    }

    /// All refusals together.
    pub fn total(&self) -> u64 {
        self.counts.iter().flatten().sum()
    }

    /// The last refusal.
    pub fn last(&self) -> Option<LastRefusal> {
        self.last
    }

    /// Every counter that is not zero, as "stream:reason".
    pub fn named(&self) -> impl Iterator<Item = (String, u64)> {
        Stream::ALL.into_iter().flat_map(move |stream| {
            Refusal::ALL.into_iter().filter_map(move |refusal| {
                let count = self.get(stream, refusal);
                (count > 0).then(|| (Self::name_of(stream, refusal), count))
            })
        })
    }

    /// The name of a counter: "stream:reason".
    pub fn name_of(stream: Stream, refusal: Refusal) -> String {
        format!("{}:{}", stream.name(), refusal.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_counters_above_zero_are_listed() {
        let mut refused = Refused::default();
        refused.count((Stream::Channel, 0), Refusal::Stale);
        refused.count((Stream::Channel, 0), Refusal::Stale);
        refused.count_found((Stream::Users, 0), Refusal::ForeignSource, Found::Source(7));
        let named: Vec<_> = refused.named().collect();
        assert_eq!(named, [("users:foreign-source".into(), 1), ("channel:stale".into(), 2)]);
        assert_eq!(refused.last().map(|last| last.found), Some(Found::Source(7)));
    }
}
