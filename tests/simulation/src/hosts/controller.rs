//! A controller process: the [`Adapter`], its recorded inputs, and the time that its decisions take.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::rc::Rc;

use heliostat_array::moment::Moment;
use heliostat_core::room_core::Output;
use heliostat_core::tenure::{Standing, TenureEvent};
use heliostat_proto::{MirrorCommand, UserReport, decode};

use super::adapter::{Adapter, Input, Published, Standby};
use super::shadow::Shadow;
use super::{Context, Incoming, Outgoing, encoded};
use crate::clock::MS;
use crate::mutation::Mutation;
use crate::plan::PolicyFault;
use crate::room::Room;
use crate::topic::Topic;
use crate::violation::Invariant;

/// Stops that a controller holds for one array at most.
const HELD_MAX: usize = 64;

/// By how much a deliberate bug lowers an epoch.
const LOWERED: u64 = 1 << 20;

/// An input as it is replayed.
struct Recorded {
    at: Moment,
    policy: (u64, Option<PolicyFault>),
    input: Input,
    is_last: bool,
}

/// A process of a controller.
pub(crate) struct ControllerNode {
    room: Room,
    source: u64,
    standby: Standby,
    started: Moment,
    adapter: Adapter,
    /// How long each decision takes, by the faults in force.
    slow_ms: Vec<u64>,
    /// The faults of its policy in force.
    faults: Vec<PolicyFault>,
    /// The inputs so far, where they are replayed.
    recorded: Option<Vec<Recorded>>,
    /// A replay from each state, where inputs are recorded.
    shadow: Option<Box<Shadow>>,
    outputs: DefaultHasher,
    /// Tick and age in ns of the last report.
    reported: (u64, u64),
    reports: u64,
    commands: u64,
    skipped: u64,
}

impl ControllerNode {
    pub fn start(room: &Room, source: u64, standby: Standby, is_recorded: bool, ctx: &mut Context<'_>) -> Self {
        let mut node = Self {
            room: room.clone(),
            source,
            standby,
            started: ctx.at,
            adapter: Adapter::new(room, source, standby, ctx.at),
            slow_ms: Vec::new(),
            faults: Vec::new(),
            recorded: is_recorded.then(Vec::new),
            shadow: is_recorded.then(|| Box::new(Shadow::new(room))),
            outputs: DefaultHasher::new(),
            reported: (0, 0),
            reports: 0,
            commands: 0,
            skipped: 0,
        };
        node.take(Input::Wake, true, ctx);
        ctx.publish(Topic::Query, Vec::new());
        node
    }

    pub fn adapter(&self) -> &Adapter {
        &self.adapter
    }

    pub fn begin_slow(&mut self, ms: u64) {
        self.slow_ms.push(ms);
    }

    pub fn end_slow(&mut self, ms: u64) {
        self.slow_ms.retain(|known| *known != ms);
    }

    pub fn begin_fault(&mut self, fault: PolicyFault) {
        self.faults.push(fault);
    }

    pub fn end_fault(&mut self, fault: PolicyFault) {
        self.faults.retain(|known| *known != fault);
    }

    /// Handles what arrives; it decides unless more is to be handled before.
    pub fn handle(&mut self, incoming: &Incoming, is_last: bool, ctx: &mut Context<'_>) {
        let input = match incoming {
            Incoming::Payload { topic, payload, .. } => Input::Payload(*topic, payload.clone()),
            Incoming::Presence { node, source, is_alive } => {
                Input::Presence { node: *node, source: *source, is_alive: *is_alive }
            }
        };
        let report = match &input {
            Input::Payload(Topic::Users, payload) => Some(decode::<UserReport>(payload).ok()),
            _ => None,
        };
        let (before, is_report) = (self.adapter.tally(), report.is_some());
        self.reports += u64::from(is_report);
        let is_skipped = is_report && ctx.has(Mutation::ReportNotCounted) && self.reports.is_multiple_of(30);
        if !is_skipped {
            let input = match report.flatten() {
                Some(report) => self.note_report(report, input, ctx),
                None => input,
            };
            self.take(input, is_last, ctx);
        }
        ctx.monitor.accounted(ctx.now, [before, self.adapter.tally()], is_report);
        if self.adapter.stops_held() > HELD_MAX {
            ctx.monitor.fail(ctx.now, (Invariant::Payload, "a controller holds too many stops".into()));
        }
    }

    pub fn wake(&mut self, ctx: &mut Context<'_>) {
        self.take(Input::Wake, true, ctx);
    }

    /// Passes the recorded inputs to a second process; whether it publishes the same bytes.
    pub fn replays(&self) -> bool {
        let Some(recorded) = &self.recorded else { return true };
        let mut adapter = Adapter::new(&self.room, self.source, self.standby, self.started);
        let (mut outputs, mut published) = (DefaultHasher::new(), Published::new());
        for Recorded { at, policy, input, is_last } in recorded {
            adapter.set_policy(*policy);
            adapter.handle(*at, input, *is_last, &mut published);
            published.drain(..).for_each(|output| hash(&output, &mut outputs));
        }
        outputs.finish() == self.outputs.finish()
    }

    /// Notes a position report; what is handled for it.
    fn note_report(&mut self, mut report: UserReport, input: Input, ctx: &Context<'_>) -> Input {
        let now = ctx.at.room_ns;
        let age_ns = now.saturating_sub(report.stamp.time_ns);
        self.reported = (report.tick, age_ns);
        if ctx.has(Mutation::StaleAnswered) && age_ns > self.room.age_max_ns {
            report.stamp.time_ns = now;
            return Input::Payload(Topic::Users, Rc::from(encoded(&report)));
        }
        input
    }

    fn take(&mut self, input: Input, is_last: bool, ctx: &mut Context<'_>) {
        let mut published = Published::new();
        let was_standby = self.adapter.is_everywhere(Standing::Standby);
        let decision_ns = self.slow_ms.iter().max().map_or(0, |ms| ms * MS);
        let policy = (decision_ns, self.faults.last().copied());
        self.adapter.set_policy(policy);
        self.shadow.iter_mut().for_each(|shadow| shadow.set_fault(policy.1));
        let epochs = self.adapter.epochs();
        let has_decided = self.adapter.handle(ctx.at, &input, is_last, &mut published);
        self.note_epochs(&epochs, ctx);
        published.iter().for_each(|output| hash(output, &mut self.outputs));
        let is_outdated = ctx.has(Mutation::StateOutdated);
        if let Some(shadow) = &mut self.shadow
            && let Err(text) = shadow.follow(ctx.at.room_ns, &input, &published, is_outdated)
        {
            ctx.monitor.fail(ctx.now, (Invariant::Replay, text));
        }
        self.record(ctx, policy, (input, is_last));
        let is_decision = published.iter().any(|(output, _)| matches!(output, Output::Command(_)));
        if has_decided && is_decision {
            ctx.busy_ns = decision_ns;
        }
        let (tick, age_ns) = self.reported;
        if self.publish(published, was_standby, ctx).contains(&tick) && tick > 0 {
            ctx.monitor.answered(ctx.now, age_ns, self.room.age_max_ns);
        }
    }

    /// Notes the epochs that were chosen.
    fn note_epochs(&self, before: &[u64], ctx: &mut Context<'_>) {
        for (array, (before, after)) in before.iter().zip(self.adapter.epochs()).enumerate() {
            if *before != after {
                let followed = self.adapter.followed_epoch(array);
                let is_lowered = ctx.has(Mutation::LowerEpochAtTakeover) && followed.is_some_and(|epoch| epoch > 0);
                let chosen = if is_lowered { after - LOWERED } else { after };
                ctx.monitor.chose(ctx.now, array, chosen, followed);
            }
        }
    }

    /// Publishes what the adapter gave; the ticks that the commands answer.
    fn publish(&mut self, published: Published, was_standby: bool, ctx: &mut Context<'_>) -> Vec<u64> {
        let after_ns = ctx.busy_ns;
        let mut ticks = Vec::new();
        for (output, payload) in published {
            let Some(topic) = topic(output) else { continue };
            if ctx.has(Mutation::StopNotRepeated) && matches!(topic, Topic::Repetition(_) | Topic::Stop) {
                continue;
            }
            let Topic::Command(array) = topic else {
                ctx.out.push(Outgoing { topic, payload, to: None, after_ns });
                continue;
            };
            if self.is_withheld(was_standby, ctx) {
                continue;
            }
            let payload = if ctx.mutation.is_some() { self.mutate(array, payload, ctx) } else { payload };
            ctx.monitor.sent(ctx.now, self.source, array, &payload);
            ticks.extend(decode::<MirrorCommand>(&payload).map(|command| command.answers));
            ctx.out.push(Outgoing { topic, payload, to: None, after_ns });
        }
        ticks
    }

    fn record(&mut self, ctx: &Context<'_>, policy: (u64, Option<PolicyFault>), (input, is_last): (Input, bool)) {
        let is_left_out = ctx.has(Mutation::InputNotRecorded) && self.reports == 40;
        if let Some(recorded) = self.recorded.as_mut().filter(|_| !is_left_out) {
            recorded.push(Recorded { at: ctx.at, policy, input, is_last });
        }
    }

    /// Whether a deliberate bug withholds commands.
    fn is_withheld(&mut self, was_standby: bool, ctx: &Context<'_>) -> bool {
        let never_leads = ctx.has(Mutation::NoTakeover) && (was_standby || self.skipped > 0);
        self.skipped += u64::from(never_leads);
        never_leads || (ctx.has(Mutation::NeverResumes) && self.adapter.count(TenureEvent::Superseded) > 0)
    }

    /// Applies the deliberate bugs of a sender.
    fn mutate(&mut self, array: usize, payload: Vec<u8>, ctx: &Context<'_>) -> Vec<u8> {
        let Ok(mut command) = decode::<MirrorCommand>(&payload) else { return payload };
        self.commands += 1;
        let followed = self.adapter.followed_epoch(array).unwrap_or_default();
        let is_turn = self.commands.is_multiple_of(40);
        match ctx.mutation {
            Some(Mutation::SequenceSkipped) => command.sequence += self.commands / 40,
            Some(Mutation::SameEpoch) if followed > 0 && followed < command.epoch => command.epoch = followed,
            Some(Mutation::LowerEpochAtTakeover) if followed > 0 && followed < command.epoch => {
                command.epoch -= LOWERED
            }
            Some(Mutation::OutOfRange) if is_turn => command.roll[0] = 1.3,
            Some(Mutation::SlewExceeded) if is_turn => {
                command.roll[0] += if command.roll[0] > 0.0 { -0.6 } else { 0.6 };
            }
            Some(Mutation::NotANumber) if is_turn => {
                let mut payload = payload;
                let end = payload.len();
                payload[end - 4..].copy_from_slice(&f32::NAN.to_le_bytes());
                return payload;
            }
            _ => return payload,
        }
        encoded(&command)
    }
}

/// The topic of an output that a host of the simulation receives.
fn topic(output: Output) -> Option<Topic> {
    match output {
        Output::Command(array) => Some(Topic::Command(array)),
        Output::StopRepetition(array) => Some(Topic::Repetition(array)),
        Output::Stop => Some(Topic::Stop),
        Output::Geometry => Some(Topic::Geometry),
        Output::Belief | Output::Memory => None,
    }
}

fn hash((output, payload): &(Output, Vec<u8>), into: &mut DefaultHasher) {
    (format!("{output:?}"), payload).hash(into);
}
