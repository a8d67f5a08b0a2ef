//! A room in memory: the real kit, decision core and simulated room, with a tracker and a
//! controller that keep working while an attacker sends payloads on every key.
//!
//! After each step the room checks what must always hold. The attacker may do anything that one
//! process can do: delay, drop, repeat, invent. It does not change the memory of a process.

mod delivery;

use std::sync::OnceLock;

use heliostat_array::Kit;
use heliostat_array::moment::Moment;
use heliostat_array::refusal_counts::RefusalCounts;
use heliostat_channel::{ChannelModel, MirrorAngles};
use heliostat_core::capabilities::{Examiner, Force};
use heliostat_core::core::Controller;
use heliostat_core::policy::PolicyKind;
use heliostat_core::tenure::Tenure;
use heliostat_models::ActorSource;
use heliostat_proto::stop_hold::HeldStop;
use heliostat_proto::*;
use heliostat_room::SimulatedRoom;
use heliostat_scenario::Scenario;

use crate::bench_device::BenchDevice;
use crate::forge::{self, Genuine, example_of};
use crate::script::Script;
use crate::tally::Tally;

const MS: u64 = 1_000_000;

/// UTC at the start of every run: the time in the examples of CONTRACT.md.
const START_NS: Nanos = 1_767_323_045_678_000_000;

/// Time between two reports of the genuine tracker.
const INTERVAL_NS: u64 = 10 * MS;

/// Sources of the genuine tracker, array, operator and controller.
const TRACKER: u64 = 0x1234_5678_9abc_def0;
const ARRAY: u64 = 0x51;
const OPERATOR: u64 = 0x52;
const CONTROLLER: u64 = 0x53;

/// The smallest room: as many users and mirrors as the examples of CONTRACT.md have.
struct Setup {
    scenario: Scenario,
    model: ChannelModel,
    examiner: Examiner,
    simulated: SimulatedRoom,
}

fn setup() -> &'static Setup {
    static SETUP: OnceLock<Setup> = OnceLock::new();
    SETUP.get_or_init(|| {
        let small = ["mirrors.rows=1", "mirrors.columns=2", "users.count=1"];
        let scenario = Scenario::builtin("specular").and_then(|full| full.with_overrides(&small)).expect("valid");
        let model = scenario.channel_model().expect("valid");
        let examiner = Examiner::new(&scenario, &model, Force { small_range: true, paper_angles: false });
        let simulated = SimulatedRoom::new(&scenario, None, 1).expect("valid");
        Setup { scenario, model, examiner, simulated }
    })
}

/// The processes of one room, and their clocks.
pub struct Room {
    kit: Kit<BenchDevice>,
    controller: Controller,
    simulated: SimulatedRoom,
    refused: RefusalCounts,
    /// Monotonic time of every process.
    local_ns: u64,
    /// UTC of every process.
    room_ns: Nanos,
    /// Number of the last message of the tracker, the array and the operator.
    sequence: u64,
    /// Sequence number of the controller's last command.
    sequence_sent: u64,
    tick: u64,
    tally: Tally,
    payload: Vec<u8>,
    encoded: Vec<u8>,
}

impl Room {
    pub fn new(script: &mut Script<'_>) -> Self {
        let Setup { scenario, model, simulated, .. } = setup();
        let choice = script.byte();
        let clock = if choice & 1 == 0 { ValidityClock::SourceTime } else { ValidityClock::Arrival };
        // Most inputs use a policy that costs little, so that there is time for more of them.
        let kind = if choice & 0x30 == 0 { PolicyKind::FixedPoint } else { PolicyKind::Nearest };
        let policy = heliostat_models::build(kind, scenario, &ActorSource::Shipped).expect("it reads no file");
        let tenure = Tenure::live(CONTROLLER, INTERVAL_NS);
        let mut room = Self {
            kit: Kit::new(BenchDevice::new(clock, choice & 2 == 0)),
            controller: Controller::new(scenario, model.clone(), policy, 0).with_tenure(tenure),
            sequence_sent: 0,
            simulated: simulated.clone(),
            refused: RefusalCounts::default(),
            local_ns: 0,
            room_ns: START_NS,
            sequence: 300,
            tick: 0,
            tally: Tally::default(),
            payload: Vec::new(),
            encoded: Vec::new(),
        };
        room.pass_time(0);
        room.announce();
        room
    }

    /// Executes the choices of a script.
    pub fn run(&mut self, script: &mut Script<'_>) {
        while !script.is_empty() {
            match script.below(8) {
                0 => self.pass_time([0, 1, 9, 50, 200, 1_100, 5_000, 60_000][script.below(8)]),
                1 | 2 => self.genuine_tick(script.byte()),
                3 if script.one_in(8) => {
                    let device = self.kit.device_mut();
                    device.fails = !device.fails;
                }
                _ => self.attack(script),
            }
            if script.one_in(16) {
                self.check_announcements();
            }
        }
        self.check_announcements();
    }

    /// Delivers the payloads of a transcript, with a tick of the genuine tracker after each.
    ///
    /// A payload has three bytes before it: the number of its kind, and its length, low byte first.
    pub fn replay(&mut self, transcript: &mut Script<'_>) {
        while !transcript.is_empty() {
            let kind = Kind::from_number(transcript.byte());
            let length = usize::from(transcript.byte()) | usize::from(transcript.byte()) << 8;
            self.payload.clear();
            self.payload.extend_from_slice(transcript.take(length));
            if let Some(kind) = kind {
                self.tally.hostile += 1;
                self.deliver(kind);
            }
            self.pass_time(10);
            self.genuine_tick(0);
        }
        self.check_announcements();
    }

    /// The attacker stops, and the operator releases a stop: the room must work again.
    ///
    /// The bound is far above the timeouts of the scenario and of the contract.
    pub fn recover(&mut self) {
        self.kit.device_mut().fails = false;
        for _ in 0..600 {
            self.pass_time(100);
            if self.kit.array().state() == ArrayState::Stopped {
                self.rearm();
            }
            self.announce();
            let accepted = self.kit.array().counters().accepted;
            self.genuine_tick(0);
            if self.kit.array().counters().accepted > accepted {
                return;
            }
        }
        panic!(
            "no command is accepted within a minute after the attack: the array is {:?}, its last command {:?}, \
             the controller's tenure {:?}, refusals {:?} and {:?}",
            self.kit.array().state(),
            self.kit.array().followed(),
            self.controller.tenure(0),
            self.refused.counts(),
            self.controller.inbox().refused(),
        );
    }

    /// What was delivered so far.
    pub fn tally(&mut self) -> &Tally {
        self.tally.counters = *self.kit.array().counters();
        &self.tally
    }

    fn now(&self) -> Moment {
        Moment { local_ns: self.local_ns, room_ns: self.room_ns }
    }

    fn stamp(&mut self, source: u64) -> Stamp {
        self.sequence += 1;
        Stamp { source, sequence: self.sequence, time_ns: self.room_ns }
    }

    fn pass_time(&mut self, ms: u64) {
        self.local_ns += ms * MS;
        self.room_ns += ms * MS;
        let now = self.now();
        self.checked(|room| room.kit.advance(now));
        // Short steps are enough to find a value that breaks the world, and cost less.
        self.simulated.advance(self.local_ns.min(self.simulated_ns() + 20 * MS));
        let angles = self.simulated.angles();
        assert!(angles.roll.iter().chain(&angles.yaw).all(|angle| angle.is_finite()), "simulated {angles:?}");
        self.poll_timeout();
    }

    fn simulated_ns(&self) -> u64 {
        (self.simulated.world().time_s() * 1e9) as u64
    }

    /// The driver announces its array, as it does every second.
    fn announce(&mut self) {
        let stamp = self.stamp(ARRAY);
        encode(&self.kit.capabilities(stamp), &mut self.payload).expect("the kit's capabilities are valid");
        self.deliver(Kind::Capabilities);
        encode(&self.kit.safety(stamp), &mut self.payload).expect("the kit's safety report is valid");
        self.deliver(Kind::SafetyReport);
        encode(&self.kit.stops(stamp), &mut self.payload).expect("the kit's stop report is valid");
        self.deliver(Kind::StopReport);
        // The controller repeats what the array has not reported.
        let held: Vec<HeldStop> = self.controller.unreported_stops(0).cloned().collect();
        for HeldStop { name, operator, reason, .. } in held {
            let (stop_source, stop_sequence) = (name.source, name.sequence);
            let stamp = self.stamp(OPERATOR);
            let repetition = StopRepetition { stamp, stop_source, stop_sequence, operator, reason };
            encode(&repetition, &mut self.payload).expect("a held stop is valid");
            self.deliver(Kind::StopRepetition);
        }
    }

    /// The tracker reports, the controller decides, the array applies and reports; bits of `lost`
    /// drop messages.
    fn genuine_tick(&mut self, lost: u8) {
        self.tick += 1;
        if lost & 1 == 0 {
            let channel = ChannelReport { stamp: self.stamp(TRACKER), tick: self.tick, ..example_of() };
            encode(&channel, &mut self.payload).expect("valid");
            self.deliver(Kind::ChannelReport);
        }
        if lost & 2 == 0 {
            let users = UserReport { stamp: self.stamp(TRACKER), tick: self.tick, ..example_of() };
            encode(&users, &mut self.payload).expect("valid");
            self.deliver(Kind::UserReport);
        }
        if lost & 4 == 0 {
            let (now, stamp) = (self.now(), self.stamp(ARRAY));
            let telemetry = self.kit.telemetry(now, stamp);
            encode(&telemetry, &mut self.payload).expect("the kit's telemetry is valid");
            self.deliver(Kind::MirrorTelemetry);
        }
    }

    /// The operator releases the stop that the array reports.
    fn rearm(&mut self) {
        let stamp = self.stamp(OPERATOR);
        let (stop_source, stop_sequence) = self.latched_stop();
        let order = Rearm { stamp, stop_source, stop_sequence, ..example_of() };
        encode(&order, &mut self.payload).expect("valid");
        self.deliver(Kind::Rearm);
    }

    /// Source and sequence of the stop that the array reports.
    fn latched_stop(&self) -> (u64, u64) {
        let SafetyReport { stop_source, stop_sequence, .. } = self.kit.safety(Stamp::default());
        (stop_source, stop_sequence)
    }

    fn attack(&mut self, script: &mut Script<'_>) {
        let kind = Kind::ALL[script.below(Kind::ALL.len())];
        let genuine = Genuine {
            source: if matches!(
                kind,
                Kind::MirrorTelemetry | Kind::Capabilities | Kind::SafetyReport | Kind::StopReport
            ) {
                ARRAY
            } else {
                TRACKER
            },
            sequence: if kind == Kind::MirrorCommand { self.sequence_sent } else { self.sequence } + 1,
            time_ns: self.room_ns,
            epoch: self.controller.epoch(),
            tick: self.tick,
            stop: self.latched_stop(),
        };
        let mut payload = std::mem::take(&mut self.payload);
        forge::write(script, kind, &genuine, &mut payload);
        self.payload = payload;
        self.tally.hostile += 1;
        self.deliver(kind);
    }

    /// Executes a step of the kit; a stopped array must not move in it.
    fn checked(&mut self, step: impl FnOnce(&mut Self)) {
        let state = |room: &Self| (room.kit.array().state(), room.kit.device().moves);
        let (before, moves) = state(self);
        step(self);
        let (after, moves_after) = state(self);
        if after == ArrayState::Stopped {
            let device = self.kit.device();
            assert!(before != ArrayState::Stopped || moves == moves_after, "a stopped array moved");
            assert!(!device.is_connected || device.moves_since_stop == 0, "the device was not stopped");
        }
        let MirrorAngles { roll, yaw } = self.kit.array().target();
        assert!(roll.iter().chain(yaw).all(|angle| angle.is_finite()), "target {roll:?} {yaw:?}");
    }

    /// Whatever arrived, the array can report its state.
    fn check_announcements(&mut self) {
        let (now, stamp) = (self.now(), self.stamp(ARRAY));
        let telemetry = self.kit.telemetry(now, stamp);
        encode(&telemetry, &mut self.encoded).expect("the kit's telemetry is valid");
        encode(&self.kit.capabilities(stamp), &mut self.encoded).expect("the kit's capabilities are valid");
        encode(&self.kit.safety(stamp), &mut self.encoded).expect("the kit's safety report is valid");
        encode(&self.simulated.telemetry(0, stamp), &mut self.encoded).expect("the simulated telemetry is valid");
    }
}
