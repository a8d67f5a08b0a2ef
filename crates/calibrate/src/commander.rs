//! The commands of a calibration, sans I/O: numbered as those of a controller, and repeated for each
//! position report, so that no standby takes the room for one without a leader.
//!
//! A calibration is a guest in a room with controllers. It announces its liveliness token, takes the lead
//! by [`Commander::take`] and calls [`Commander::answer`] every [`LEAD_EVERY_NS`] until
//! [`Commander::has_lead`] says how that ended. At its end it withdraws the token first, and commands on
//! until a standby has taken the lead, for [`RELEASE_NS`] at most.

use std::collections::VecDeque;

use heliostat_channel::MirrorAngles;
use heliostat_core::tenure::{Evidence, Standing, Tenure, TenureEvent};
use heliostat_proto::{ArrayState, MirrorCommand, MirrorTelemetry, Nanos, ValidityClock};

/// Time between two commands by which the lead is taken, in ns.
pub const LEAD_EVERY_NS: Nanos = 50_000_000;

/// Longest wait for capabilities, telemetry and the lead, in ns.
pub const LEAD_WITHIN_NS: Nanos = 5_000_000_000;

/// Time for which an array keeps a command while its successor takes the lead, in ns.
pub const RELEASE_NS: Nanos = 500_000_000;

/// Longest time without telemetry in ns: an array publishes ten messages a second.
pub const TELEMETRY_GAP_MAX_NS: Nanos = 2_000_000_000;

/// Validity of a command in ms, where the array accepts that long.
pub const VALIDITY_MS: u32 = 1000;

/// How often a calibration that takes over takes the lead again from a controller that took it: a busy machine
/// delays its commands, and the controller then takes it for one that has left.
const RETAKES_MAX: u32 = 3;

/// Commands whose times are remembered until telemetry shows them.
const REMEMBERED: usize = 128;

/// Who commands, and what of its array decides how.
#[derive(Clone, Debug)]
pub struct Guest {
    /// Random id of the process.
    pub source: u64,
    /// Time between two position reports in ns.
    pub interval_ns: Nanos,
    /// Validity of the commands in ms.
    pub validity_ms: u32,
    /// By which clock the array counts the validity.
    pub validity_clock: ValidityClock,
    /// Whether the lead is taken whatever the array follows.
    pub takes_over: bool,
    /// The highest epoch that the array had announced at the start.
    pub announced: u64,
    /// The angles with which each lead begins.
    pub parked: MirrorAngles,
}

/// The commands of one array.
pub struct Commander {
    guest: Guest,
    tenure: Tenure,
    /// The angles of the last command.
    angles: MirrorAngles,
    /// Sequences and times of commands whose application telemetry has not shown.
    sent: VecDeque<(u64, Nanos)>,
    /// Tick of the last position report.
    tick: u64,
    /// The epoch in the latest telemetry.
    followed: u64,
    /// Whether telemetry counts for the epoch; not before the first command of a takeover.
    heeds_telemetry: bool,
    superseded: Option<u64>,
    /// Until when telemetry has shown the array to follow this process.
    confirmed_ns: Nanos,
    /// When the last telemetry that showed it arrived.
    followed_ns: Nanos,
    /// How often the lead was taken again.
    retaken: u32,
    /// Whether nothing is commanded for now, because the room is in use.
    rests: bool,
    /// Whether a stop was ordered or is in force: nothing is commanded any more.
    stopped: bool,
}

impl Commander {
    /// Commands nothing until the lead is [taken](Self::take).
    pub fn new(guest: Guest) -> Self {
        Self {
            tenure: Tenure::live(guest.source, guest.interval_ns),
            angles: guest.parked.clone(),
            sent: VecDeque::new(),
            tick: 0,
            followed: guest.announced,
            heeds_telemetry: !guest.takes_over,
            superseded: None,
            confirmed_ns: 0,
            followed_ns: 0,
            retaken: 0,
            rests: true,
            stopped: false,
            guest,
        }
    }

    /// Commands nothing until the lead is taken again.
    pub fn rest(&mut self) {
        self.rests = true;
    }

    /// Begins to take the lead, above each epoch that the array has announced or followed.
    pub fn take(&mut self) {
        let highest = self.followed.max(self.superseded.unwrap_or_default()).max(self.guest.announced);
        self.tenure.restart();
        self.tenure.handle_announced_epoch(highest);
        self.angles.clone_from(&self.guest.parked);
        self.sent.clear();
        self.heeds_telemetry = !self.guest.takes_over;
        self.superseded = None;
        self.rests = false;
    }

    /// The epoch of the controller that took the lead, where the lead may be taken again from it; each call that
    /// gives one counts.
    pub fn retake(&mut self) -> Option<u64> {
        let superseded = self.superseded.filter(|_| self.may_retake())?;
        self.retaken += 1;
        Some(superseded)
    }

    /// Whether a lead that is lost would be taken again.
    pub fn may_retake(&self) -> bool {
        self.guest.takes_over && !self.stopped && self.retaken < RETAKES_MAX
    }

    /// Whether the array follows this process; `None` while that is open.
    pub fn has_lead(&self) -> Option<bool> {
        match self.tenure.standing() {
            Standing::Standby => Some(false),
            Standing::Leading => (self.followed == self.tenure.epoch()).then_some(true),
            Standing::Waiting => None,
        }
    }

    /// Compares telemetry; the delay in ns of the command that it shows, if it is the first to.
    pub fn handle_telemetry(&mut self, now: Nanos, telemetry: &MirrorTelemetry) -> Option<Nanos> {
        self.followed = telemetry.epoch;
        self.stopped |= telemetry.state == ArrayState::Stopped;
        if self.heeds_telemetry && !self.rests {
            let event = self.tenure.handle_telemetry(now, Evidence::from(telemetry));
            if event == Some(TenureEvent::Superseded) {
                self.superseded = Some(telemetry.epoch);
            }
        }
        if telemetry.epoch != self.tenure.epoch() {
            return None;
        }
        // The times of a driver without UTC do not compare with those here.
        let has_clock = self.guest.validity_clock == ValidityClock::SourceTime;
        if telemetry.state == ArrayState::Following {
            // Without its time, it was made after the one before arrived.
            let before_ns = std::mem::replace(&mut self.followed_ns, now);
            let at_ns = if has_clock { telemetry.stamp.time_ns.min(now) } else { before_ns };
            self.confirmed_ns = self.confirmed_ns.max(at_ns);
        }
        let at = self.sent.iter().position(|(sequence, _)| *sequence == telemetry.applied_sequence)?;
        let (_, sent_ns) = self.sent[at];
        self.sent.drain(..=at);
        has_clock.then(|| telemetry.applied_ns.saturating_sub(sent_ns))
    }

    /// A stop was ordered, whether or not the array has received it.
    pub fn note_stop(&mut self) {
        self.stopped = true;
    }

    /// Whether a stop was ordered or reported.
    pub fn is_stopped(&self) -> bool {
        self.stopped
    }

    /// Another controller is in the room, or has left.
    pub fn handle_controller(&mut self, source: u64, is_present: bool) {
        self.tenure.handle_controller(source, is_present);
    }

    /// The answer to a position report: the last angles again.
    pub fn answer(&mut self, now: Nanos, tick: u64) -> Option<MirrorCommand> {
        self.tick = tick;
        self.next(now)
    }

    /// The command of these angles.
    pub fn command(&mut self, now: Nanos, angles: MirrorAngles) -> Option<MirrorCommand> {
        self.angles = angles;
        self.next(now)
    }

    /// The epoch of the controller that took the lead from this process.
    pub fn superseded_by(&self) -> Option<u64> {
        self.superseded
    }

    /// Until when telemetry has shown the array to follow this process, in its present lead or a former one.
    pub fn confirmed_ns(&self) -> Nanos {
        self.confirmed_ns
    }

    /// The epoch of the commands.
    pub fn epoch(&self) -> u64 {
        self.tenure.epoch()
    }

    fn next(&mut self, now: Nanos) -> Option<MirrorCommand> {
        let stands_by = self.tenure.standing() == Standing::Standby;
        // After a release the array must not get angles of before the stop.
        // A process that has lost the lead stays out of it: its readings would be of another's angles.
        if self.stopped || self.rests || self.superseded.is_some() || (stands_by && self.heeds_telemetry) {
            return None;
        }
        let (Some(epoch), _) = self.tenure.permit(now) else { return None };
        self.heeds_telemetry = true;
        let sequence = self.tenure.next_sequence();
        self.sent.push_back((sequence, now));
        if self.sent.len() > REMEMBERED {
            self.sent.pop_front();
        }
        let narrow = |angles: &[f64]| angles.iter().map(|angle| *angle as f32).collect();
        Some(MirrorCommand {
            epoch,
            sequence,
            answers: self.tick,
            time_ns: now,
            validity_ms: self.guest.validity_ms,
            roll: narrow(&self.angles.roll),
            yaw: narrow(&self.angles.yaw),
        })
    }
}

#[cfg(test)]
mod tests {
    use heliostat_proto::Stamp;

    use super::*;

    const MS: Nanos = 1_000_000;

    fn guest(takes_over: bool) -> Commander {
        guest_of(ValidityClock::SourceTime, takes_over)
    }

    fn guest_of(validity_clock: ValidityClock, takes_over: bool) -> Commander {
        Commander::new(Guest {
            source: 5,
            interval_ns: 10 * MS,
            validity_ms: VALIDITY_MS,
            validity_clock,
            takes_over,
            announced: 7000,
            parked: MirrorAngles::flat(1),
        })
    }

    /// Takes the lead at 0, and answers reports until the first command.
    fn leading() -> (Commander, MirrorCommand) {
        let mut commander = guest(true);
        commander.take();
        let command = (0..50).find_map(|tick| commander.answer(tick * 10 * MS, tick)).expect("a command");
        (commander, command)
    }

    #[test]
    fn a_guest_commands_nothing_before_it_takes_the_lead_and_after_it_rests() {
        let mut commander = guest(true);
        assert_eq!(commander.answer(1000 * MS, 1), None);
        let (mut commander, _) = leading();
        commander.rest();
        assert_eq!(commander.answer(1000 * MS, 1), None);
    }

    #[test]
    fn the_lead_is_taken_above_the_announced_epoch_and_is_gained_when_telemetry_shows_it() {
        let (mut commander, command) = leading();
        assert!(command.epoch > 7000 && command.sequence == 1, "{command:?}");
        assert_eq!(commander.has_lead(), None);
        commander.handle_telemetry(500 * MS, &MirrorTelemetry { epoch: command.epoch, ..MirrorTelemetry::default() });
        assert_eq!(commander.has_lead(), Some(true));
    }

    #[test]
    fn a_lead_that_is_taken_again_gives_no_number_of_a_former_epoch_twice() {
        let (mut commander, first) = leading();
        commander.take();
        let again = (50..100).find_map(|tick| commander.answer(tick * 10 * MS, tick)).expect("a command");
        assert_eq!((again.epoch, again.sequence), (first.epoch, first.sequence + 1));
    }

    #[test]
    fn telemetry_confirms_the_lead_until_its_own_time_or_until_the_one_before_arrived() {
        for (clock, expected) in [(ValidityClock::SourceTime, 597), (ValidityClock::Arrival, 500)] {
            let mut commander = guest_of(clock, true);
            commander.take();
            let command = (0..50).find_map(|tick| commander.answer(tick * 10 * MS, tick)).expect("a command");
            let shown = |time_ms: Nanos, epoch, state| MirrorTelemetry {
                stamp: Stamp { time_ns: time_ms * MS, ..Stamp::default() },
                epoch,
                state,
                ..MirrorTelemetry::default()
            };
            for at_ms in [500, 600] {
                let telemetry = shown(at_ms - 3, command.epoch, ArrayState::Following);
                commander.handle_telemetry(at_ms * MS, &telemetry);
            }
            commander.handle_telemetry(700 * MS, &shown(697, command.epoch, ArrayState::Holding));
            commander.handle_telemetry(800 * MS, &shown(797, command.epoch + 1, ArrayState::Following));
            assert_eq!(commander.confirmed_ns(), expected * MS, "{clock:?}");
        }
    }

    #[test]
    fn a_lost_lead_is_taken_again_a_few_times_where_the_guest_takes_over() {
        let (mut commander, command) = leading();
        let of = |epoch| MirrorTelemetry { epoch, ..MirrorTelemetry::default() };
        commander.handle_telemetry(500 * MS, &of(command.epoch));
        commander.handle_telemetry(550 * MS, &of(command.epoch + 1));
        assert_eq!(commander.answer(560 * MS, 60), None);
        let retaken: Vec<_> = (0..4).map(|_| commander.retake()).collect();
        assert_eq!(retaken, [Some(command.epoch + 1), Some(command.epoch + 1), Some(command.epoch + 1), None]);
        commander.take();
        assert_eq!(commander.superseded_by(), None);
        assert_eq!(guest(false).retake(), None);
    }
}
