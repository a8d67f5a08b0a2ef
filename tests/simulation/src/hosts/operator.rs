//! The operator: stops and re-arms, and is told "stopped" by the rule of the page and the command line.

use std::rc::Rc;
use std::time::Duration;

use heliostat_proto::reported_stops::{ReportedStops, RoomStop, Standing};
use heliostat_proto::stop_hold::HeldStop;
use heliostat_proto::{
    EmergencyStop, MirrorTelemetry, Rearm, RoomGeometry, SafetyReport, Stamp, StopAction, StopName, StopRepetition,
    StopReport, decode,
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

/// A stop that was ordered and not confirmed yet.
struct Ordered {
    order: EmergencyStop,
    begun: Duration,
}

/// Names that are to be released, until a local time.
struct Release {
    names: Vec<StopName>,
    ends_ns: u64,
}

/// A process of an operator.
pub(crate) struct Operator {
    source: u64,
    seen: ReportedStops,
    /// The geometry that was read last.
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
            seen: ReportedStops::default(),
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
        let now = Duration::from_nanos(ctx.at.local_ns);
        match topic {
            Topic::Telemetry(array) => {
                if let Ok(report) = decode::<MirrorTelemetry>(payload) {
                    self.seen.handle_telemetry(now, *array, &report);
                }
            }
            Topic::Safety(array) => {
                if let Ok(report) = decode::<SafetyReport>(payload) {
                    self.seen.handle_safety(now, *array, &report);
                }
            }
            Topic::Stops(array) => {
                if let Ok(report) = decode::<StopReport>(payload) {
                    self.tell_first(&report, ctx);
                    let device_stopped = report.device_stopped || ctx.has(Mutation::ToldWithoutDevice);
                    self.seen.handle_stops(now, *array, StopReport { device_stopped, ..report });
                }
            }
            Topic::Geometry => self.geometry(now, payload),
            _ => {}
        }
        self.confirm(ctx);
    }

    /// The stop that was ordered and is not confirmed yet.
    pub fn unconfirmed(&self) -> Option<StopName> {
        self.ordered.as_ref().map(|ordered| ordered.order.name())
    }

    /// Publishes a stop with a name of its own.
    pub fn stop(&mut self, ctx: &mut Context<'_>) {
        let order = EmergencyStop { action: StopAction::Stop, ..self.order(ctx) };
        let begun = Duration::from_nanos(ctx.at.local_ns);
        self.seen.order(begun, &order);
        ctx.publish(Topic::Stop, encoded(&order));
        self.ordered = Some(Ordered { order, begun });
    }

    /// Releases the oldest stop by its name, or all stops by time.
    pub fn rearm(&mut self, by: RearmBy, ctx: &mut Context<'_>) {
        match by {
            RearmBy::Name => {
                let oldest = self.seen.stops().into_iter().min_by_key(|stop| stop.known);
                self.release(oldest.map(|stop| stop.name).into_iter().collect(), ctx);
            }
            RearmBy::Time => {
                let order = EmergencyStop { action: StopAction::Rearm, ..self.order(ctx) };
                ctx.publish(Topic::Stop, encoded(&order));
            }
        }
    }

    /// Releases every stop that is held, by its name.
    pub fn rearm_all(&mut self, ctx: &mut Context<'_>) {
        let names = self.seen.stops().into_iter().map(|stop| stop.name).collect();
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
        let now = Duration::from_nanos(ctx.at.local_ns);
        for (array, held, _) in self.seen.unreported(now) {
            self.repeat(array, &held, ctx);
        }
    }

    fn release(&mut self, names: Vec<StopName>, ctx: &mut Context<'_>) {
        self.release = Some(Release { names, ends_ns: ctx.at.local_ns + REARM_NS });
        self.send_rearms(ctx);
    }

    fn send_rearms(&mut self, ctx: &mut Context<'_>) {
        let Some(release) = self.release.take().filter(|release| ctx.at.local_ns < release.ends_ns) else { return };
        let held: Vec<StopName> = self.seen.stops().into_iter().map(|stop| stop.name).collect();
        for name in release.names.iter().filter(|name| held.contains(name)).copied().collect::<Vec<_>>() {
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

    fn geometry(&mut self, now: Duration, payload: &[u8]) {
        let Ok(report) = decode::<RoomGeometry>(payload) else { return };
        if *self.geometry != *report.scenario {
            if let Ok(scenario) = Scenario::from_geometry_toml(&report.scenario) {
                self.seen.announce(now, scenario.mirrors.arrays().len());
            }
            self.geometry = report.scenario.into();
        }
    }

    /// Tells the operator what the page shows of each array, and that the room is stopped.
    fn confirm(&mut self, ctx: &mut Context<'_>) {
        let now = Duration::from_nanos(ctx.at.local_ns);
        let stops = self.seen.stops();
        if stops.is_empty() {
            return;
        }
        for (array, standing) in self.seen.standings(now, None) {
            let is_held = |stop: &&RoomStop| standing == Standing::Stopped && stop.arrays.contains(&array);
            stops.iter().filter(is_held).for_each(|stop| ctx.monitor.shown(ctx.now, array, stop.name));
        }
        let Some(Ordered { order, begun }) = &self.ordered else { return };
        let name = order.name();
        if self.seen.has_geometry() && self.seen.has_stopped(name, now, *begun) {
            self.ordered = None;
            ctx.monitor.told(ctx.now, name);
        }
    }

    /// A deliberate bug: the first report of a stop counts.
    fn tell_first(&mut self, report: &StopReport, ctx: &mut Context<'_>) {
        let ordered = self.ordered.as_ref().filter(|_| ctx.has(Mutation::ToldAtFirstReport));
        let name = ordered.map(|ordered| ordered.order.name());
        if let Some(name) = name.filter(|name| report.is_latched(*name)) {
            self.ordered = None;
            ctx.monitor.told(ctx.now, name);
        }
    }
}
