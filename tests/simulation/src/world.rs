//! One run: the hosts, the links and the queue of events in virtual time.

mod backlog;
mod calibrations;
mod connections;
mod faults;
mod host;
mod pauses;
mod presence;
mod verdicts;

use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap, VecDeque};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::rc::Rc;

use heliostat_array::station::Identity;
use rand::RngExt;

use crate::clock::{Clock, MS, TrueNs};
use crate::hosts::adapter::Standby;
use crate::hosts::array::ArrayNode;
use crate::hosts::attacker::Attacker;
use crate::hosts::controller::ControllerNode;
use crate::hosts::device::{Hardware, SharedHardware};
use crate::hosts::disk::{Disk, SharedDisk};
use crate::hosts::operator::Operator;
use crate::hosts::tracker::Tracker;
use crate::hosts::{Context, Incoming, Outgoing};
use crate::monitor::Monitor;
use crate::mutation::Mutation;
use crate::network::{Carried, Network};
use crate::plan::{Fault, Role, Setup, Timed, last_end_ns};
use crate::random::{Purpose, Rng, stream};
use crate::room::Room;
use crate::trace::Trace;
use crate::violation::Violation;
use backlog::Batches;
use calibrations::Visit;
use host::{Host, Process};
use verdicts::Loss;

/// Time between the starts of two controllers in ns.
const START_NS: u64 = 400 * MS;

/// Time between two audits in ns.
const AUDIT_NS: u64 = 20 * MS;

/// The operator releases all known stops so long after the last fault, in ns, and again later. A connection carries
/// messages again up to 2.05 s after the fault (`world/connections.rs`), and an array reports its stops each second.
const REARM_ALL_NS: [u64; 4] = [300 * MS, 1300 * MS, 2300 * MS, 3300 * MS];

/// How a run ended.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The first violation, if there is one.
    pub violation: Option<Violation>,
    /// Hash of every message that was delivered, with its time.
    pub hash: u64,
    /// When each array followed a command, in ns of true time.
    pub accepted: Vec<Vec<u64>>,
    /// The names of the events, degraded modes and refusals that occurred.
    pub occurred: BTreeSet<String>,
    /// The last events, where they are traced.
    pub trace: Vec<String>,
}

#[derive(Debug)]
enum Event {
    Start(usize),
    Deliver {
        to: usize,
        generation: u64,
        incoming: Incoming,
    },
    Wake(usize),
    Resume(usize),
    Begin(usize),
    End(usize),
    Presence,
    /// The connections of a partition that has ended carry messages again.
    Connected(usize),
    Pause(usize),
    Audit,
    RearmAll,
}

struct Scheduled {
    at: TrueNs,
    order: u64,
    event: Event,
}

impl PartialEq for Scheduled {
    fn eq(&self, other: &Self) -> bool {
        (self.at, self.order) == (other.at, other.order)
    }
}

impl Eq for Scheduled {}

impl PartialOrd for Scheduled {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Scheduled {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        (self.at, self.order).cmp(&(other.at, other.order))
    }
}

/// The state of a run.
pub(crate) struct World {
    setup: Setup,
    faults: Vec<Timed>,
    mutation: Option<Mutation>,
    room: Room,
    hosts: Vec<Host>,
    hardware: Vec<SharedHardware>,
    disks: Vec<SharedDisk>,
    network: Network,
    /// Messages that wait for the end of a partition.
    held: Vec<(usize, usize, u64, Incoming)>,
    monitor: Monitor,
    losses: Vec<Loss>,
    visits: Vec<Visit>,
    occurred: BTreeSet<String>,
    queue: BinaryHeap<Reverse<Scheduled>>,
    order: u64,
    now: TrueNs,
    sources: Rng,
    disk_rng: Rng,
    threads: Rng,
    connections: Rng,
    pauses: Rng,
    hash: DefaultHasher,
    trace: Trace,
}

/// Runs a plan to its end, or to the first violation.
pub(crate) fn run(setup: &Setup, faults: &[Timed], mutation: Option<Mutation>, is_traced: bool) -> Outcome {
    let mut world = World::new(setup, faults, mutation, is_traced);
    world.run();
    Outcome {
        violation: world.monitor.violation,
        hash: world.hash.finish(),
        accepted: world.monitor.arrays.into_iter().map(|array| array.accepted_at).collect(),
        occurred: world.occurred,
        trace: world.trace.lines(),
    }
}

impl World {
    fn new(setup: &Setup, faults: &[Timed], mutation: Option<Mutation>, is_traced: bool) -> Self {
        let (mut roles, room) = (setup.roles(), Room::of(setup));
        if faults.iter().any(|timed| matches!(timed.fault, Fault::Calibrate { .. })) {
            roles.push(Role::Calibration);
        }
        let mut sources = stream(setup.seed, Purpose::Sources);
        let count = roles.len();
        let host = |role: &Role| Host {
            role: *role,
            clock: Clock::new(sources.random_range(-2..=2) * MS as i64, sources.random_range(-50..=50)),
            process: None,
            generation: 0,
            source: 0,
            down: 0,
            frozen: 0,
            ends_by: None,
            busy_until: 0,
            waiting: VecDeque::new(),
            wake_at: None,
            slow_ms: Vec::new(),
            sees: vec![None; count],
            lost_since: vec![None; count],
        };
        let hosts = roles.iter().map(host).collect();
        Self {
            setup: setup.clone(),
            faults: faults.to_vec(),
            mutation,
            hosts,
            hardware: (0..setup.arrays).map(|_| Hardware::new(setup.counts_from_arrival, mutation)).collect(),
            disks: (0..setup.arrays).map(|_| Disk::new(mutation)).collect(),
            network: Network::new(setup.seed, &roles),
            held: Vec::new(),
            monitor: Monitor::new(setup, room.slew_rad_s),
            losses: Vec::new(),
            visits: Vec::new(),
            occurred: BTreeSet::new(),
            room,
            queue: BinaryHeap::new(),
            order: 0,
            now: 0,
            sources,
            disk_rng: stream(setup.seed, Purpose::Disk),
            threads: stream(setup.seed, Purpose::Threads),
            connections: stream(setup.seed, Purpose::Connections),
            pauses: stream(setup.seed, Purpose::Pauses),
            hash: DefaultHasher::new(),
            trace: Trace::new(is_traced),
        }
    }

    fn run(&mut self) {
        for host in 0..self.hosts.len() {
            let at = if let Role::Controller(index) = self.hosts[host].role { index as u64 * START_NS } else { 0 };
            self.schedule(at, Event::Start(host));
        }
        for index in 0..self.faults.len() {
            self.schedule(self.faults[index].at_ms * MS, Event::Begin(index));
            self.schedule(self.faults[index].end_ms() * MS, Event::End(index));
        }
        let last_ns = last_end_ns(&self.faults);
        if self.setup.rearms_at_end {
            REARM_ALL_NS.iter().for_each(|after_ns| self.schedule(last_ns + after_ns, Event::RearmAll));
        }
        self.schedule(AUDIT_NS, Event::Audit);
        if self.setup.is_busy {
            self.begin_pauses();
        }
        let end = verdicts::end_ns(last_ns);
        while let Some(Reverse(Scheduled { at, event, .. })) = self.queue.pop() {
            if at > end || self.monitor.violation.is_some() {
                break;
            }
            self.now = at;
            self.handle(event);
        }
        self.judge(last_ns);
    }

    fn schedule(&mut self, at: TrueNs, event: Event) {
        self.order += 1;
        self.queue.push(Reverse(Scheduled { at, order: self.order, event }));
    }

    fn handle(&mut self, event: Event) {
        match event {
            Event::Start(host) => self.start(host),
            Event::Deliver { to, generation, incoming } => {
                if self.hosts[to].generation == generation && self.hosts[to].process.is_some() {
                    self.hosts[to].waiting.push_back(incoming);
                    self.drain(to);
                }
            }
            Event::Wake(host) => {
                if self.hosts[host].wake_at == Some(self.now) {
                    self.hosts[host].wake_at = None;
                    self.wake(host);
                }
            }
            Event::Resume(host) => {
                self.drain(host);
                self.wake(host);
            }
            Event::Begin(index) => self.begin(index),
            Event::End(index) => self.end(index),
            Event::Presence => self.update_presence(),
            Event::Connected(index) => self.connect(&self.faults[index].fault.clone()),
            Event::Pause(host) => self.pause(host),
            Event::Audit => {
                self.audit();
                self.end_processes();
            }
            Event::RearmAll => self.operate(|operator, ctx| operator.rearm_all(ctx)),
        }
    }

    /// Starts a process, unless a fault keeps it down.
    fn start(&mut self, host: usize) {
        if self.hosts[host].down > 0 || self.hosts[host].process.is_some() {
            return;
        }
        let role = self.hosts[host].role;
        if role == Role::Calibration {
            return;
        }
        let is_first = self.hosts[host].generation == 0;
        let source = self.new_source(host, role);
        let slow_ms = self.hosts[host].slow_ms.clone();
        let (room, setup) = (self.room.clone(), self.setup.clone());
        let shared = match role {
            Role::Array(array) => Some((self.hardware[array].clone(), self.disks[array].clone())),
            _ => None,
        };
        let rng = |purpose| stream(setup.seed ^ source, purpose);
        let is_replay = matches!(self.mutation, Some(Mutation::InputNotRecorded | Mutation::StateOutdated));
        let is_recorded = setup.seed.is_multiple_of(3) || is_replay;
        self.hosts[host].generation += 1;
        self.dispatch(host, |process, ctx| {
            *process = Some(match (role, &shared) {
                (Role::Array(array), Some((hardware, disk))) => {
                    let identity = Identity { source, array, software: "simulation".into() };
                    let telemetry_ns = 1_000_000_000 / setup.telemetry_hz;
                    let node = ArrayNode::start((identity, telemetry_ns), (hardware, disk), is_first, ctx);
                    Process::Array(Box::new(node))
                }
                (Role::Controller(index), _) => {
                    let rank = setup.has_ranks.then_some(index.max(1) as u8);
                    let standby = Standby { is_reserve: setup.is_reserve && index > 0, rank };
                    let mut node = ControllerNode::start(&room, source, standby, is_recorded, ctx);
                    slow_ms.iter().for_each(|ms| node.begin_slow(*ms));
                    Process::Controller(Box::new(node))
                }
                (Role::Operator, _) => Process::Operator(Box::new(Operator::start(source, ctx))),
                (Role::Attacker, _) => Process::Attacker(Box::new(Attacker::start(source, rng(Purpose::Attacks), ctx))),
                _ => {
                    let rng = rng(Purpose::Users);
                    let tracker = Tracker::start(source, room.interval_ns, &setup, rng, ctx);
                    Process::Tracker(Box::new(tracker))
                }
            });
        });
        self.update_presence();
    }

    /// A random id; those of controllers differ in their remainder, as different epochs require.
    fn new_source(&mut self, host: usize, role: Role) -> u64 {
        let source: u64 = self.sources.random_range(1 << 20..u64::MAX);
        let starts = self.hosts[host].generation;
        let source = match role {
            Role::Controller(index) => source - source % 1024 + 100 * index as u64 + starts % 100,
            Role::Calibration => source - source % 1024 + 900 + starts % 100,
            _ => source,
        };
        self.hosts[host].source = source;
        source
    }

    /// Passes what waits to a process, until it is busy.
    ///
    /// A controller decides at once for what arrives alone. Behind a backlog two threads share the work: one
    /// receives, and the other one decides for the newest of the reports that it finds in the receive queue.
    /// How many these are is a matter of the scheduler.
    fn drain(&mut self, host: usize) {
        let backlog = self.hosts[host].waiting.len();
        let mut batches = Batches::new((backlog > 1).then_some(&mut self.threads));
        while self.is_running(host)
            && let Some(incoming) = self.hosts[host].waiting.pop_front()
        {
            let is_last = batches.is_last(&mut self.threads) || self.hosts[host].waiting.is_empty();
            if let Incoming::Payload { topic, payload, .. } = &incoming {
                (self.now, host, topic, payload).hash(&mut self.hash);
            }
            let from = match &incoming {
                Incoming::Payload { from, .. } => Some(self.hosts[*from].role),
                Incoming::Presence { .. } => None,
            };
            self.trace.incoming(self.now, (self.hosts[host].role, from), &incoming);
            self.dispatch(host, |process, ctx| match process {
                Some(Process::Array(node)) => node.handle(&incoming, ctx),
                Some(Process::Controller(node)) => node.handle(&incoming, is_last, ctx),
                Some(Process::Operator(node)) => node.handle(&incoming, ctx),
                Some(Process::Attacker(node)) => node.handle(&incoming, ctx),
                Some(Process::Calibration(node)) => node.handle(&incoming, ctx),
                Some(Process::Tracker(_)) | None => {}
            });
        }
    }

    fn wake(&mut self, host: usize) {
        if self.is_running(host) {
            self.dispatch(host, |process, ctx| match process {
                Some(Process::Tracker(node)) => node.wake(ctx),
                Some(Process::Array(node)) => node.wake(ctx),
                Some(Process::Controller(node)) => node.wake(ctx),
                Some(Process::Operator(node)) => node.wake(ctx),
                Some(Process::Attacker(node)) => node.wake(ctx),
                Some(Process::Calibration(node)) => node.wake(ctx),
                None => {}
            });
        }
    }

    fn is_running(&self, host: usize) -> bool {
        let host = &self.hosts[host];
        host.process.is_some() && host.frozen == 0 && host.busy_until <= self.now
    }

    /// Lets a process act now; then publishes what it has, and schedules its next step.
    fn dispatch(&mut self, host: usize, act: impl FnOnce(&mut Option<Process>, &mut Context<'_>)) {
        let had_token = self.hosts[host].has_token();
        let Host { process, clock, .. } = &mut self.hosts[host];
        let mut ctx = Context {
            now: self.now,
            at: clock.at(self.now),
            monitor: &mut self.monitor,
            mutation: self.mutation,
            out: Vec::new(),
            busy_ns: 0,
        };
        act(process, &mut ctx);
        let Context { out, busy_ns, .. } = ctx;
        if busy_ns > 0 {
            self.hosts[host].busy_until = self.now + busy_ns;
            self.schedule(self.now + busy_ns, Event::Resume(host));
        }
        out.into_iter().for_each(|outgoing| self.send(host, outgoing));
        self.schedule_wake(host);
        if self.hosts[host].role == Role::Calibration {
            self.note_lead(host, had_token);
        }
    }

    fn send(&mut self, from: usize, Outgoing { topic, payload, to, after_ns }: Outgoing) {
        let payload: Rc<[u8]> = payload.into();
        for host in 0..self.hosts.len() {
            let is_addressed = to.map_or_else(|| topic.is_for(self.hosts[host].role), |to| to == host);
            if host == from || !is_addressed {
                continue;
            }
            let generation = self.hosts[host].generation;
            let incoming = Incoming::Payload { topic, from, payload: payload.clone() };
            match self.network.carry(self.now + after_ns, from, host) {
                Carried::Lost => {}
                Carried::Held => self.held.push((from, host, generation, incoming)),
                Carried::At(times) => {
                    for at in times {
                        self.schedule(at, Event::Deliver { to: host, generation, incoming: incoming.clone() });
                    }
                }
            }
        }
    }

    /// Schedules the next step of a process.
    fn schedule_wake(&mut self, host: usize) {
        let Host { process, clock, wake_at, .. } = &self.hosts[host];
        let next_ns = match process {
            Some(Process::Tracker(node)) => Some(node.next_ns()),
            Some(Process::Array(node)) => Some(node.next_ns()),
            Some(Process::Controller(node)) => Some(node.adapter().next_ns()),
            Some(Process::Operator(node)) => Some(node.next_ns()),
            Some(Process::Attacker(node)) => node.next_ns(),
            Some(Process::Calibration(node)) => node.next_ns(),
            None => None,
        };
        let Some(next_ns) = next_ns else { return };
        // A deliberate bug can leave a step undone.
        let at = clock.when(next_ns).max(self.now + MS / 10);
        if wake_at.is_none_or(|known| at < known) {
            self.hosts[host].wake_at = Some(at);
            self.schedule(at, Event::Wake(host));
        }
    }

    fn audit(&mut self) {
        for host in 0..self.hosts.len() {
            if !self.is_running(host) {
                continue;
            }
            if let (Role::Array(array), Some(Process::Array(node))) = (self.hosts[host].role, &self.hosts[host].process)
            {
                let at = self.hosts[host].clock.at(self.now);
                self.monitor.audit(array, self.now, at, node.station());
            }
        }
        self.schedule(self.now + AUDIT_NS, Event::Audit);
    }

    /// Lets the operator act, if it runs.
    fn operate(&mut self, act: impl FnOnce(&mut Operator, &mut Context<'_>)) {
        let host = self.number(Role::Operator);
        if self.is_running(host) {
            self.dispatch(host, |process, ctx| {
                if let Some(Process::Operator(operator)) = process {
                    act(operator, ctx);
                }
            });
        }
    }

    /// Notes what has occurred in a process that ends.
    fn note_occurred(&mut self, process: &Process) {
        match process {
            Process::Array(node) => self.occurred.extend(node.station().refused().counts().keys().cloned()),
            Process::Controller(node) => self.occurred.extend(node.adapter().occurred()),
            Process::Calibration(node) => self.occurred.extend(node.occurred()),
            _ => {}
        }
    }

    fn number(&self, role: Role) -> usize {
        self.hosts.iter().position(|host| host.role == role).unwrap_or_default()
    }
}
