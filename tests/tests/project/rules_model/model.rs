//! The model: which events can occur in a state, and the properties of every state.

use heliostat_proto::*;
use stateright::Property;

use super::events::{ATTACKS, Budgets, Event, Fate, Packet};
use super::parts::Driver;
use super::room::State;

pub const STOPPED: &str = "a stopped array does not move";
pub const ONE_LEADER: &str = "an array obeys one controller in an epoch";
pub const NO_LOCKOUT: &str = "a single controller with a right clock is obeyed again";

/// Lead of a wrong clock of a controller, and of an operator.
const DAY_NS: u64 = 86_400_000_000_000;
const HOUR_NS: u64 = 3_600_000_000_000;

/// The model: its budgets, and the rules that are broken on purpose.
#[derive(Clone, Debug, Default)]
pub struct Model {
    pub budgets: Budgets,
    /// A restart of the array loses its latch.
    pub forgets_latch: bool,
    /// All controllers choose among the same epochs.
    pub shares_epochs: bool,
    /// Controllers never take a new epoch.
    pub keeps_epoch: bool,
}

impl stateright::Model for Model {
    type State = State;
    type Action = Event;

    fn init_states(&self) -> Vec<State> {
        vec![State::first(self)]
    }

    fn actions(&self, state: &State, events: &mut Vec<Event>) {
        let Budgets { rounds, lost, held, repeated, starts, crashes, array_crashes, stops, rearms, attacks } =
            state.left;
        if rounds > 0 {
            events.push(Event::Round(Fate::AllArrive));
            let messages = || 0..state.controllers.iter().flatten().count() + 2;
            if lost > 0 {
                events.extend(messages().map(|index| Event::Round(Fate::Lost(index))));
            }
            if held > 0 && state.held.is_none() {
                events.extend(messages().map(|index| Event::Round(Fate::Held(index))));
            }
        }
        if state.held.is_some() {
            events.push(Event::Arrive { remains: false });
            if repeated > 0 {
                events.push(Event::Arrive { remains: true });
            }
        }
        for (place, controller) in state.controllers.iter().enumerate() {
            if controller.is_some() && crashes > 0 {
                events.push(Event::Crash { place });
            }
            if controller.is_none() && starts > 0 {
                events.extend([false, true].map(|is_ahead| Event::Start { place, is_ahead }));
            }
        }
        match state.driver {
            Some(_) if array_crashes > 0 => events.push(Event::CrashArray),
            None => events.push(Event::StartArray),
            Some(_) => {}
        }
        if stops > 0 {
            events.extend([false, true].map(|is_ahead| Event::Stop { is_ahead, is_held: false }));
            if held > 0 && state.held.is_none() {
                events.push(Event::Stop { is_ahead: false, is_held: true });
            }
        }
        if rearms > 0 && state.stopped_at.is_some() {
            let ways = [(true, false), (false, false), (false, true)];
            events.extend(ways.map(|(by_name, is_ahead)| Event::Rearm { by_name, is_ahead }));
        }
        if attacks > 0 {
            events.extend(ATTACKS.map(Event::Attack));
        }
    }

    fn next_state(&self, last: &State, event: Event) -> Option<State> {
        let mut state = last.clone();
        let (now, left) = (state.now(), &mut state.left);
        let stamp = |is_ahead: bool, sequence: u8| Stamp {
            source: if is_ahead { 51 } else { 50 },
            sequence: u64::from(sequence),
            time_ns: now.room_ns + if is_ahead { HOUR_NS } else { 0 },
        };
        match event {
            Event::Round(fate) => {
                left.rounds -= 1;
                left.lost -= u8::from(matches!(fate, Fate::Lost(_)));
                left.held -= u8::from(matches!(fate, Fate::Held(_)));
                state.round(fate);
            }
            Event::Arrive { remains } => {
                left.repeated -= u8::from(remains);
                let packet = state.held.take()?;
                if remains {
                    state.held = Some(packet.clone());
                }
                state.arrive(packet);
            }
            Event::Start { place, is_ahead } => {
                left.starts -= 1;
                state.start(self, place, if is_ahead { DAY_NS } else { 0 });
            }
            Event::Crash { place } => {
                left.crashes -= 1;
                state.controllers[place] = None;
            }
            Event::CrashArray => {
                left.array_crashes -= 1;
                state.crash_array();
            }
            Event::StartArray => state.start_array(self),
            Event::Stop { is_ahead, is_held } => {
                left.stops -= 1;
                left.held -= u8::from(is_held);
                let order = EmergencyStop { stamp: stamp(is_ahead, left.stops), ..EmergencyStop::default() };
                if is_held {
                    state.held = Some(Packet::Stop(order));
                } else {
                    state.order_stop(&order);
                }
            }
            Event::Rearm { by_name, is_ahead } => {
                left.rearms -= 1;
                let stamp = stamp(is_ahead, 100 + left.rearms);
                if by_name {
                    let order = state.named_rearm()?;
                    state.order_rearm(&Rearm { stamp, ..order });
                } else {
                    state.order_stop(&EmergencyStop { stamp, action: StopAction::Rearm, ..EmergencyStop::default() });
                }
            }
            Event::Attack(attack) => {
                left.attacks -= 1;
                state.attack(attack);
            }
        }
        Some(state)
    }

    fn properties(&self) -> Vec<Property<Self>> {
        vec![
            Property::always(STOPPED, |_, state: &State| {
                let is_latched = |driver: &Driver| driver.kit.array().state() == ArrayState::Stopped;
                let stays = |angle: u64| angle == state.roll() && state.driver.as_ref().is_none_or(is_latched);
                state.stopped_at.is_none_or(stays)
            }),
            Property::always(ONE_LEADER, |_, state: &State| !state.has_two_leaders),
            Property::always(NO_LOCKOUT, |model, state: &State| {
                (0..2).all(|place| state.clone().regains_service(model, place))
            }),
            // The model is not empty: each of these happens.
            Property::sometimes("two controllers are obeyed, one after the other", |_, state: &State| {
                state.obeyed.values().any(|source| *source == 1) && state.obeyed.values().any(|source| *source == 2)
            }),
        ]
    }
}
