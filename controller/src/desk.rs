//! Where payloads are decoded, ticks answered and commands published.
//!
//! One desk a room, behind a mutex. It is held by whoever decides, see [`crate::intake`], and by the status loop only to exchange
//! ledgers and to copy counters.
//!
//! Several payloads may be taken before one answer: the newest tick is answered, and those that it replaced are shed and counted.

use std::{
    ops::RangeInclusive,
    sync::Arc,
    time::{Duration, Instant},
};

use heliostat_bus::Publisher;
use heliostat_proto::{
    ChannelReport, CodecError, MirrorCommand, MirrorTelemetry, Nanos, ObstacleReport, UserReport, decode_into, encode,
};
use heliostat_service::clock::utc_ns;

use crate::{
    control::ControlAccount,
    ledger::{Laps, Ledger},
    rhythm::Rhythm,
    standby::Standby,
};
use heliostat_decide::{
    core::{Accepted, Controller, Decision, Haste, Stage},
    inbox::Message,
    refusal::{Refusal, Stream},
};

/// Where room time comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RoomClock {
    /// UTC.
    Utc,
    /// The time of the newest report: the room computes faster or slower than the world, and waits for answers.
    Lockstep {
        /// Time of the newest report so far.
        newest_ns: Nanos,
    },
}

impl RoomClock {
    /// Room time at the arrival of a report of the given time.
    fn at_arrival(&mut self, report_ns: Nanos) -> Nanos {
        match self {
            Self::Utc => utc_ns(),
            Self::Lockstep { newest_ns } => {
                *newest_ns = report_ns.max(*newest_ns);
                *newest_ns
            }
        }
    }

    /// Room time now.
    pub fn now(&self) -> Nanos {
        match self {
            Self::Utc => utc_ns(),
            Self::Lockstep { newest_ns } => *newest_ns,
        }
    }
}

/// Share of the newest duration in the mean that is expected of the next one.
const NEWEST_SHARE: f64 = 0.125;

/// Decisions that take so long gain by warm caches more than waking a thread costs; what takes longer still gains little, and would be in the way.
const WORTH_REHEARSING: RangeInclusive<Duration> = Duration::from_micros(250)..=Duration::from_millis(5);

/// The same of decisions that are rehearsed, and therefore quicker than they would be.
const WORTH_GOING_ON: RangeInclusive<Duration> = Duration::from_micros(125)..=Duration::from_millis(5);

/// Rehearsals end at least this long before a report is expected.
const BEFORE_REPORT: Duration = Duration::from_micros(50);

/// What a report that comes as late as it is likely to takes to get here.
const AFTER_REPORT: Duration = Duration::from_micros(100);

/// Longer than this nobody stays awake for a report: a twentieth of the time between reports at 100 a second.
const AWAKE_MAX: Duration = Duration::from_micros(500);

/// The controller with everything that deciding needs.
pub struct Desk {
    /// The deciding core.
    pub controller: Controller,
    /// Room time.
    pub clock: RoomClock,
    /// Times since the status loop last took them.
    pub ledger: Ledger,
    /// Commands that the transport did not take.
    pub unsent: u64,
    /// Ticks that were replaced by newer ones before they were answered.
    pub shed: u64,
    /// Rehearsals between sparse reports.
    pub rehearsals: u64,
    /// What was wrong with the last payload that was no message.
    pub last_malformed: Option<CodecError>,
    /// What operators ordered.
    pub control: ControlAccount,
    publisher: Publisher,
    standby: Arc<Standby>,
    payload: Vec<u8>,
    users: UserReport,
    channel: ChannelReport,
    obstacles: ObstacleReport,
    telemetry: MirrorTelemetry,
    /// The stamps of the tick that is to be answered.
    due: Option<Laps>,
    deadline: Duration,
    /// How long the next decision is expected to take.
    expected: Duration,
    was_late: bool,
    decided: Option<Instant>,
    rhythm: Rhythm,
    /// How long a rehearsal is expected to take.
    rehearsal: Duration,
}

impl Desk {
    /// A desk that publishes commands by `publisher`, and tells `standby` of them; a decision that takes longer than `deadline` is late.
    pub fn new(
        controller: Controller,
        clock: RoomClock,
        (publisher, standby): (Publisher, Arc<Standby>),
        deadline: Duration,
    ) -> Self {
        // Two f32 a mirror, and less than 100 bytes beside them.
        let payload = Vec::with_capacity(100 + 8 * controller.observation().mirrors());
        Self {
            controller,
            clock,
            ledger: Ledger::new(),
            unsent: 0,
            shed: 0,
            rehearsals: 0,
            last_malformed: None,
            control: ControlAccount::default(),
            publisher,
            standby,
            payload,
            users: UserReport::default(),
            channel: ChannelReport::default(),
            obstacles: ObstacleReport::default(),
            telemetry: MirrorTelemetry::default(),
            due: None,
            deadline,
            expected: Duration::ZERO,
            was_late: false,
            decided: None,
            rhythm: Rhythm::default(),
            rehearsal: Duration::ZERO,
        }
    }

    /// Takes a payload of a stream; `entered` is when its callback was entered.
    pub fn take(&mut self, stream: Stream, payload: &[u8], entered: Instant) {
        let mut laps = Laps::start(entered);
        laps.mark(Stage::Waited);
        let decoded = match stream {
            Stream::Users => decode_into(&mut self.users, payload),
            Stream::Channel => decode_into(&mut self.channel, payload),
            Stream::Obstacles => decode_into(&mut self.obstacles, payload),
            Stream::Telemetry => decode_into(&mut self.telemetry, payload),
        };
        if let Err(error) = decoded {
            self.controller.count_malformed(stream, Refusal::from(&error));
            self.last_malformed = Some(error);
            return;
        }
        let message = match stream {
            Stream::Users => Message::Users(&mut self.users),
            Stream::Channel => Message::Channel(&mut self.channel),
            Stream::Obstacles => Message::Obstacles(&mut self.obstacles),
            Stream::Telemetry => Message::Telemetry(&mut self.telemetry),
        };
        let now = self.clock.at_arrival(message.stamp().time_ns);
        match self.controller.accept(now, message) {
            Accepted::Tick => {
                self.rhythm.heard(entered);
                laps.mark(Stage::Decoded);
                self.shed += u64::from(self.due.replace(laps).is_some());
            }
            Accepted::TooOld => {
                let decision = self.controller.answer_stale(now);
                let sent = send(decision, &self.standby, &mut self.payload, &self.publisher);
                self.account(sent);
            }
            Accepted::Other => {}
        }
    }

    /// Answers the newest tick that was taken, if one was.
    pub fn answer(&mut self) {
        let Some(mut laps) = self.due.take() else { return };
        self.standby.tick();
        let started = Instant::now();
        let haste = self.haste(laps.waited(started));
        let decision = self.controller.decide(self.clock.now(), haste, &mut |stage| laps.mark(stage));
        let age_ns = match &decision {
            Decision::Move { age_ns, .. } => Some(*age_ns),
            Decision::Hold(_) => None,
        };
        let sent = send(decision, &self.standby, &mut self.payload, &self.publisher);
        laps.mark(Stage::Published);
        self.standby.tick();
        self.account(sent);
        if let Some(age_ns) = age_ns {
            self.ledger.record(&laps, age_ns);
        }
        if haste == Haste::InTime {
            self.expected = mean(self.expected, started.elapsed());
        }
        self.decided = Some(Instant::now());
    }

    /// Whether the last decision was made less than `breath` before `now`.
    pub fn decided_within(&self, breath: Duration, now: Instant) -> bool {
        self.decided.is_some_and(|decided| now.saturating_duration_since(decided) < breath)
    }

    /// Answers the absence of position reports, where it is time to.
    pub fn elapse(&mut self) {
        if let Some(decision) = self.controller.elapse(self.clock.now()) {
            let sent = send(decision, &self.standby, &mut self.payload, &self.publisher);
            self.account(sent);
        }
    }

    /// Whether decisions take so long that they are better made where they are rehearsed. In lockstep nobody is in a hurry.
    pub fn gains_by_rehearsal(&self) -> bool {
        self.clock == RoomClock::Utc && gains(self.expected, !self.rehearsal.is_zero())
    }

    /// How long to wait before that many rehearsals for the next report; none where no report is expected, or it is too late for that.
    pub fn until_rehearsals(&self, count: u32, now: Instant) -> Option<Duration> {
        let takes = count * if self.rehearsal.is_zero() { self.expected } else { self.rehearsal };
        let begin = self.rhythm.earliest()?.checked_sub(takes + BEFORE_REPORT)?;
        begin.checked_duration_since(now).filter(|_| self.gains_by_rehearsal())
    }

    /// Until when the next report is worth staying awake for.
    pub fn awake_until(&self, now: Instant) -> Instant {
        self.rhythm.latest().map_or(now, |latest| (latest + AFTER_REPORT).min(now + AWAKE_MAX))
    }

    /// Rehearses the next decision.
    pub fn rehearse(&mut self) {
        let begun = Instant::now();
        self.controller.rehearse();
        self.rehearsals += 1;
        self.rehearsal = mean(self.rehearsal, begun.elapsed());
    }

    fn account(&mut self, sent: Sent) {
        self.unsent += u64::from(!sent.taken);
        self.controller.skip_to(sent.sequence);
    }

    /// Late is what would be ready after the deadline, but never twice in a row: the policy must come to decide. In lockstep the room waits.
    fn haste(&mut self, waited: Duration) -> Haste {
        let late = self.clock == RoomClock::Utc && !self.was_late && waited + self.expected > self.deadline;
        self.was_late = late;
        if late { Haste::Late } else { Haste::InTime }
    }
}

/// Whether decisions that take so long, rehearsed or not, gain by being rehearsed.
fn gains(expected: Duration, rehearsed: bool) -> bool {
    let worth = if rehearsed { WORTH_GOING_ON } else { WORTH_REHEARSING };
    worth.contains(&expected)
}

/// The mean of durations, once the newest has come.
fn mean(before: Duration, newest: Duration) -> Duration {
    if before.is_zero() { newest } else { before.mul_f64(1.0 - NEWEST_SHARE) + newest.mul_f64(NEWEST_SHARE) }
}

/// What became of an answer.
struct Sent {
    /// Whether the transport took it.
    taken: bool,
    /// The command's number; 0 for none.
    sequence: u64,
}

/// Publishes a command, where the decision is one. The core's commands are sound, so encoding fails no more than the transport does.
fn send(decision: Decision<'_>, standby: &Standby, payload: &mut Vec<u8>, publisher: &Publisher) -> Sent {
    let Decision::Move { command, .. } = decision else { return Sent { taken: true, sequence: 0 } };
    let sequence = standby.note(command);
    let encoded = if sequence == command.sequence {
        encode(command, payload)
    } else {
        encode(&MirrorCommand { sequence, ..command.clone() }, payload)
    };
    Sent { taken: encoded.is_ok() && publisher.put(payload).is_ok(), sequence }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_rehearsals_make_quick_is_rehearsed_further() {
        let us = Duration::from_micros;
        assert_eq!([us(200), us(300), us(6000)].map(|expected| gains(expected, false)), [false, true, false]);
        assert_eq!([us(100), us(200), us(6000)].map(|expected| gains(expected, true)), [false, true, false]);
    }
}
