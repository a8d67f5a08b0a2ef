//! The latest report of each stream, and the rules for accepting or refusing a report.
//!
//! A report is checked in this order:
//!
//! 1. **Content**: the number of mirrors must be that of the scenario, each user must appear once,
//!    and values must be physically possible in the room. The number of users is free. Users whose
//!    position, speed or minimum rate is impossible are left out of an accepted report and counted;
//!    a report that names only such users is refused.
//! 2. **Source**: the first source whose report is accepted owns the room. Reports of another
//!    source are refused until no report of the owner was accepted for `control.source_timeout_ms`.
//!    When the owner changes, the former owner's reports are discarded, so two rooms are never
//!    mixed. Each array has an owner of its own, because another process may drive it.
//! 3. **Sequence**: a number must be higher than the last of its stream, by a bounded step
//!    ([`sequence`](crate::sequence)).
//! 4. **Time**: a report must be neither older than `control.report_age_max_ms` nor from the
//!    future.
//!
//! Only an accepted report takes ownership or renews it. Each refusal is counted by stream and
//! reason. No refusal stops the controller.

mod array;
mod rules;
mod slot;
mod state;

use heliostat_proto::{
    ChannelReport, LedReport, MirrorTelemetry, Nanos, NodeKind, ObstacleReport, OrientationReport, Stamp, UserReport,
    UserState, sender_of,
};
use heliostat_scenario::Scenario;

use crate::input::{
    refusal::{Checked, Found, LeftOut, Refusal, Refused, Stream},
    sequence::SequenceTrack,
};
use array::ArrayInbox;
use rules::{Rules, check_channel, check_obstacles, check_orientation};
use slot::Owner;
pub use state::InboxState;

/// A decoded message. The inbox swaps an accepted message with the former one, whose memory the
/// caller decodes into next.
#[derive(Debug)]
pub enum Message<'a> {
    /// The users' positions; completes a tick.
    Users(&'a mut UserReport),
    /// The users' measured gains.
    Channel(&'a mut ChannelReport),
    /// A survey of the obstacles.
    Obstacles(&'a mut ObstacleReport),
    /// The state of the array with this index.
    Telemetry(usize, &'a mut MirrorTelemetry),
    /// How the users hold their receivers.
    Orientation(&'a mut OrientationReport),
    /// Which LEDs the users' receivers detect.
    Leds(&'a mut LedReport),
}

impl Message<'_> {
    /// The stream that the message belongs to, the array whose state it is (0 for reports about the room), and source,
    /// sequence number and time of the sample.
    pub fn origin(&self) -> (Stream, usize, &Stamp) {
        match self {
            Self::Users(report) => (Stream::Users, 0, &report.stamp),
            Self::Channel(report) => (Stream::Channel, 0, &report.stamp),
            Self::Obstacles(report) => (Stream::Obstacles, 0, &report.stamp),
            Self::Telemetry(array, report) => (Stream::Telemetry, *array, &report.stamp),
            Self::Orientation(report) => (Stream::Orientation, 0, &report.stamp),
            Self::Leds(report) => (Stream::Leds, 0, &report.stamp),
        }
    }
}

/// The latest accepted report of each stream.
#[derive(Clone)]
pub struct Inbox {
    rules: Rules,
    state: InboxState,
    /// Mirrors of several arrays that do not follow, by their indices in the room.
    unusable: Vec<u32>,
    refused: Refused,
    sources: u64,
}

impl Inbox {
    /// An empty inbox with the rules of a scenario.
    pub fn new(scenario: &Scenario) -> Self {
        Self {
            rules: Rules::new(scenario),
            state: InboxState::new(scenario),
            unusable: Vec::with_capacity(scenario.mirror_count()),
            refused: Refused::default(),
            sources: 0,
        }
    }

    /// Accepts or refuses a message that arrived at `now`.
    ///
    /// # Errors
    /// The [`Refusal`], already counted.
    pub fn accept(&mut self, now: Nanos, message: Message<'_>) -> Result<(), Refusal> {
        let (stream, array, &stamp) = message.origin();
        let checked = self.check(now, &message);
        match checked {
            Ok(()) => {
                self.track_mut(stream, array).on_accepted(now, &stamp);
                self.renew_owner(now, (stream, array), stamp.source);
                self.keep(message);
            }
            Err((refusal, found)) => {
                if array < self.state.arrays.len() {
                    self.track_mut(stream, array).on_refused(&stamp);
                }
                self.refused.count_found((stream, array), refusal, found);
            }
        }
        checked.map_err(|(refusal, _)| refusal)
    }

    /// Counts a payload of a stream, and of an array for telemetry, that does not decode. It arrived, if it is of
    /// the source of the stream.
    pub fn count_malformed(&mut self, place: (Stream, usize), refusal: Refusal, payload: &[u8]) {
        let (stream, array) = place;
        if let Some((source, sequence)) = sender_of(payload).filter(|_| array < self.state.arrays.len()) {
            self.track_mut(stream, array).on_unreadable(source, sequence);
        }
        self.refused.count(place, refusal);
    }

    /// The latest positions.
    pub fn users(&self) -> Option<&UserReport> {
        self.state.users.get()
    }

    /// The latest measured gains, unless they are too old at `now`.
    pub fn channel(&self, now: Nanos) -> Option<&ChannelReport> {
        self.last_channel().filter(|report| !self.rules.is_stale(now, &report.stamp))
    }

    /// The latest measured gains, of any age.
    pub fn last_channel(&self) -> Option<&ChannelReport> {
        self.state.channel.get()
    }

    /// The latest survey of the obstacles, valid until the next survey or until the room has a new
    /// owner.
    pub fn obstacles(&self) -> Option<&ObstacleReport> {
        self.state.obstacles.get()
    }

    /// The latest orientation report, of any age.
    pub fn last_orientation(&self) -> Option<&OrientationReport> {
        self.state.orientation.get()
    }

    /// How the users hold their receivers, unless the report is too old at `now`.
    pub fn orientation(&self, now: Nanos) -> Option<&OrientationReport> {
        self.last_orientation().filter(|report| !self.rules.is_stale(now, &report.stamp))
    }

    /// The LEDs that the receivers detect, if the latest report of them is of the time of the latest
    /// measured gains.
    pub fn leds(&self) -> Option<&LedReport> {
        let channel_ns = self.state.channel.get()?.stamp.time_ns;
        self.state.leds.get().filter(|report| report.stamp.time_ns == channel_ns)
    }

    /// The latest telemetry of an array.
    pub fn telemetry(&self, array: usize) -> Option<&MirrorTelemetry> {
        self.state.arrays.get(array)?.telemetry.get()
    }

    /// The mirrors that do not follow, by their indices in the room.
    pub fn unusable(&self) -> &[u32] {
        match self.state.arrays.as_slice() {
            [array] => array.telemetry.get().map_or(&[], |telemetry| &telemetry.unusable),
            _ => &self.unusable,
        }
    }

    /// Counters of refusals.
    pub fn refused(&self) -> &Refused {
        &self.refused
    }

    /// How many reports of a stream did not arrive, by the gaps in its sequence numbers.
    pub fn missed(&self, stream: Stream) -> u64 {
        match stream {
            Stream::Telemetry => self.state.arrays.iter().map(|array| array.track.missed()).sum(),
            _ => self.state.tracks[stream as usize].missed(),
        }
    }

    /// The source that owns the room.
    pub fn source(&self) -> Option<u64> {
        self.state.room.map(|owner| owner.source)
    }

    /// The source whose telemetry of an array is followed.
    pub fn array_source(&self, array: usize) -> Option<u64> {
        self.state.arrays.get(array)?.owner.map(|owner| owner.source)
    }

    /// How many sources have owned the room, in succession.
    pub fn sources(&self) -> u64 {
        self.sources
    }

    /// Sets whether an array has a synchronised clock, by its capabilities: the time of its telemetry is
    /// checked only then.
    pub fn set_clock(&mut self, array: usize, has_clock: bool) {
        self.state.arrays[array].has_clock = has_clock;
    }

    /// A process has left: its source owns nothing, its reports are discarded, and its delayed
    /// reports are refused.
    ///
    /// Only the kind of process that publishes a stream can end the ownership of it: a token of
    /// another kind may name any source.
    pub fn handle_source_lost(&mut self, node: NodeKind, source: u64) {
        for stream in Stream::ALL.into_iter().filter(|stream| publishes(node, *stream)) {
            if stream == Stream::Telemetry {
                self.state.arrays.iter_mut().for_each(|array| array.handle_source_lost(source));
                self.collect_unusable();
                continue;
            }
            self.state.tracks[stream as usize].forget(source);
            self.state.lost_room = Some(source);
            if self.state.room.is_some_and(|owner| owner.source == source) {
                self.state.room = None;
                self.state.forget_room();
            }
        }
    }

    /// A process is alive.
    pub fn handle_source_found(&mut self, node: NodeKind, source: u64) {
        let is_other = |lost: &u64| *lost != source;
        if publishes(node, Stream::Telemetry) {
            self.state.arrays.iter_mut().for_each(|array| array.lost = array.lost.filter(is_other));
        }
        if publishes(node, Stream::Users) {
            self.state.lost_room = self.state.lost_room.filter(is_other);
        }
    }

    /// The checks of a message that arrived at `now`, in the order of the [module](self).
    fn check(&mut self, now: Nanos, message: &Message<'_>) -> Checked {
        let (stream, array, stamp) = message.origin();
        self.check_content(message)?;
        self.check_source(now, (stream, array), stamp.source)?;
        let timeout_ns = self.rules.source_timeout_ns;
        self.track_mut(stream, array).check(now, stamp, timeout_ns)?;
        if stream == Stream::Telemetry && !self.state.arrays[array].has_clock {
            return Ok(());
        }
        self.rules.check_time(now, stamp)
    }

    fn track_mut(&mut self, stream: Stream, array: usize) -> &mut SequenceTrack {
        if stream == Stream::Telemetry {
            &mut self.state.arrays[array].track
        } else {
            &mut self.state.tracks[stream as usize]
        }
    }

    fn check_source(&self, now: Nanos, (stream, array): (Stream, usize), source: u64) -> Checked {
        let (owner, lost) = match stream {
            Stream::Telemetry => (self.state.arrays[array].owner, self.state.arrays[array].lost),
            _ => (self.state.room, self.state.lost_room),
        };
        if lost == Some(source) {
            return Err(Refusal::SourceGone.into());
        }
        // A clock that steps back must not extend the ownership.
        let is_alive = |owner: &Owner| now.abs_diff(owner.last_report_ns) <= self.rules.source_timeout_ns;
        match owner.filter(is_alive) {
            Some(owner) if owner.source != source => Err((Refusal::ForeignSource, Found::Source(source))),
            _ => Ok(()),
        }
    }

    /// Gives ownership to the source of an accepted report, or renews it.
    fn renew_owner(&mut self, now: Nanos, (stream, array): (Stream, usize), source: u64) {
        let is_array = stream == Stream::Telemetry;
        let slot = if is_array { &mut self.state.arrays[array].owner } else { &mut self.state.room };
        let former = slot.replace(Owner { source, last_report_ns: now });
        if former.is_some_and(|owner| owner.source == source) {
            return;
        }
        if is_array {
            self.state.arrays[array].telemetry.forget();
        } else {
            self.state.forget_room();
            self.sources += 1;
        }
    }

    fn keep(&mut self, message: Message<'_>) {
        match message {
            Message::Users(report) => {
                let (rules, refused) = (&self.rules, &mut self.refused);
                report.users.retain(|user| {
                    let user: &UserState = user;
                    let checked = rules.check_user(user);
                    if let Err(refusal) = checked {
                        refused.count_left_out(LeftOut::new(user, refusal));
                    }
                    checked.is_ok()
                });
                self.state.users.keep(report);
            }
            Message::Channel(report) => self.state.channel.keep(report),
            Message::Obstacles(report) => self.state.obstacles.keep(report),
            Message::Telemetry(array, report) => {
                self.state.arrays[array].telemetry.keep(report);
                self.collect_unusable();
            }
            Message::Orientation(report) => self.state.orientation.keep(report),
            Message::Leds(report) => self.state.leds.keep(report),
        }
    }

    /// Joins the mirrors of several arrays that do not follow. Does not allocate.
    fn collect_unusable(&mut self) {
        if self.state.arrays.len() > 1 {
            self.unusable.clear();
            self.unusable.extend(self.state.arrays.iter().flat_map(ArrayInbox::unusable));
        }
    }

    fn check_content(&self, message: &Message<'_>) -> Checked {
        match message {
            Message::Users(report) => self.rules.check_users(report),
            Message::Channel(report) => check_channel(report),
            Message::Obstacles(report) => check_obstacles(report),
            Message::Telemetry(array, report) => match self.state.arrays.get(*array) {
                Some(array) => array.check(report),
                None => Err(Refusal::WrongMirrorCount.into()),
            },
            Message::Orientation(report) => check_orientation(report),
            Message::Leds(report) => self.rules.check_leds(report),
        }
    }
}

/// Whether a kind of process publishes a stream.
pub(crate) fn publishes(node: NodeKind, stream: Stream) -> bool {
    match node {
        NodeKind::SimNode => true,
        NodeKind::Driver => stream == Stream::Telemetry,
        NodeKind::Tracker => stream != Stream::Telemetry,
        NodeKind::Controller | NodeKind::Viewer => false,
    }
}
