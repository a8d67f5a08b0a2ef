//! The process of an array: the production [`Station`] with its queue, a simulated device and a
//! simulated disk.

use std::collections::BTreeMap;

use heliostat_array::arrivals::{Arrival, Arrivals};
use heliostat_array::content::Content;
use heliostat_array::moment::Moment;
use heliostat_array::station::{Identity, Report, Station};
use heliostat_array::stop_record::StopRecord;
use heliostat_array::{Device, Kit};
use heliostat_channel::MirrorAngles;
use heliostat_proto::{ArrayState, MirrorCommand, decode};

use super::device::{SharedHardware, SimDevice};
use super::disk::{SharedDisk, SimDisk};
use super::{Context, Incoming, Outgoing, encoded};
use crate::mutation::Mutation;
use crate::topic::Topic;

/// The production type with a simulated device.
pub(crate) type SimStation = Station<SimDevice>;

/// A process of an array.
pub(crate) struct ArrayNode {
    array: usize,
    station: SimStation,
    disk: SimDisk,
    queue: Arrivals,
    hardware: SharedHardware,
    /// The last announcements, which answer queries.
    announced: BTreeMap<Topic, Vec<u8>>,
    /// A deliberate bug has ended the service.
    is_stuck: bool,
}

impl ArrayNode {
    /// Starts the process. `is_first` declares a start without a record safe.
    pub fn start(
        (identity, telemetry_ns): (Identity, u64),
        (hardware, disk): (&SharedHardware, &SharedDisk),
        is_first: bool,
        ctx: &mut Context<'_>,
    ) -> Self {
        let array = identity.array;
        let (is_damaged, is_full) = (disk.borrow().is_damaged, disk.borrow().full > 0);
        // An array that cannot record a stop starts stopped, too.
        let is_unknown = !is_first && (is_damaged || (is_full && !ctx.monitor.arrays[array].is_stopped()));
        ctx.monitor.arrays[array].start(ctx.at.room_ns, is_unknown);
        let (record, latch) = StopRecord::open(SimDisk(disk.clone()), is_first, ctx.at.room_ns);
        let (plan, _) = record.split();
        let kit = Kit::new(SimDevice(hardware.clone()));
        let station = Station::new(kit, (plan, latch), identity, ctx.at).with_telemetry_every(telemetry_ns);
        let (queue, hardware, disk) = (Arrivals::default(), hardware.clone(), SimDisk(disk.clone()));
        let mut node = Self { array, station, disk, queue, hardware, announced: BTreeMap::new(), is_stuck: false };
        node.wake(ctx);
        node
    }

    pub fn handle(&mut self, incoming: &Incoming, ctx: &mut Context<'_>) {
        let Incoming::Payload { topic, from, payload } = incoming else { return };
        let content = match topic {
            Topic::Command(_) => Content::Command(decode(payload)),
            Topic::Repetition(_) => Content::Repetition(decode(payload)),
            Topic::Stop => Content::Stop(decode(payload)),
            Topic::Rearm => Content::Rearm(decode(payload)),
            Topic::Query => return self.answer(*from, ctx),
            _ => return,
        };
        self.queue.push(ctx.at, content);
        self.wake(ctx);
    }

    /// Handles what has arrived, and publishes the reports that are due, as a driver does.
    pub fn wake(&mut self, ctx: &mut Context<'_>) {
        loop {
            while let Some(arrival) = self.queue.pop() {
                self.take(arrival, ctx);
                if self.station.is_report_due(ctx.at.local_ns) {
                    break;
                }
            }
            self.advance(ctx);
            while let Some(report) = self.station.poll_report(ctx.at) {
                self.publish(&report, ctx);
            }
            ctx.monitor.after_reports(self.array, ctx.now, &self.station, &self.hardware.borrow());
            match self.queue.pop() {
                Some(arrival) => self.take(arrival, ctx),
                None => return,
            }
        }
    }

    /// When it has to be woken, in local time.
    pub fn next_ns(&self) -> u64 {
        self.station.next_ns()
    }

    pub fn station(&self) -> &SimStation {
        &self.station
    }

    fn advance(&mut self, ctx: &mut Context<'_>) {
        let state = self.station.kit().array().state();
        let is_driven = matches!(state, ArrayState::Following | ArrayState::Holding);
        if ctx.has(Mutation::NotParked) && is_driven {
            return;
        }
        self.station.advance(ctx.at);
        // A failed record is in force all the same; the monitor checks what the next start does.
        if let Some(task) = self.station.poll_record(ctx.at) {
            self.station.finish_record(&task.run(&mut self.disk));
        }
        ctx.monitor.after_advance(self.array, (ctx.now, ctx.at), &self.station, &self.hardware.borrow());
    }

    fn take(&mut self, mut arrival: Arrival, ctx: &mut Context<'_>) {
        let before = ctx.monitor.before_message(self.array, &arrival, &self.station, &self.hardware.borrow());
        let is_dropped = self.is_stuck && matches!(arrival.content, Content::Command(_));
        if ctx.mutation.is_some() {
            self.mutate(&mut arrival, ctx);
        }
        let is_rearm = matches!(arrival.content, Content::Rearm(_));
        if !is_dropped {
            self.station.handle(ctx.at, arrival);
        }
        let is_released = is_rearm && self.station.kit().array().state() != ArrayState::Stopped;
        self.is_stuck |= ctx.has(Mutation::ReleasedArrayStuck) && is_released;
        ctx.monitor.after_message(self.array, before, ctx.now, &self.station, &self.hardware.borrow());
    }

    fn publish(&mut self, report: &Report, ctx: &mut Context<'_>) {
        let array = self.array;
        let (topic, payload) = match report {
            Report::Telemetry(telemetry) => (Topic::Telemetry(array), encoded(telemetry)),
            Report::Safety(safety) => (Topic::Safety(array), encoded(safety)),
            Report::Stops(stops) => (Topic::Stops(array), encoded(stops)),
            Report::Capabilities(capabilities) => (Topic::Capabilities(array), encoded(capabilities)),
            Report::Status(_) => return,
        };
        if !matches!(topic, Topic::Telemetry(_)) {
            self.announced.insert(topic, payload.clone());
        }
        ctx.publish(topic, payload);
    }

    fn answer(&self, to: usize, ctx: &mut Context<'_>) {
        for (topic, payload) in &self.announced {
            ctx.out.push(Outgoing { topic: *topic, payload: payload.clone(), to: Some(to), after_ns: 0 });
        }
    }

    fn mutate(&mut self, arrival: &mut Arrival, ctx: &Context<'_>) {
        let at = arrival.at;
        match &mut arrival.content {
            Content::Command(Ok(command)) => self.mutate_command(at, command, ctx),
            Content::Rearm(Ok(rearm)) if ctx.has(Mutation::OtherStopReleased) => {
                if let Some(stop) = self.station.kit().array().latch().stop() {
                    (rearm.stop_source, rearm.stop_sequence) = (stop.source, stop.sequence);
                }
            }
            _ => {}
        }
    }

    fn mutate_command(&mut self, at: Moment, command: &mut MirrorCommand, ctx: &Context<'_>) {
        let array = self.station.kit().array();
        let is_stopped = array.state() == ArrayState::Stopped;
        let Some(followed) = array.followed().copied() else { return };
        let is_epoch = command.epoch == followed.epoch;
        let follows = (ctx.has(Mutation::OldSequenceFollowed) && is_epoch && command.sequence < followed.sequence)
            || (ctx.has(Mutation::DuplicateExecuted) && is_epoch && command.sequence == followed.sequence)
            || (ctx.has(Mutation::LowerEpochFollowed) && command.epoch < followed.epoch);
        if follows {
            (command.epoch, command.sequence) = (followed.epoch, followed.sequence + 1);
        }
        if ctx.has(Mutation::ExpiredFollowed)
            && at.room_ns >= command.time_ns.saturating_add(u64::from(command.validity_ms) * 1_000_000)
        {
            command.time_ns = at.room_ns;
        }
        if ctx.has(Mutation::SetAfterStop) && is_stopped {
            let flat = MirrorAngles::flat(command.roll.len());
            let _ = self.station.kit_mut().device_mut().apply(at, &flat);
        }
    }
}
