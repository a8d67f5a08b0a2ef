//! The emergency stop and its release, against an array of this test.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use heliostat_bus::{Bus, BusConfig, Class, Publisher, Subscription, private_endpoint};
use heliostat_proto::{
    ArrayState, EmergencyStop, MirrorTelemetry, Rearm, Room, SafetyReport, StopAction, decode, encode,
};
use heliostat_ui::{StopSwitch, UiError};

/// Time limit for an action that takes milliseconds on an idle machine.
const TIME_LIMIT: Duration = Duration::from_secs(30);

/// An array that obeys stops; it ignores the first `deaf` of them.
struct Array {
    rearms: Arc<Mutex<Vec<Rearm>>>,
    legacy_rearms: Arc<Mutex<u32>>,
    ignores_rearms: Arc<AtomicBool>,
    bus: Bus,
    safety: Publisher,
    _subscriptions: Vec<Subscription>,
}

fn publish<M: heliostat_proto::Message>(publisher: &Publisher, message: &M) {
    let mut payload = Vec::new();
    encode(message, &mut payload).unwrap();
    publisher.put(&payload).unwrap();
}

fn state(state: ArrayState) -> MirrorTelemetry {
    MirrorTelemetry { state, ..Default::default() }
}

impl Array {
    fn new(room: &str, endpoint: &str, deaf: u32) -> Self {
        let bus = Bus::open(&BusConfig::new(Room::new(room).unwrap()).listen_at(endpoint)).unwrap();
        let telemetry = Arc::new(bus.publisher(&bus.room().telemetry(), Class::HighDrop).unwrap());
        let safety = bus.publisher(&bus.room().safety(), Class::HighDrop).unwrap();
        let (rearms, legacy_rearms) = (Arc::<Mutex<Vec<Rearm>>>::default(), Arc::<Mutex<u32>>::default());
        let (named, legacy) = (Arc::clone(&rearms), Arc::clone(&legacy_rearms));
        let on_rearm = Arc::clone(&telemetry);
        let ignores_rearms = Arc::<AtomicBool>::default();
        let ignores = Arc::clone(&ignores_rearms);
        let mut ignored = 0;
        let subscriptions = vec![
            bus.subscribe(&bus.room().stop(), move |payload| match decode::<EmergencyStop>(payload).unwrap().action {
                StopAction::Stop if ignored < deaf => ignored += 1,
                StopAction::Stop => publish(&telemetry, &state(ArrayState::Stopped)),
                StopAction::Rearm => {
                    *legacy.lock().unwrap() += 1;
                    publish(&telemetry, &state(ArrayState::Parked));
                }
            })
            .unwrap(),
            bus.subscribe(&bus.room().rearm(), move |payload| {
                named.lock().unwrap().push(decode(payload).unwrap());
                let ignores = ignores.load(Ordering::Relaxed);
                publish(&on_rearm, &state(if ignores { ArrayState::Stopped } else { ArrayState::Parked }));
            })
            .unwrap(),
        ];
        Self { rearms, legacy_rearms, ignores_rearms, bus, safety, _subscriptions: subscriptions }
    }
}

fn switch(room: &str, endpoint: &str) -> (Bus, StopSwitch) {
    let bus = Bus::open(&BusConfig::new(Room::new(room).unwrap()).connect_to(endpoint)).unwrap();
    let switch = StopSwitch::new(&bus, "ann").unwrap();
    (bus, switch)
}

#[test]
fn a_stop_is_repeated_until_telemetry_confirms_it() {
    let endpoint = private_endpoint().unwrap();
    let _array = Array::new("repeat", &endpoint, 2);
    let (_bus, switch) = switch("repeat", &endpoint);
    switch.stop_and_confirm("test", TIME_LIMIT).unwrap();
}

#[test]
fn a_stop_without_an_array_is_reported() {
    let endpoint = private_endpoint().unwrap();
    let _other = Bus::open(&BusConfig::new(Room::new("nothing").unwrap()).listen_at(&endpoint)).unwrap();
    let (_bus, switch) = switch("nothing", &endpoint);
    let error = switch.stop_and_confirm("test", Duration::from_millis(100)).unwrap_err();
    assert!(matches!(error, UiError::NoReceiver("array")), "{error}");
}

#[test]
fn a_rearm_names_the_stop_in_the_safety_report() {
    let endpoint = private_endpoint().unwrap();
    let array = Array::new("named", &endpoint, 0);
    let (_bus, switch) = switch("named", &endpoint);
    switch.stop_and_confirm("test", TIME_LIMIT).unwrap();
    publish(&array.safety, &SafetyReport { stopped: true, stop_source: 7, stop_sequence: 9, ..Default::default() });
    switch.rearm_and_confirm("clear", TIME_LIMIT).unwrap();
    let rearm = array.rearms.lock().unwrap()[0].clone();
    assert_eq!((rearm.stop_source, rearm.stop_sequence), (7, 9));
    assert_eq!((&*rearm.operator, &*rearm.reason), ("ann", "clear"));
    assert_eq!(*array.legacy_rearms.lock().unwrap(), 0);
    drop(array.bus);
}

#[test]
fn a_stop_that_arrives_during_a_rearm_stays_in_force() {
    let endpoint = private_endpoint().unwrap();
    let array = Array::new("later", &endpoint, 0);
    let (_bus, switch) = switch("later", &endpoint);
    switch.stop_and_confirm("test", TIME_LIMIT).unwrap();
    publish(&array.safety, &SafetyReport { stopped: true, stop_source: 7, stop_sequence: 1, ..Default::default() });
    array.ignores_rearms.store(true, Ordering::Relaxed);
    let later = SafetyReport { stopped: true, stop_source: 8, stop_sequence: 1, ..Default::default() };
    let error = std::thread::scope(|scope| {
        let rearm = scope.spawn(|| switch.rearm_and_confirm("clear", Duration::from_secs(3)));
        while array.rearms.lock().unwrap().is_empty() {
            std::thread::sleep(Duration::from_millis(5));
        }
        publish(&array.safety, &later);
        rearm.join().unwrap().unwrap_err()
    });
    assert!(matches!(error, UiError::Unconfirmed { .. }), "{error}");
    let rearms = array.rearms.lock().unwrap();
    assert!(rearms.len() > 1 && rearms.iter().all(|rearm| rearm.stop_source == 7), "{rearms:?}");
}

#[test]
fn an_array_without_safety_reports_gets_the_rearm_of_the_first_messages() {
    let endpoint = private_endpoint().unwrap();
    let array = Array::new("legacy", &endpoint, 0);
    let (_bus, switch) = switch("legacy", &endpoint);
    switch.stop_and_confirm("test", TIME_LIMIT).unwrap();
    switch.rearm_and_confirm("clear", TIME_LIMIT).unwrap();
    assert_eq!(*array.legacy_rearms.lock().unwrap(), 1);
    assert!(array.rearms.lock().unwrap().is_empty());
}

#[test]
fn a_rearm_of_an_array_that_is_not_stopped_sends_nothing() {
    let endpoint = private_endpoint().unwrap();
    let array = Array::new("moving", &endpoint, 0);
    let (_bus, switch) = switch("moving", &endpoint);
    switch.stop_and_confirm("test", TIME_LIMIT).unwrap();
    publish(&array.safety, &SafetyReport::default());
    let error = switch.rearm("clear").unwrap_err();
    assert!(matches!(error, UiError::NotStopped), "{error}");
    assert!(array.rearms.lock().unwrap().is_empty());
}
