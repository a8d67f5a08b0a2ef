//! The process of a calibration: the production [`Commander`] and [`Session`] with what `heliostat calibrate
//! --take-over` does around them. It is a guest: it takes the lead from the controllers, and gives it back.

use heliostat_calibrate::commander::{
    Commander, Guest, LEAD_EVERY_NS, LEAD_WITHIN_NS, RELEASE_NS, TELEMETRY_GAP_MAX_NS, VALIDITY_MS,
};
use heliostat_calibrate::{Place, Prior, Session, Setup, Stage};
use heliostat_channel::MirrorAngles;
use heliostat_proto::EPOCH_SLOTS;
use heliostat_proto::{
    ArrayState, Capabilities, ChannelReport, EmergencyStop, MirrorCommand, MirrorTelemetry, NodeKind, SafetyReport,
    StopAction, StopRepetition, UserReport, decode,
};
use heliostat_scenario::MismatchLevel;

use super::{Context, Incoming, Outgoing, encoded};
use crate::clock::MS;
use crate::mutation::Mutation;
use crate::room::Room;
use crate::topic::Topic;

/// The user who holds the receiver.
pub(crate) const HOLDER: u32 = 0;

/// Time between two queries of the array in ns.
const QUERY_EVERY_NS: u64 = 200 * MS;

/// Longest time between two looks at its own times in ns.
const LOOK_EVERY_NS: u64 = 20 * MS;

/// Age in ns beyond which a report does not count.
const REPORT_AGE_MAX_NS: u64 = 1000 * MS;

/// Spots at which the receiver shall stand.
const SPOTS: usize = 3;

/// What the process does; times are local.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    /// Asks the array for its announcements.
    Opening {
        until_ns: u64,
    },
    /// Commands until the array follows it.
    Taking {
        until_ns: u64,
    },
    /// Measures.
    Leading,
    /// Has withdrawn its token, to take the lead again.
    Again,
    /// Has withdrawn its token, and commands until a standby does.
    Releasing {
        until_ns: u64,
    },
    Ended,
}

/// What is known of the array before the first command.
#[derive(Default)]
struct Announced {
    capabilities: Option<Capabilities>,
    safety: Option<SafetyReport>,
    telemetry: Option<MirrorTelemetry>,
}

/// What commands and measures.
struct Work {
    commander: Commander,
    session: Box<Session>,
    /// Source of the telemetry, and the calibration in use, at the start.
    driver: (u64, u64),
    /// When the last telemetry arrived, in local time.
    answered_ns: u64,
    /// Whether another array follows a controller.
    is_disturbed: bool,
}

/// A process of a calibration.
pub(crate) struct Calibration {
    array: usize,
    source: u64,
    room: Room,
    phase: Phase,
    announced: Announced,
    work: Option<Work>,
    /// Whether the operator has asked it to end.
    is_asked: bool,
    /// Whether the array has followed it.
    has_led: bool,
    wake_ns: u64,
}

impl Calibration {
    pub fn start(array: usize, source: u64, room: &Room, ctx: &mut Context<'_>) -> Self {
        ctx.monitor.commands.welcome(source);
        ctx.publish(Topic::Query, Vec::new());
        Self {
            array,
            source,
            room: room.clone(),
            phase: Phase::Opening { until_ns: ctx.at.local_ns + LEAD_WITHIN_NS },
            announced: Announced::default(),
            work: None,
            is_asked: false,
            has_led: false,
            wake_ns: ctx.at.local_ns + QUERY_EVERY_NS,
        }
    }

    pub fn array(&self) -> usize {
        self.array
    }

    pub fn next_ns(&self) -> Option<u64> {
        (self.phase != Phase::Ended).then_some(self.wake_ns)
    }

    /// Whether its liveliness token is announced.
    pub fn has_token(&self) -> bool {
        matches!(self.phase, Phase::Taking { .. } | Phase::Leading)
    }

    /// The remainder of its epochs, while the array follows it as far as telemetry shows.
    pub fn lead(&self) -> Option<u64> {
        (self.phase == Phase::Leading).then_some(self.slot())
    }

    /// The remainder of its epochs.
    pub fn slot(&self) -> u64 {
        self.source % EPOCH_SLOTS
    }

    /// The names of what has occurred.
    pub fn occurred(&self) -> Vec<String> {
        let has_probed = self.work.as_ref().is_some_and(|work| !work.session.readings().is_empty());
        let names = [(self.has_led, "calibration:led"), (has_probed, "calibration:probed")];
        names.iter().filter(|(is_so, _)| *is_so).map(|(_, name)| (*name).to_owned()).collect()
    }

    /// The operator ends it: it gives the lead back as soon as it runs.
    pub fn ask_to_end(&mut self) {
        self.is_asked = true;
    }

    pub fn handle(&mut self, incoming: &Incoming, ctx: &mut Context<'_>) {
        match incoming {
            Incoming::Payload { topic, payload, .. } => self.handle_payload(*topic, payload, ctx),
            Incoming::Presence { node: NodeKind::Controller, source, is_alive } => {
                if let Some(work) = &mut self.work {
                    work.commander.handle_controller(*source, *is_alive);
                }
            }
            Incoming::Presence { .. } => {}
        }
        self.advance(ctx);
    }

    pub fn wake(&mut self, ctx: &mut Context<'_>) {
        if ctx.at.local_ns < self.wake_ns {
            return;
        }
        if let Phase::Opening { .. } = self.phase {
            ctx.publish(Topic::Query, Vec::new());
        }
        if let Phase::Taking { .. } = self.phase {
            self.answer(0, ctx);
        }
        self.advance(ctx);
        let wait_ns = match self.phase {
            Phase::Opening { .. } => QUERY_EVERY_NS,
            Phase::Taking { .. } => LEAD_EVERY_NS,
            Phase::Again | Phase::Leading | Phase::Releasing { .. } | Phase::Ended => LOOK_EVERY_NS,
        };
        let due_ns = self
            .work
            .as_ref()
            .map_or(wait_ns, |work| work.session.next_wake(ctx.at.room_ns).saturating_sub(ctx.at.room_ns).max(MS));
        self.wake_ns = ctx.at.local_ns + if self.phase == Phase::Leading { wait_ns.min(due_ns) } else { wait_ns };
    }

    fn handle_payload(&mut self, topic: Topic, payload: &[u8], ctx: &mut Context<'_>) {
        match topic {
            Topic::Capabilities(array) if array == self.array => self.announced.capabilities = decode(payload).ok(),
            Topic::Safety(array) if array == self.array => self.announced.safety = decode(payload).ok(),
            Topic::Telemetry(array) => self.handle_telemetry(array, payload, ctx),
            Topic::Users => self.handle_users(payload, ctx),
            Topic::Channel => self.handle_channel(payload, ctx),
            Topic::Stop if decode::<EmergencyStop>(payload).is_ok_and(|order| order.action == StopAction::Stop) => {
                self.note_stop();
            }
            Topic::Repetition(array) if array == self.array && decode::<StopRepetition>(payload).is_ok() => {
                self.note_stop();
            }
            _ => {}
        }
    }

    fn handle_telemetry(&mut self, array: usize, payload: &[u8], ctx: &Context<'_>) {
        let Ok(telemetry) = decode::<MirrorTelemetry>(payload) else { return };
        if let Some(work) = &mut self.work {
            if array != self.array {
                work.is_disturbed |= telemetry.state == ArrayState::Following;
                return;
            }
            if let Some(delay_ns) = work.commander.handle_telemetry(ctx.at.room_ns, &telemetry) {
                work.session.handle_command_delay(delay_ns);
            }
            work.answered_ns = ctx.at.local_ns;
        }
        if array == self.array {
            self.announced.telemetry = Some(telemetry);
        }
    }

    fn handle_users(&mut self, payload: &[u8], ctx: &mut Context<'_>) {
        let Ok(report) = decode::<UserReport>(payload) else { return };
        if report.stamp.time_ns.abs_diff(ctx.at.room_ns) >= REPORT_AGE_MAX_NS {
            return;
        }
        if !ctx.has(Mutation::GuestSilent) {
            self.answer(report.tick, ctx);
        }
        if let (Some(work), Phase::Leading) = (&mut self.work, self.phase) {
            work.session.handle_users(&report);
        }
    }

    fn handle_channel(&mut self, payload: &[u8], ctx: &Context<'_>) {
        let Ok(report) = decode::<ChannelReport>(payload) else { return };
        let is_recent = report.stamp.time_ns.abs_diff(ctx.at.room_ns) < REPORT_AGE_MAX_NS;
        if let (Some(work), Phase::Leading, true) = (&mut self.work, self.phase, is_recent) {
            work.session.handle_channel(&report);
        }
    }

    fn note_stop(&mut self) {
        if let Some(work) = &mut self.work {
            work.commander.note_stop();
        }
    }

    /// Repeats the last angles.
    fn answer(&mut self, tick: u64, ctx: &mut Context<'_>) {
        let command = self.work.as_mut().and_then(|work| work.commander.answer(ctx.at.room_ns, tick));
        self.publish(command, ctx);
    }

    fn publish(&mut self, command: Option<MirrorCommand>, ctx: &mut Context<'_>) {
        let Some(command) = command else { return };
        let (topic, payload) = (Topic::Command(self.array), encoded(&command));
        ctx.monitor.sent(ctx.now, self.source, self.array, &payload);
        ctx.out.push(Outgoing { topic, payload, to: None, after_ns: 0 });
    }

    /// Does what the phase requires.
    pub fn advance(&mut self, ctx: &mut Context<'_>) {
        let now_ns = ctx.at.local_ns;
        let is_asked = self.is_asked && !ctx.has(Mutation::LeadKept);
        match self.phase {
            Phase::Opening { .. } if is_asked => self.phase = Phase::Ended,
            Phase::Taking { .. } | Phase::Again | Phase::Leading if is_asked => self.release(ctx),
            Phase::Opening { until_ns } => {
                if let Some(work) = self.open(ctx) {
                    let is_stopped = self.announced.telemetry.as_ref().is_some_and(is_stopped);
                    self.work = Some(work).filter(|_| !is_stopped);
                    self.phase = Phase::Ended;
                    self.take(ctx);
                } else if now_ns >= until_ns {
                    self.phase = Phase::Ended;
                }
            }
            Phase::Taking { until_ns } => match self.work.as_ref().and_then(|work| work.commander.has_lead()) {
                Some(true) => (self.phase, self.has_led) = (Phase::Leading, true),
                Some(false) => self.release(ctx),
                None if now_ns >= until_ns => self.release(ctx),
                None => {}
            },
            Phase::Again => self.take(ctx),
            Phase::Leading => self.measure(ctx),
            Phase::Releasing { until_ns } => {
                let Some(work) = &mut self.work else { return };
                if now_ns >= until_ns || work.commander.superseded_by().is_some() {
                    work.commander.rest();
                    self.phase = Phase::Ended;
                }
            }
            Phase::Ended => {}
        }
    }

    /// What commands and measures, once the array has announced itself.
    fn open(&self, ctx: &Context<'_>) -> Option<Work> {
        let Announced { capabilities, safety, telemetry } = &self.announced;
        let (capabilities, safety, telemetry) = (capabilities.as_ref()?, safety.as_ref()?, telemetry.as_ref()?);
        let validity_ms =
            if safety.validity_max_ms == 0 { VALIDITY_MS } else { VALIDITY_MS.min(safety.validity_max_ms) };
        let [roll, yaw] = capabilities.park_rad.map(f64::from);
        let mirrors = capabilities.mirrors();
        let commander = Commander::new(Guest {
            source: self.source,
            interval_ns: self.room.interval_ns,
            validity_ms,
            validity_clock: capabilities.validity_clock,
            takes_over: true,
            announced: telemetry.epoch.max(safety.epoch),
            parked: MirrorAngles { roll: vec![roll; mirrors], yaw: vec![yaw; mirrors] },
        });
        let place = Place { floor_m: None, height_m: self.room.scenario.receiver.height_m };
        let session = Session::new(Setup {
            model: (*self.room.model).clone(),
            room: self.room.scenario.room.clone(),
            array: self.array,
            capabilities: capabilities.clone(),
            prior: Prior::of_level(MismatchLevel::Typical),
            spots: vec![place; SPOTS],
            verify: place,
            user: Some(HOLDER),
            unusable: telemetry.unusable.clone(),
        });
        Some(Work {
            commander,
            session: Box::new(session.ok()?),
            driver: (telemetry.stamp.source, telemetry.calibration),
            answered_ns: ctx.at.local_ns,
            is_disturbed: false,
        })
    }

    fn take(&mut self, ctx: &mut Context<'_>) {
        let Some(work) = &mut self.work else { return };
        work.commander.take();
        self.phase = Phase::Taking { until_ns: ctx.at.local_ns + LEAD_WITHIN_NS };
        self.wake_ns = ctx.at.local_ns + LEAD_EVERY_NS;
        self.answer(0, ctx);
    }

    /// Takes a lost lead again, ends where the room does not allow to go on, and commands what the session wants.
    fn measure(&mut self, ctx: &mut Context<'_>) {
        let Some(work) = &mut self.work else { return };
        if work.commander.retake().is_some() {
            work.session.handle_pause(work.commander.confirmed_ns());
            self.phase = Phase::Again;
            self.wake_ns = ctx.at.local_ns + MS;
            return;
        }
        let shown = self.announced.telemetry.as_ref();
        let is_other = shown.is_some_and(|shown| (shown.stamp.source, shown.calibration) != work.driver);
        let is_over = work.commander.superseded_by().is_some()
            || work.commander.is_stopped()
            || work.is_disturbed
            || work.session.stage() == Stage::Ended
            || ctx.at.local_ns.saturating_sub(work.answered_ns) >= TELEMETRY_GAP_MAX_NS;
        if is_over || is_other {
            return self.release(ctx);
        }
        let angles = work.session.next_command(ctx.at.room_ns);
        let command = angles.and_then(|angles| work.commander.command(ctx.at.room_ns, angles));
        self.publish(command, ctx);
    }

    fn release(&mut self, ctx: &Context<'_>) {
        self.phase = Phase::Releasing { until_ns: ctx.at.local_ns + RELEASE_NS };
        self.wake_ns = self.wake_ns.min(ctx.at.local_ns + LOOK_EVERY_NS);
    }
}

fn is_stopped(telemetry: &MirrorTelemetry) -> bool {
    telemetry.state == ArrayState::Stopped
}
