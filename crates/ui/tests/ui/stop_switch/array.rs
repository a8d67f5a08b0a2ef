//! The arrays of these tests.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use heliostat_bus::{Bus, Class, Publisher, Subscription};
use heliostat_proto::{
    ArrayState, EmergencyStop, LatchedStopReport, Message, MirrorTelemetry, NodeKind, Rearm, RoomGeometry, Stamp,
    StopAction, StopName, StopRepetition, StopReport, decode, encode,
};

/// How an array treats a stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Manner {
    Stops,
    /// It obeys repetitions only.
    Deaf,
    /// Its device does not execute the stop.
    Latches,
    /// It publishes telemetry alone, as the first drivers did.
    Older,
}

#[derive(Default)]
pub struct State {
    pub stops: Vec<StopName>,
    /// Repetitions of them are ignored. They are too old for the list in a report.
    pub released: Vec<StopName>,
    pub sequence: u64,
    pub rearms: Vec<Rearm>,
    pub unnamed: u32,
    /// Whether the disk has not answered.
    pub is_unrecorded: bool,
}

/// An array that obeys stops, and reports until it is dropped.
pub struct Array {
    pub state: Arc<Mutex<State>>,
    is_over: Arc<AtomicBool>,
    _subscriptions: Vec<Subscription>,
    reporter: Reporter,
}

#[derive(Clone)]
struct Reporter {
    manner: Manner,
    telemetry: Arc<Publisher>,
    stops: Arc<Publisher>,
    /// Announces the geometry of the room, where there is one.
    geometry: Option<(Arc<Publisher>, usize)>,
}

impl Reporter {
    fn report(&self, state: &mut State) {
        if let Some((geometry, arrays)) = &self.geometry {
            let walls = ["+y", "-x", "+x"].into_iter().take(*arrays);
            let mirrors = walls.map(|wall| format!("[[mirrors]]\nrows = 1\ncolumns = 1\nwall = \"{wall}\"\n"));
            publish(geometry, &RoomGeometry { scenario: mirrors.collect(), ..RoomGeometry::default() });
        }
        state.sequence += 1;
        let stamp = Stamp { source: 9, sequence: state.sequence, time_ns: 0 };
        let is_stopped = !state.stops.is_empty();
        if self.manner != Manner::Older {
            let latched = |name: &StopName| LatchedStopReport {
                source: name.source,
                sequence: name.sequence,
                operator: "ann".into(),
                ..LatchedStopReport::default()
            };
            let device_stopped = is_stopped && self.manner != Manner::Latches;
            let problem = match (is_stopped, device_stopped) {
                (true, false) => "no link".to_owned(),
                (true, true) if state.is_unrecorded => format!("no answer {}", state.sequence),
                _ => String::new(),
            };
            let stops = state.stops.iter().map(latched).collect();
            publish(&self.stops, &StopReport { stamp, device_stopped, stops, problem, ..StopReport::default() });
        }
        let state = if is_stopped { ArrayState::Stopped } else { ArrayState::Parked };
        publish(&self.telemetry, &MirrorTelemetry { stamp, state, ..MirrorTelemetry::default() });
    }
}

pub fn publish<M: Message>(publisher: &Publisher, message: &M) {
    let mut payload = Vec::new();
    encode(message, &mut payload).unwrap();
    // At the end of a test its session is closed.
    drop(publisher.put(&payload));
}

impl Array {
    pub fn new(bus: &Bus, index: usize, manner: Manner, arrays: Option<usize>) -> Self {
        let (room, keys) = (bus.room(), bus.room().array(index));
        let publisher = |key: &str| Arc::new(bus.publisher(key, Class::HighDrop).unwrap());
        let (telemetry, stops) = (publisher(&keys.telemetry()), publisher(&keys.stops()));
        let geometry = arrays.map(|arrays| (publisher(&room.geometry(NodeKind::SimNode)), arrays));
        let reporter = Reporter { manner, telemetry, stops, geometry };
        let state: Arc<Mutex<State>> = Arc::default();
        let on = |apply: fn(&mut State, &[u8], Manner)| {
            let (state, reporter) = (Arc::clone(&state), reporter.clone());
            move |payload: &[u8]| {
                let mut state = state.lock().unwrap();
                apply(&mut state, payload, reporter.manner);
                reporter.report(&mut state);
            }
        };
        let subscriptions = vec![
            bus.subscribe(
                &room.stop(),
                on(|state, payload, manner| {
                    let order: EmergencyStop = decode(payload).unwrap();
                    match order.action {
                        StopAction::Stop if manner != Manner::Deaf => latch(state, order.name()),
                        StopAction::Stop => {}
                        StopAction::Rearm => {
                            state.unnamed += 1;
                            state.stops.clear();
                        }
                    }
                }),
            ),
            bus.subscribe(
                &keys.stop_repetition(),
                on(|state, payload, manner| {
                    let order: StopRepetition = decode(payload).unwrap();
                    if manner != Manner::Older && !state.released.contains(&order.name()) {
                        latch(state, order.name());
                    }
                }),
            ),
            bus.subscribe(
                &room.rearm(),
                on(|state, payload, manner| {
                    let order: Rearm = decode(payload).unwrap();
                    if manner != Manner::Older {
                        state.stops.retain(|name| *name != order.name());
                    }
                    state.rearms.push(order);
                }),
            ),
        ];
        let is_over = Arc::new(AtomicBool::new(false));
        let (over, reported, regular) = (Arc::clone(&is_over), Arc::clone(&state), reporter.clone());
        std::thread::spawn(move || {
            while !over.load(Ordering::SeqCst) {
                regular.report(&mut reported.lock().unwrap());
                std::thread::sleep(Duration::from_millis(50));
            }
        });
        Self { state, is_over, _subscriptions: subscriptions.into_iter().map(Result::unwrap).collect(), reporter }
    }

    pub fn report(&self) {
        self.reporter.report(&mut self.state.lock().unwrap());
    }

    pub fn stops(&self) -> Vec<StopName> {
        self.state.lock().unwrap().stops.clone()
    }
}

impl Drop for Array {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::SeqCst);
    }
}

pub fn latch(state: &mut State, name: StopName) {
    if !state.stops.contains(&name) {
        state.stops.push(name);
    }
}
