//! The operator: stops, re-arms, and the rule by which a room counts as stopped.
//!
//! The rule is that of CONTRACT.md, section 5 (confirmation), as `heliostat stop` and the page apply
//! it.

use std::rc::Rc;

use heliostat_proto::messages::fault;
use heliostat_proto::stop_hold::{HeldStop, StopHold, unknown_stops};
use heliostat_proto::{
    ArrayState, EmergencyStop, LatchedStopReport, MirrorTelemetry, Rearm, RoomGeometry, SafetyReport, Stamp,
    StopAction, StopName, StopRepetition, StopReport, decode,
};
use heliostat_scenario::Scenario;

use super::{Context, Incoming, encoded};
use crate::clock::MS;
use crate::mutation::Mutation;
use crate::plan::RearmBy;
use crate::topic::Topic;

/// Time between two repetitions of an order in ns.
const REPEAT_NS: u64 = 200 * MS;

/// For how long a re-arm is repeated in ns.
const REARM_NS: u64 = 2000 * MS;

/// A stop report of this age counts no longer, in ns.
const REPORT_AGE_MAX_NS: u64 = 2500 * MS;

/// Telemetry of this age counts no longer, in ns.
const TELEMETRY_AGE_MAX_NS: u64 = 1500 * MS;

/// What an array reported, with local times of arrival.
#[derive(Clone, Default)]
struct SeenArray {
    /// Arrival of the last telemetry of a stopped device, and its source.
    device_stopped: Option<(u64, u64)>,
    stops: Option<(u64, StopReport)>,
    hold: StopHold,
}

impl SeenArray {
    /// Whether it has latched every stop that is held, and its device has executed them, by reports that
    /// arrived since a time.
    fn has_stopped(&self, now: u64, since: u64, ignores_device: bool) -> bool {
        let Some((at, report)) = &self.stops else { return false };
        let telemetry = self.device_stopped.filter(|(_, source)| *source == report.stamp.source);
        let is_confirmed = telemetry.is_some_and(|(at, _)| now - at < TELEMETRY_AGE_MAX_NS && at >= since);
        let is_fresh = now - at < REPORT_AGE_MAX_NS && (*at >= since || is_confirmed);
        let mut held = self.hold.stops().iter().map(|held| held.name).peekable();
        is_fresh
            && held.peek().is_some()
            && (report.device_stopped || ignores_device)
            && held.all(|name| report.is_latched(name))
    }
}

/// A stop that was ordered and not confirmed yet.
#[derive(Clone, Copy)]
struct Ordered {
    name: StopName,
    begun_ns: u64,
}

/// Names that are to be released, until a local time.
struct Release {
    names: Vec<StopName>,
    ends_ns: u64,
}

/// A process of an operator.
pub(crate) struct Operator {
    source: u64,
    arrays: Vec<SeenArray>,
    /// Number of arrays of the announced geometry; 0 before the first.
    announced: usize,
    geometry: Rc<str>,
    ordered: Option<Ordered>,
    release: Option<Release>,
    wake_ns: u64,
    /// Sequences of the keys of stops, of re-arms, and of repetitions.
    sequences: [u64; 3],
}

impl Operator {
    pub fn start(source: u64, ctx: &mut Context<'_>) -> Self {
        ctx.publish(Topic::Query, Vec::new());
        Self {
            source,
            arrays: Vec::new(),
            announced: 0,
            geometry: Rc::from(""),
            ordered: None,
            release: None,
            wake_ns: ctx.at.local_ns + REPEAT_NS,
            sequences: [0; 3],
        }
    }

    pub fn next_ns(&self) -> u64 {
        self.wake_ns
    }

    pub fn handle(&mut self, incoming: &Incoming, ctx: &mut Context<'_>) {
        let Incoming::Payload { topic, payload, .. } = incoming else { return };
        match topic {
            Topic::Telemetry(array) => self.telemetry(*array, payload, ctx.at.local_ns),
            Topic::Safety(array) => {
                let Ok(report) = decode::<SafetyReport>(payload) else { return };
                self.reported(*array, report.stop().as_slice(), |hold| hold.handle_safety(&report));
            }
            Topic::Stops(array) => {
                let Ok(report) = decode::<StopReport>(payload) else { return };
                if self.reported(*array, &report.stops, |hold| hold.handle_stops(&report)) {
                    self.arrays[*array].stops = Some((ctx.at.local_ns, report));
                }
                self.tell_first(ctx);
            }
            Topic::Geometry => self.geometry(payload),
            _ => {}
        }
        self.confirm(ctx);
    }

    /// The stop that was ordered and is not confirmed yet.
    pub fn unconfirmed(&self) -> Option<StopName> {
        self.ordered.map(|ordered| ordered.name)
    }

    /// Publishes a stop with a name of its own.
    pub fn stop(&mut self, ctx: &mut Context<'_>) {
        let order = EmergencyStop { action: StopAction::Stop, ..self.order(ctx) };
        self.arrays.iter_mut().for_each(|seen| seen.hold.order(ctx.at.room_ns, &order));
        self.ordered = Some(Ordered { name: order.name(), begun_ns: ctx.at.local_ns });
        ctx.publish(Topic::Stop, encoded(&order));
    }

    /// Releases the oldest stop by its name, or all stops by time.
    pub fn rearm(&mut self, by: RearmBy, ctx: &mut Context<'_>) {
        match by {
            RearmBy::Name => {
                let oldest = self.arrays.iter().flat_map(|seen| seen.hold.stops()).min_by_key(|held| held.since_ns);
                self.release(oldest.map(|held| held.name).into_iter().collect(), ctx);
            }
            RearmBy::Time => {
                let order = EmergencyStop { action: StopAction::Rearm, ..self.order(ctx) };
                ctx.publish(Topic::Stop, encoded(&order));
            }
        }
    }

    /// Releases every stop that is held, by its name.
    pub fn rearm_all(&mut self, ctx: &mut Context<'_>) {
        let mut names: Vec<_> = self.arrays.iter().flat_map(|seen| seen.hold.stops()).map(|held| held.name).collect();
        names.sort();
        names.dedup();
        self.release(names, ctx);
    }

    /// Repeats what is due.
    pub fn wake(&mut self, ctx: &mut Context<'_>) {
        if ctx.at.local_ns < self.wake_ns {
            return;
        }
        self.wake_ns = ctx.at.local_ns + REPEAT_NS;
        self.send_rearms(ctx);
        if ctx.has(Mutation::StopNotRepeated) {
            return;
        }
        for array in 0..self.arrays.len() {
            let unreported: Vec<HeldStop> = self.arrays[array].hold.unreported().cloned().collect();
            unreported.iter().for_each(|held| self.repeat(array, held, ctx));
        }
    }

    fn release(&mut self, names: Vec<StopName>, ctx: &mut Context<'_>) {
        self.release = Some(Release { names, ends_ns: ctx.at.local_ns + REARM_NS });
        self.send_rearms(ctx);
    }

    fn send_rearms(&mut self, ctx: &mut Context<'_>) {
        let Some(release) = self.release.take().filter(|release| ctx.at.local_ns < release.ends_ns) else { return };
        let is_held =
            |name: &StopName| self.arrays.iter().any(|seen| seen.hold.stops().iter().any(|held| held.name == *name));
        for name in release.names.iter().filter(|name| is_held(name)).copied().collect::<Vec<_>>() {
            let stamp = self.stamp(1, ctx);
            let (stop_source, stop_sequence) = (name.source, name.sequence);
            let rearm = Rearm { stamp, stop_source, stop_sequence, operator: "ann".into(), reason: "test".into() };
            ctx.publish(Topic::Rearm, encoded(&rearm));
        }
        self.release = Some(release);
    }

    fn repeat(&mut self, array: usize, held: &HeldStop, ctx: &mut Context<'_>) {
        let repetition = StopRepetition {
            stamp: self.stamp(2, ctx),
            stop_source: held.name.source,
            stop_sequence: held.name.sequence,
            operator: held.operator.clone(),
            reason: held.reason.clone(),
        };
        ctx.publish(Topic::Repetition(array), encoded(&repetition));
    }

    fn order(&mut self, ctx: &Context<'_>) -> EmergencyStop {
        let stamp = self.stamp(0, ctx);
        EmergencyStop { stamp, operator: "ann".into(), reason: "test".into(), ..EmergencyStop::default() }
    }

    fn stamp(&mut self, key: usize, ctx: &Context<'_>) -> Stamp {
        self.sequences[key] += 1;
        Stamp { source: self.source, sequence: self.sequences[key], time_ns: ctx.at.room_ns }
    }

    fn telemetry(&mut self, array: usize, payload: &[u8], now: u64) {
        let Ok(report) = decode::<MirrorTelemetry>(payload) else { return };
        self.add_arrays(array + 1);
        let (seen, is_stopped) = (&mut self.arrays[array], report.state == ArrayState::Stopped);
        seen.hold.handle_state(report.stamp.source, is_stopped);
        if is_stopped && report.faults & fault::STOP == 0 {
            seen.device_stopped = Some((now, report.stamp.source));
        }
    }

    fn geometry(&mut self, payload: &[u8]) {
        let Ok(report) = decode::<RoomGeometry>(payload) else { return };
        if *self.geometry != *report.scenario {
            if let Ok(scenario) = Scenario::from_geometry_toml(&report.scenario) {
                self.announced = self.announced.max(scenario.mirrors.arrays().len());
            }
            self.geometry = report.scenario.into();
        }
        self.add_arrays(self.announced);
    }

    /// Adds arrays; stops that are held for another array are held for them too.
    fn add_arrays(&mut self, count: usize) {
        let known: Vec<HeldStop> = self.arrays.iter().flat_map(|seen| seen.hold.stops()).cloned().collect();
        let ordered = self.ordered.map(|ordered| ordered.name);
        while self.arrays.len() < count {
            let mut seen = SeenArray::default();
            let names = known.iter().map(|held| held.name).chain(ordered.filter(|_| self.arrays.is_empty()));
            for StopName { source, sequence } in names {
                let stamp = Stamp { source, sequence, time_ns: 0 };
                seen.hold.order(0, &EmergencyStop { stamp, action: StopAction::Stop, ..EmergencyStop::default() });
            }
            self.arrays.push(seen);
        }
    }

    /// Applies a report; a stop in it that was not known concerns all arrays.
    fn reported(
        &mut self,
        array: usize,
        reported: &[LatchedStopReport],
        apply: impl FnOnce(&mut StopHold) -> bool,
    ) -> bool {
        self.add_arrays(array + 1);
        let unknown = unknown_stops(reported, self.arrays.iter().map(|seen| &seen.hold));
        let is_new = apply(&mut self.arrays[array].hold);
        if is_new {
            for stop in &unknown {
                self.arrays.iter_mut().for_each(|seen| seen.hold.learn(stop));
            }
        }
        is_new
    }

    /// Tells the operator that the room is stopped, if every array has confirmed it.
    fn confirm(&mut self, ctx: &mut Context<'_>) {
        let ignores_device = ctx.has(Mutation::ToldWithoutDevice);
        for (array, seen) in self.arrays.iter().enumerate() {
            // What the page shows of one array.
            if seen.has_stopped(ctx.at.local_ns, 0, ignores_device) {
                let held = seen.hold.stops().iter().map(|held| held.name);
                held.for_each(|name| ctx.monitor.shown(ctx.now, array, name));
            }
        }
        let Some(Ordered { name, begun_ns }) = self.ordered else { return };
        let has_stopped = |seen: &SeenArray| {
            seen.has_stopped(ctx.at.local_ns, begun_ns, ignores_device)
                && seen.hold.stops().iter().any(|held| held.name == name)
        };
        if self.announced > 0 && self.arrays.len() >= self.announced && self.arrays.iter().all(has_stopped) {
            self.ordered = None;
            ctx.monitor.told(ctx.now, name);
        }
    }

    /// A deliberate bug: the first report of a stop counts.
    fn tell_first(&mut self, ctx: &mut Context<'_>) {
        let Some(Ordered { name, .. }) = self.ordered.filter(|_| ctx.has(Mutation::ToldAtFirstReport)) else { return };
        let names_it = |seen: &SeenArray| seen.stops.as_ref().is_some_and(|(_, report)| report.is_latched(name));
        if self.arrays.iter().any(names_it) {
            self.ordered = None;
            ctx.monitor.told(ctx.now, name);
        }
    }
}
