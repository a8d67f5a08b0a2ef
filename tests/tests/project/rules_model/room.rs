//! The states of the modelled room, and what each event does.

use std::collections::BTreeMap;
use std::hash::{Hash, Hasher};

use heliostat_array::latch::Latch;
use heliostat_array::moment::Moment;
use heliostat_core::tenure::{Evidence, Tenure};
use heliostat_proto::*;

use super::events::{Attack, Budgets, Fate, Packet};
use super::model::Model;
use super::parts::{COMMAND, Controller, Driver, Hardware, ROUND_NS, instant};

/// Rounds after which a single controller must be obeyed: half a minute.
const QUIET_ROUNDS: u32 = 60;

/// A state of the room.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    pub round: u32,
    pub left: Budgets,
    pub driver: Option<Driver>,
    /// The mirror while the driver is down, and the record of the latch.
    hardware: Hardware,
    record: Latch,
    pub controllers: [Option<Controller>; 2],
    pub held: Option<Packet>,
    /// Starts of controllers so far, and of the driver.
    started: u64,
    driver_starts: u64,
    /// The angle of the mirror since a stop that no operator has released.
    pub stopped_at: Option<u64>,
    /// The controller that was obeyed in each epoch.
    pub obeyed: BTreeMap<u64, u64>,
    pub has_two_leaders: bool,
}

impl Hash for State {
    fn hash<H: Hasher>(&self, state: &mut H) {
        (self.round, self.left, &self.driver, self.hardware.roll.to_bits(), &self.record).hash(state);
        // The text of a packet shows all of it; few states have one.
        (&self.controllers, self.held.as_ref().map(|packet| format!("{packet:?}"))).hash(state);
        (self.started, self.driver_starts, self.stopped_at, &self.obeyed, self.has_two_leaders).hash(state);
    }
}

impl State {
    /// A running array and two controllers.
    pub fn first(model: &Model) -> Self {
        let mut state = State {
            round: 0,
            left: model.budgets,
            driver: None,
            hardware: Hardware { roll: 0.0 },
            record: Latch::default(),
            controllers: [None, None],
            held: None,
            started: 0,
            driver_starts: 0,
            stopped_at: None,
            obeyed: BTreeMap::new(),
            has_two_leaders: false,
        };
        state.start_array(model);
        state.start(model, 0, 0);
        state.start(model, 1, 0);
        state
    }

    pub fn now(&self) -> Moment {
        instant(self.round)
    }

    pub fn roll(&self) -> u64 {
        self.driver.as_ref().map_or(&self.hardware, |driver| driver.kit.device()).roll.to_bits()
    }

    /// Executes a step of the driver, and keeps the record as the driver does.
    fn drive(&mut self, step: impl FnOnce(&mut Driver)) {
        if let Some(driver) = &mut self.driver {
            step(driver);
            self.record.clone_from(driver.kit.array().latch());
        }
    }

    pub fn arrive(&mut self, packet: Packet) {
        let now = self.now();
        match packet {
            Packet::Command(source, command) => {
                let mut is_accepted = false;
                self.drive(|driver| is_accepted = driver.kit.handle_command(now, &command).is_ok());
                if is_accepted && source != 0 {
                    self.has_two_leaders |= *self.obeyed.entry(command.epoch).or_insert(source) != source;
                }
            }
            Packet::Telemetry(place, evidence) => {
                if let Some(controller) = &mut self.controllers[place] {
                    controller.handle_telemetry(now, evidence);
                }
            }
            Packet::Stop(order) => self.order_stop(&order),
        }
    }

    pub fn order_stop(&mut self, order: &EmergencyStop) {
        let now = self.now();
        let mut is_released = false;
        self.drive(|driver| {
            let is_applied = driver.kit.handle_stop(now, order).is_ok();
            let is_free = driver.kit.array().state() != ArrayState::Stopped;
            is_released = is_applied && is_free && order.action == StopAction::Rearm;
        });
        for controller in self.controllers.iter_mut().flatten() {
            controller.stop.order(now.room_ns, order);
        }
        self.note_order(order.action == StopAction::Stop, is_released);
    }

    pub fn order_rearm(&mut self, order: &Rearm) {
        let now = self.now();
        let mut is_released = false;
        self.drive(|driver| {
            let is_applied = driver.kit.handle_rearm(now, order).is_ok();
            is_released = is_applied && driver.kit.array().state() != ArrayState::Stopped;
        });
        self.note_order(false, is_released);
    }

    fn note_order(&mut self, is_stop: bool, is_released: bool) {
        if is_released {
            self.stopped_at = None;
        } else if is_stop && self.driver.is_some() {
            self.stopped_at = Some(self.roll());
        }
    }

    /// The messages of a round, in their order: commands, then telemetry.
    pub fn round(&mut self, fate: Fate) {
        self.round += 1;
        let now = self.now();
        self.drive(|driver| driver.kit.advance(now));
        let answers = self.controllers.iter_mut().flatten();
        let answers = answers.filter_map(|controller| Some((controller.source, controller.handle_report(now)?)));
        let commands: Vec<Packet> = answers.map(|(source, command)| Packet::Command(source, command)).collect();
        let count = commands.len();
        for (index, packet) in commands.into_iter().enumerate() {
            self.meet(fate, index, packet);
        }
        let Some(driver) = &mut self.driver else { return };
        let evidence = driver.evidence();
        let stamp = Stamp { source: driver.source, sequence: u64::from(self.round), time_ns: now.room_ns };
        let (safety, stops) = (driver.kit.safety(stamp), driver.kit.stops(stamp));
        for place in 0..2 {
            self.meet(fate, count + place, Packet::Telemetry(place, evidence));
            if let Some(controller) = &mut self.controllers[place] {
                controller.stop.handle_stops(&stops);
                controller.tenure.handle_announced_epoch(safety.epoch);
            }
        }
        self.repeat_stops();
    }

    /// Each controller repeats the stops that the array has not reported.
    fn repeat_stops(&mut self) {
        let now = self.now();
        let held = self.controllers.iter().flatten().flat_map(|controller| controller.stop.unreported());
        let names: Vec<StopName> = held.map(|held| held.name).collect();
        for StopName { source, sequence } in names {
            let order = StopRepetition { stop_source: source, stop_sequence: sequence, ..StopRepetition::default() };
            let mut is_latched = false;
            self.drive(|driver| {
                driver.kit.handle_repetition(now, &order);
                is_latched = driver.kit.array().state() == ArrayState::Stopped;
            });
            if is_latched {
                self.stopped_at.get_or_insert(self.roll());
            }
        }
    }

    fn meet(&mut self, fate: Fate, index: usize, packet: Packet) {
        match fate {
            Fate::Lost(lost) if lost == index => {}
            Fate::Held(held) if held == index => self.held = Some(packet),
            _ => self.arrive(packet),
        }
    }

    pub fn start(&mut self, model: &Model, place: usize, ahead_ns: u64) {
        self.started += 1;
        let source = self.started;
        let slot = if model.shares_epochs { 1 } else { source };
        let tenure = if model.keeps_epoch {
            Tenure::lockstep(self.now().room_ns / 1_000_000 + slot)
        } else {
            Tenure::live(slot, ROUND_NS)
        };
        self.controllers[place] = Some(Controller::start(source, tenure, ahead_ns));
    }

    pub fn crash_array(&mut self) {
        if let Some(driver) = self.driver.take() {
            self.hardware = driver.kit.device().clone();
        }
    }

    pub fn start_array(&mut self, model: &Model) {
        let latch = if model.forgets_latch { Latch::default() } else { self.record.clone() };
        self.driver_starts += 1;
        self.driver = Some(Driver::start(self.now(), self.hardware.clone(), &latch, self.driver_starts));
    }

    /// The order that releases the stop in force.
    pub fn named_rearm(&self) -> Option<Rearm> {
        let safety = self.driver.as_ref()?.kit.safety(Stamp::default());
        let SafetyReport { stopped, stop_source, stop_sequence, .. } = safety;
        stopped.then(|| Rearm { stop_source, stop_sequence, ..Rearm::default() })
    }

    pub fn attack(&mut self, attack: Attack) {
        let Some(driver) = &self.driver else { return };
        let (now, evidence) = (self.now(), driver.evidence());
        let bounds = driver.kit.array().limits().bounds;
        let (utc_ms, followed) = (now.room_ns / 1_000_000, evidence.epoch);
        let angles = MirrorCommand { time_ns: now.room_ns, roll: vec![0.4], yaw: vec![0.0], ..COMMAND };
        let command = |epoch, sequence| MirrorCommand { epoch, sequence, ..angles.clone() };
        let leading = utc_ms.max(followed) + bounds.epoch_lead_max;
        let sent = match attack {
            Attack::LastEpoch => command(u64::MAX, 1),
            Attack::LeadingEpoch => command(leading, bounds.sequence_step_max),
            Attack::LastSequence => command(followed.max(1), u64::MAX),
            Attack::LeadingSequence => command(followed.max(1), evidence.applied_sequence + bounds.sequence_step_max),
            Attack::LongValidity => MirrorCommand { validity_ms: u32::MAX, ..command(followed + 1, 1) },
            Attack::TelemetryOfLastEpoch => return self.forge(|_| Evidence { epoch: u64::MAX, ..evidence }),
            Attack::TelemetryOfLastSequence => {
                return self.forge(|epoch| Evidence { epoch, applied_sequence: u64::MAX, ..evidence });
            }
            Attack::TelemetryOfStop => return self.forge(|_| Evidence { stopped: true, ..evidence }),
            Attack::FutureStop => {
                let stamp = Stamp { source: 66, sequence: 1, time_ns: u64::MAX };
                return self.arrive(Packet::Stop(EmergencyStop { stamp, ..EmergencyStop::default() }));
            }
        };
        self.arrive(Packet::Command(0, sent));
    }

    /// Telemetry of an attacker reaches both controllers; it depends on their epochs.
    fn forge(&mut self, evidence: impl Fn(u64) -> Evidence) {
        let now = self.now();
        for controller in self.controllers.iter_mut().flatten() {
            let evidence = evidence(controller.tenure.epoch());
            controller.handle_telemetry(now, evidence);
        }
    }

    /// Whether the array obeys the controller at a place soon, if all else is quiet: the other
    /// controllers are gone, all clocks are right, no message is lost, and an operator re-arms.
    pub fn regains_service(mut self, model: &Model, place: usize) -> bool {
        if let Some(packet) = self.held.take() {
            self.arrive(packet);
        }
        self.controllers[1 - place] = None;
        if self.driver.is_none() {
            self.start_array(model);
        }
        if self.controllers[place].is_none() {
            self.start(model, place, 0);
        }
        for _ in 0..QUIET_ROUNDS {
            if let Some(controller) = &mut self.controllers[place] {
                controller.ahead_ns = 0;
            }
            if let Some(order) = self.named_rearm() {
                self.order_rearm(&order);
            }
            let accepted = self.driver.as_ref().map(|driver| driver.evidence().accepted);
            self.round(Fate::AllArrive);
            if self.driver.as_ref().map(|driver| driver.evidence().accepted) > accepted {
                return true;
            }
        }
        false
    }
}
