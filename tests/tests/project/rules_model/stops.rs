//! A model of emergency stops in a room with two arrays.
//!
//! It runs the real kit of each array, and the real hold of stops in a controller and in the process of
//! an operator. Arrays leave and return, devices fail, and each receiver may lose a stop or a re-arm.
//!
//! | property | means |
//! | --- | --- |
//! | [`TOLD`] | an operator is told "stopped" only while no mirror of any array can move |
//! | [`KEPT`] | an array that latched a stop does not move until a re-arm of that stop |
//! | [`REACHES`] | from every state, each stop reaches each array that has not released it |
//! | [`SERVICE`] | from every state, re-arms of the listed stops restore service at both arrays |
//!
//! Each [`Mend`] can be taken out; the model then finds a counterexample.

use std::hash::{Hash, Hasher};

use heliostat_array::latch::Latch;
use heliostat_array::moment::Moment;
use heliostat_array::{Device, DeviceError, Kit};
use heliostat_channel::MirrorAngles;
use heliostat_proto::stop_hold::StopHold;
use heliostat_proto::*;
use stateright::{Checker, HasDiscoveries, Model as _, Property};

use super::parts::{COMMAND, by_key, instant, one_mirror};

const TOLD: &str = "told stopped only while no mirror can move";
const KEPT: &str = "a latched stop is kept until its own re-arm";
const REACHES: &str = "each stop reaches each array";
const SERVICE: &str = "re-arms restore service";

/// Rounds within which stops arrive and service returns, if all else is quiet.
const QUIET_ROUNDS: u32 = 8;

/// A rule that can be taken out.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Mend {
    /// An absent array has to confirm too.
    AbsentArrayCounts,
    /// A latched stop is no stopped device.
    DeviceCounts,
    /// Held stops are repeated.
    Repetition,
    /// A re-arm alone ends no hold.
    ArrayIsAuthority,
    /// A re-arm releases the stop that it names only.
    NamedRelease,
    /// The latch outlives its driver.
    Record,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
struct Budgets {
    rounds: u8,
    stops: u8,
    rearms: u8,
    absences: u8,
    failures: u8,
    lost: u8,
}

/// One mirror; it can move after each turn, until it is stopped.
#[derive(Clone, Debug, PartialEq)]
struct Hardware {
    roll: f64,
    can_move: bool,
    fails: bool,
}

impl Hardware {
    fn execute(&self) -> Result<(), DeviceError> {
        if self.fails { Err(DeviceError::new("mirror", "broken")) } else { Ok(()) }
    }
}

impl Device for Hardware {
    fn capabilities(&self) -> Capabilities {
        one_mirror()
    }

    fn connect(&mut self, _now: Moment) -> Result<(), DeviceError> {
        self.execute()
    }

    fn apply(&mut self, _now: Moment, angles: &MirrorAngles) -> Result<(), DeviceError> {
        self.execute()?;
        (self.roll, self.can_move) = (angles.roll[0], true);
        Ok(())
    }

    fn measure(&mut self, _now: Moment, into: &mut MirrorAngles) -> Result<bool, DeviceError> {
        self.execute()?;
        into.roll[0] = self.roll;
        Ok(true)
    }

    fn stop(&mut self, _now: Moment) -> Result<(), DeviceError> {
        self.execute()?;
        self.can_move = false;
        Ok(())
    }
}

/// An array: its driver, its hardware while there is no driver, and what is true of its stops.
#[derive(Clone, Debug)]
struct Site {
    driver: Option<Kit<Hardware>>,
    hardware: Hardware,
    record: Latch,
    starts: u64,
    /// The stops that it latched, without those that a re-arm of their own released.
    latched: Vec<StopName>,
    released: Vec<StopName>,
    /// Its angle since the first of them.
    rest: u64,
}

impl Site {
    fn key(&self) -> impl Hash + PartialEq + use<> {
        let Hardware { roll, can_move, fails } = self.hardware().clone();
        let driver = self.driver.as_ref().map(|kit| {
            let array = kit.array();
            let released: Vec<StopName> = array.released().collect();
            let followed = array.followed().map(|followed| followed.sequence);
            (array.state() as u32, array.latch().clone(), released, kit.device_stopped(), kit.next_ns(), followed)
        });
        let truth = (self.latched.clone(), self.released.clone(), self.rest);
        (driver, (roll.to_bits(), can_move, fails), self.record.clone(), self.starts, truth)
    }

    fn hardware(&self) -> &Hardware {
        self.driver.as_ref().map_or(&self.hardware, Kit::device)
    }

    fn hardware_mut(&mut self) -> &mut Hardware {
        self.driver.as_mut().map_or(&mut self.hardware, Kit::device_mut)
    }

    /// Executes a step of the driver, and keeps the record as it does.
    fn drive(&mut self, step: impl FnOnce(&mut Kit<Hardware>)) {
        let Some(kit) = &mut self.driver else { return };
        step(kit);
        self.record.clone_from(kit.array().latch());
        for name in self.record.stops().iter().map(|stop| stop.name()) {
            if !self.latched.contains(&name) {
                if self.latched.is_empty() {
                    self.rest = kit.device().roll.to_bits();
                }
                self.latched.push(name);
                self.released.retain(|released| *released != name);
            }
        }
    }

    fn start(&mut self, now: Moment, without: Option<Mend>) {
        let mut kit = Kit::new(self.hardware.clone());
        let record = if without == Some(Mend::Record) { Latch::default() } else { self.record.clone() };
        record.restored(now.room_ns).stops().iter().for_each(|stop| kit.stop(now, stop.clone()));
        self.starts += 1;
        self.driver = Some(kit);
        self.drive(|kit| kit.advance(now));
    }

    fn is_at_rest(&self) -> bool {
        let is_stopped = |kit: &Kit<Hardware>| kit.array().state() == ArrayState::Stopped;
        self.latched.is_empty()
            || (self.hardware().roll.to_bits() == self.rest && self.driver.as_ref().is_none_or(is_stopped))
    }
}

#[derive(Clone, Debug)]
struct State {
    left: Budgets,
    round: u32,
    sites: [Site; 2],
    controller: [StopHold; 2],
    operator: [StopHold; 2],
    /// The stops that were ordered.
    ordered: Vec<StopName>,
    /// The operator was told "stopped" in the last round.
    is_told: bool,
}

impl State {
    fn key(&self) -> impl Hash + PartialEq + use<> {
        let holds = (self.controller.clone(), self.operator.clone(), self.ordered.clone(), self.is_told);
        (self.left, self.round, self.sites.each_ref().map(Site::key), holds)
    }

    fn now(&self) -> Moment {
        instant(self.round)
    }
}

by_key!(State);

#[derive(Clone, Debug, PartialEq)]
enum Event {
    /// Commands, reports and repetitions.
    Round,
    /// An operator stops; one receiver may lose it: an array, or 2 for the controller.
    Stop {
        lost: Option<usize>,
    },
    /// An operator releases a stop; an array may lose the order.
    Rearm {
        name: StopName,
        lost: Option<usize>,
    },
    Leave(usize),
    Return(usize),
    Fail(usize),
    Heal(usize),
}

#[derive(Clone, Debug, Default)]
struct Model {
    budgets: Budgets,
    without: Option<Mend>,
}

impl Model {
    fn has(&self, mend: Mend) -> bool {
        self.without != Some(mend)
    }

    fn round(&self, state: &mut State) {
        state.round += 1;
        let now = state.now();
        let mut confirmed = !state.ordered.is_empty();
        for array in 0..2 {
            let site = &mut state.sites[array];
            let sequence = u64::from(state.round);
            site.drive(|kit| kit.advance(now));
            if !state.controller[array].is_stopped() {
                let roll = vec![0.01 * state.round as f32];
                let command = MirrorCommand { epoch: 1, sequence, time_ns: now.room_ns, roll, ..COMMAND };
                site.drive(|kit| _ = kit.handle_command(now, &MirrorCommand { yaw: vec![0.0], ..command }));
            }
            let Some(kit) = &site.driver else {
                confirmed &= !self.has(Mend::AbsentArrayCounts);
                continue;
            };
            let report = kit.stops(Stamp { source: site.starts, sequence, time_ns: now.room_ns });
            for hold in [&mut state.controller[array], &mut state.operator[array]] {
                hold.handle_stops(&report);
            }
            let held = state.operator[array].stops();
            let all = held.iter().all(|held| report.stops.iter().any(|stop| stop.name() == held.name));
            confirmed &= !held.is_empty() && all && (report.device_stopped || !self.has(Mend::DeviceCounts));
            if self.has(Mend::Repetition) {
                let due = state.controller[array].unreported().chain(state.operator[array].unreported());
                for StopName { source, sequence } in due.map(|held| held.name).collect::<Vec<_>>() {
                    let (stop_source, stop_sequence) = (source, sequence);
                    let order = StopRepetition { stop_source, stop_sequence, ..StopRepetition::default() };
                    site.drive(|kit| kit.handle_repetition(now, &order));
                }
            }
        }
        state.is_told = confirmed;
    }

    fn stop(state: &mut State, lost: Option<usize>) {
        let now = state.now();
        let name = StopName { source: 50 + state.ordered.len() as u64, sequence: 1 };
        let stamp = Stamp { source: name.source, sequence: name.sequence, time_ns: now.room_ns };
        let order = EmergencyStop { stamp, ..EmergencyStop::default() };
        state.ordered.push(name);
        for array in 0..2 {
            state.operator[array].order(now.room_ns, &order);
            if lost != Some(2) {
                state.controller[array].order(now.room_ns, &order);
            }
            if lost != Some(array) {
                state.sites[array].drive(|kit| _ = kit.handle_stop(now, &order));
            }
        }
    }

    fn rearm(&self, state: &mut State, name: StopName, lost: Option<usize>) {
        let now = state.now();
        let order =
            |name: StopName| Rearm { stop_source: name.source, stop_sequence: name.sequence, ..Rearm::default() };
        for array in (0..2).filter(|array| lost != Some(*array)) {
            let site = &mut state.sites[array];
            let mut is_released = false;
            let also: Vec<StopName> = if self.has(Mend::NamedRelease) { Vec::new() } else { site.latched.clone() };
            site.drive(|kit| {
                is_released = kit.handle_rearm(now, &order(name)).is_ok();
                also.iter().for_each(|name| _ = kit.handle_rearm(now, &order(*name)));
            });
            if is_released {
                site.latched.retain(|latched| *latched != name);
                site.released.push(name);
            }
        }
        if !self.has(Mend::ArrayIsAuthority) {
            (state.controller, state.operator) = Default::default();
        }
    }

    /// The state after everything returned, without a lost message.
    fn quiet(&self, state: &State) -> State {
        let mut state = state.clone();
        let now = state.now();
        for site in &mut state.sites {
            site.hardware_mut().fails = false;
            if site.driver.is_none() {
                site.start(now, self.without);
            }
        }
        state
    }

    fn reaches(&self, state: &State) -> bool {
        let mut state = self.quiet(state);
        (0..QUIET_ROUNDS).for_each(|_| self.round(&mut state));
        let has = |site: &Site, name: &StopName| {
            let is_latched = site.record.stops().iter().any(|stop| stop.name() == *name);
            is_latched || site.released.contains(name)
        };
        state.ordered.iter().all(|name| state.sites.iter().all(|site| has(site, name)))
    }

    fn serves(&self, state: &State) -> bool {
        let mut state = self.quiet(state);
        let accepted = |state: &State| {
            state.sites.each_ref().map(|site| site.driver.as_ref().map_or(0, |kit| kit.array().counters().accepted))
        };
        let before = accepted(&state);
        for _ in 0..QUIET_ROUNDS {
            for name in state.sites.iter().flat_map(|site| site.record.stops().to_vec()).collect::<Vec<_>>() {
                self.rearm(&mut state, name.name(), None);
            }
            self.round(&mut state);
        }
        let after = accepted(&state);
        (0..2).all(|array| after[array] > before[array])
    }
}

impl stateright::Model for Model {
    type State = State;
    type Action = Event;

    fn init_states(&self) -> Vec<State> {
        let hardware = Hardware { roll: 0.0, can_move: true, fails: false };
        let site = || Site {
            driver: None,
            hardware: hardware.clone(),
            record: Latch::default(),
            starts: 0,
            latched: Vec::new(),
            released: Vec::new(),
            rest: 0,
        };
        let mut state = State {
            left: self.budgets,
            round: 0,
            sites: [site(), site()],
            controller: Default::default(),
            operator: Default::default(),
            ordered: Vec::new(),
            is_told: false,
        };
        state.sites.iter_mut().for_each(|site| site.start(instant(0), None));
        vec![state]
    }

    fn actions(&self, state: &State, events: &mut Vec<Event>) {
        let Budgets { rounds, stops, rearms, absences, failures, lost } = state.left;
        if rounds > 0 {
            events.push(Event::Round);
        }
        let losses = |receivers: usize| {
            let some = (0..receivers).map(Some).filter(move |_| lost > 0);
            std::iter::once(None).chain(some)
        };
        if stops > 0 {
            events.extend(losses(3).map(|lost| Event::Stop { lost }));
        }
        if rearms > 0 {
            let mut names: Vec<StopName> = state.sites.iter().flat_map(|site| site.latched.clone()).collect();
            names.sort_unstable();
            names.dedup();
            for name in names {
                events.extend(losses(2).map(|lost| Event::Rearm { name, lost }));
            }
        }
        for (array, site) in state.sites.iter().enumerate() {
            match site.driver {
                Some(_) if absences > 0 => events.push(Event::Leave(array)),
                Some(_) => {}
                None => events.push(Event::Return(array)),
            }
            match site.hardware().fails {
                false if failures > 0 => events.push(Event::Fail(array)),
                false => {}
                true => events.push(Event::Heal(array)),
            }
        }
    }

    fn next_state(&self, last: &State, event: Event) -> Option<State> {
        let mut state = last.clone();
        let now = state.now();
        state.is_told = false;
        match event {
            Event::Round => {
                state.left.rounds -= 1;
                self.round(&mut state);
            }
            Event::Stop { lost } => {
                state.left.stops -= 1;
                state.left.lost -= u8::from(lost.is_some());
                Self::stop(&mut state, lost);
            }
            Event::Rearm { name, lost } => {
                state.left.rearms -= 1;
                state.left.lost -= u8::from(lost.is_some());
                self.rearm(&mut state, name, lost);
            }
            Event::Leave(array) => {
                state.left.absences -= 1;
                let site = &mut state.sites[array];
                site.hardware = site.driver.take()?.device().clone();
            }
            Event::Return(array) => state.sites[array].start(now, self.without),
            Event::Fail(array) => {
                state.left.failures -= 1;
                state.sites[array].hardware_mut().fails = true;
            }
            Event::Heal(array) => state.sites[array].hardware_mut().fails = false,
        }
        Some(state)
    }

    fn properties(&self) -> Vec<Property<Self>> {
        vec![
            Property::always(TOLD, |_, state: &State| {
                !state.is_told || state.sites.iter().all(|site| !site.hardware().can_move)
            }),
            Property::always(KEPT, |_, state: &State| state.sites.iter().all(Site::is_at_rest)),
            Property::always(REACHES, |model: &Self, state: &State| model.reaches(state)),
            Property::always(SERVICE, |model: &Self, state: &State| model.serves(state)),
            Property::sometimes("told stopped", |_, state: &State| state.is_told),
        ]
    }
}

/// Budgets in which every mend matters.
const BUDGETS: Budgets = Budgets { rounds: 3, stops: 2, rearms: 1, absences: 1, failures: 1, lost: 1 };

#[test]
fn no_operator_is_told_stopped_while_a_mirror_can_move() {
    let checker = Model { budgets: BUDGETS, without: None }.checker().threads(2).spawn_bfs().join();
    eprintln!("{} states, depth {}", checker.unique_state_count(), checker.max_depth());
    checker.assert_properties();
}

#[test]
fn each_rule_that_is_taken_out_is_found() {
    let cases = [
        (Mend::AbsentArrayCounts, TOLD),
        (Mend::DeviceCounts, TOLD),
        (Mend::Repetition, REACHES),
        (Mend::ArrayIsAuthority, REACHES),
        (Mend::NamedRelease, KEPT),
        (Mend::Record, KEPT),
    ];
    for (mend, property) in cases {
        let model = Model { budgets: BUDGETS, without: Some(mend) };
        let finish = HasDiscoveries::AnyOf([property].into());
        let checker = model.checker().threads(2).finish_when(finish).spawn_bfs().join();
        let path = checker.discovery(property).map(|path| format!("{:?}", path.into_actions()));
        eprintln!("without {mend:?}: {path:?}");
        assert!(path.is_some(), "the model does not find the fault without {mend:?}");
    }
}
