//! The emergency stop and its release, against arrays of this test.

mod array;
mod lost;

use std::sync::MutexGuard;
use std::time::{Duration, Instant};

use heliostat_bus::{Bus, BusConfig, Class, private_endpoint};
use heliostat_proto::{ArrayState, MirrorTelemetry, NodeKind, Room, Stamp, StopName};
use heliostat_ui::{StopSwitch, UiError};

use array::{Array, Manner, State, latch, publish};

/// Time limit for an action that takes milliseconds on an idle machine.
const TIME_LIMIT: Duration = Duration::from_secs(60);

/// Time limit for what has to fail; the arrays that do not fail answer within it on a busy machine too.
const SHORT: Duration = Duration::from_secs(8);

/// Arrays of these manners in a room, and a switch of an operator.
fn arrays(room: &str, manners: &[Manner]) -> (Vec<Array>, StopSwitch, (Bus, Bus)) {
    announced(room, manners, Some(manners.len()))
}

/// The same in a room that announces so many arrays.
fn announced(room: &str, manners: &[Manner], count: Option<usize>) -> (Vec<Array>, StopSwitch, (Bus, Bus)) {
    let endpoint = private_endpoint().unwrap();
    let config = BusConfig::new(Room::new(room).unwrap());
    let own = Bus::open(&config.clone().listen_at(&endpoint)).unwrap();
    let arrays: Vec<Array> =
        manners.iter().enumerate().map(|(index, manner)| Array::new(&own, index, *manner, count)).collect();
    let bus = Bus::open(&config.connect_to(&endpoint)).unwrap();
    let switch = StopSwitch::new("ann");
    switch.join(&bus).unwrap();
    (arrays, switch, (own, bus))
}

/// Waits until it is so.
fn awaited(what: &str, mut is_so: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !is_so() {
        assert!(begun.elapsed() < TIME_LIMIT, "{what}");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// The arrays that are not confirmed as stopped.
fn unconfirmed(switch: &StopSwitch) -> Vec<String> {
    match switch.stop_and_confirm("test", SHORT).unwrap_err() {
        UiError::StopUnconfirmed { arrays, .. } => arrays,
        error => panic!("{error}"),
    }
}

#[test]
fn a_stop_is_confirmed_by_every_array_and_released_by_its_name() {
    let (arrays, switch, _sessions) = arrays("both", &[Manner::Stops, Manner::Stops]);
    switch.stop_and_confirm("test", TIME_LIMIT).unwrap();
    let stops = switch.known_stops();
    assert_eq!((stops.len(), stops[0].arrays.clone()), (1, vec![0, 1]), "a confirmed stop is known by its name");
    assert!(arrays.iter().all(|array| array.stops() == [stops[0].name]));
    switch.rearm_and_confirm(&[stops[0].name], "clear", TIME_LIMIT).unwrap();
    let rearm = arrays[0].state.lock().unwrap().rearms[0].clone();
    assert_eq!((rearm.name(), &*rearm.operator, &*rearm.reason), (stops[0].name, "ann", "clear"));
}

#[test]
fn a_session_that_joins_after_the_order_brings_it_to_its_arrays_before_it_is_confirmed() {
    let (first, switch, _sessions) = announced("late", &[Manner::Stops], Some(2));
    let endpoint = private_endpoint().unwrap();
    let config = BusConfig::new(Room::new("late").unwrap());
    let own = Bus::open(&config.clone().listen_at(&endpoint)).unwrap();
    let second = Array::new(&own, 1, Manner::Stops, Some(2));
    switch.set_joining(true);
    std::thread::scope(|scope| {
        let order = scope.spawn(|| switch.stop_and_confirm("test", TIME_LIMIT));
        awaited("the stop at the first array", || !first[0].stops().is_empty());
        let late = Bus::open(&config.connect_to(&endpoint)).unwrap();
        switch.join(&late).unwrap();
        awaited("the stop at the second array", || second.stops() == first[0].stops());
        awaited("the confirmation of both", || switch.is_own_confirmed());
        assert!(!order.is_finished(), "a further session may show another array");
        switch.set_joining(false);
        order.join().unwrap().unwrap();
    });
}

#[test]
fn a_stop_is_repeated_by_its_name_to_an_array_that_has_not_reported_it() {
    let (arrays, switch, _sessions) = arrays("deaf", &[Manner::Stops, Manner::Deaf]);
    arrays.iter().for_each(Array::report);
    switch.stop_and_confirm("test", TIME_LIMIT).unwrap();
    assert_eq!(arrays[0].stops(), arrays[1].stops());
    assert_eq!(arrays[0].stops().len(), 1, "a repetition has no name of its own");
}

/// Awaits the stop at an array, and releases it there as another operator.
fn release_elsewhere(array: &Array) {
    awaited("the stop", || !array.stops().is_empty());
    // Its report with the stop comes before the one without.
    array.report();
    let mut state = array.state.lock().unwrap();
    state.released = std::mem::take(&mut state.stops);
    drop(state);
    array.report();
}

#[test]
fn a_stop_that_another_operator_releases_meanwhile_is_not_ordered_again() {
    let (arrays, switch, _sessions) = arrays("released", &[Manner::Stops, Manner::Latches]);
    assert_eq!(switch.stops(TIME_LIMIT), [], "every array is known, so that the stop itself is sent once");
    std::thread::scope(|scope| {
        let open = scope.spawn(|| unconfirmed(&switch));
        release_elsewhere(&arrays[0]);
        let open = open.join().unwrap();
        assert_eq!(open[0], "another operator has released the stop at array 0", "{open:?}");
    });
}

#[test]
fn a_stop_is_repeated_to_an_array_that_appears_after_another_operator_has_released_it_elsewhere() {
    // The first array never confirms, so that the switch waits until its limit.
    let (first, switch, (own, _bus)) = announced("joined", &[Manner::Latches], None);
    assert_eq!(switch.stops(TIME_LIMIT), [], "the first array is known");
    std::thread::scope(|scope| {
        let open = scope.spawn(|| unconfirmed(&switch));
        release_elsewhere(&first[0]);
        awaited("the release", || switch.known_stops().is_empty());
        let later = Array::new(&own, 1, Manner::Deaf, None);
        let open = open.join().unwrap();
        assert_eq!(later.stops(), first[0].state.lock().unwrap().released, "{open:?}");
        assert_eq!(open[0], "another operator has released the stop at array 0", "{open:?}");
        assert!(!open.iter().any(|open| open.contains("array 1")), "it has stopped: {open:?}");
    });
}

#[test]
fn an_array_that_is_silent_or_whose_device_does_not_stop_is_named() {
    let (live, switch, _sessions) = arrays("silent", &[Manner::Stops, Manner::Latches]);
    let latched = "array 1 has latched the stop, but its device has not executed it (no link): cut its power";
    assert_eq!(unconfirmed(&switch), [latched]);
    drop(live);
    let silent = ["array 0 does not answer: cut its power", "array 1 does not answer: cut its power"];
    assert_eq!(unconfirmed(&switch), silent);
}

#[test]
fn an_array_of_the_announced_geometry_that_was_never_seen_is_named() {
    let (_arrays, switch, _sessions) = announced("absent", &[Manner::Stops], Some(2));
    assert_eq!(unconfirmed(&switch), ["array 1 does not answer: cut its power"]);
}

#[test]
fn a_room_that_announces_no_geometry_is_not_called_stopped_unless_the_operator_knows_its_arrays() {
    let (_arrays, switch, _sessions) = announced("unknown", &[Manner::Stops], None);
    let (waited, open) = match switch.stop_and_confirm("test", TIME_LIMIT).unwrap_err() {
        UiError::StopUnconfirmed { waited, arrays } => (waited, arrays),
        error => panic!("{error}"),
    };
    assert!(open.len() == 1 && open[0].starts_with("no process announces how many arrays"), "{open:?}");
    assert!(waited < TIME_LIMIT, "the wait ended before its limit, and is named as it was");
    assert_eq!(switch.stopped_arrays(), [0], "what is known of it");
    switch.expect(1);
    switch.stop_and_confirm("test", TIME_LIMIT).unwrap();
}

#[test]
fn two_drivers_of_one_array_are_named_with_their_sources() {
    let (_arrays, switch, (own, _bus)) = arrays("shared", &[Manner::Stops]);
    let _tokens = [7, 9].map(|source| own.announce(&own.room().alive(NodeKind::Driver, source)).unwrap());
    let open =
        "array 0 has 2 drivers, and the one of source 0000000000000007 has not confirmed the stop: cut its power";
    assert_eq!(unconfirmed(&switch), [open]);
    assert_eq!(switch.shared_arrays(), [""; 0], "a token alone drives nothing");
    let second = own.publisher(&own.room().array(0).telemetry(), Class::HighDrop).unwrap();
    let stamp = Stamp { source: 7, sequence: 1, time_ns: 0 };
    awaited("two drivers", || {
        publish(&second, &MirrorTelemetry { stamp, state: ArrayState::Stopped, ..MirrorTelemetry::default() });
        !switch.shared_arrays().is_empty()
    });
    let expected = "two drivers serve one array (mirrors, sources 0000000000000007 and 0000000000000009): stop one";
    let named = switch.shared_arrays();
    assert!(named.len() == 1 && named[0].starts_with(expected), "{named:?}");
}

/// Stops an array whose disk does not answer. It publishes nothing until the guard is dropped, and the switch has its
/// last report, which is returned in words.
fn silent_unrecorded<'a>(array: &'a Array, switch: &StopSwitch) -> (MutexGuard<'a, State>, String) {
    array.state.lock().unwrap().is_unrecorded = true;
    switch.stop_and_confirm("test", TIME_LIMIT).unwrap();
    let state = array.state.lock().unwrap();
    let last = format!("array 0 has stopped, but the stop is not recorded: no answer {}", state.sequence);
    awaited("the last report", || switch.unrecorded(Duration::ZERO) == [last.clone()]);
    (state, last)
}

#[test]
fn a_stop_that_is_recorded_a_moment_after_its_confirmation_is_not_called_unrecorded() {
    let (arrays, switch, _sessions) = arrays("slow", &[Manner::Stops]);
    let (mut state, _) = silent_unrecorded(&arrays[0], &switch);
    state.is_unrecorded = false;
    drop(state);
    assert_eq!(switch.unrecorded(TIME_LIMIT), [""; 0]);
}

#[test]
fn a_stop_is_called_unrecorded_although_its_array_falls_silent() {
    let (arrays, switch, _sessions) = arrays("unrecorded", &[Manner::Stops]);
    let (_state, last) = silent_unrecorded(&arrays[0], &switch);
    // Its report is old then.
    assert_eq!(switch.unrecorded(Duration::from_secs(3)), [last]);
}

#[test]
fn a_stop_without_an_array_is_reported() {
    let (_arrays, switch, _sessions) = arrays("nothing", &[]);
    let error = switch.stop_and_confirm("test", Duration::from_millis(100)).unwrap_err();
    assert!(matches!(error, UiError::NoReceiver("array")), "{error}");
}

#[test]
fn a_driver_that_does_not_report_its_device_is_said_to_do_so_and_gets_the_rearm_of_the_first_messages() {
    let (arrays, switch, _sessions) = arrays("older", &[Manner::Older]);
    let unknown = unconfirmed(&switch);
    assert!(unknown[0].starts_with("array 0 has latched the stop; its driver does not report"), "{unknown:?}");
    let names: Vec<_> = switch.stops(TIME_LIMIT).iter().map(|stop| stop.name).collect();
    switch.rearm_and_confirm(&names, "clear", TIME_LIMIT).unwrap();
    assert!(arrays[0].state.lock().unwrap().unnamed > 0 && arrays[0].stops().is_empty());
}

#[test]
fn the_rearm_of_the_first_messages_is_sent_only_with_the_names_of_all_stops() {
    let (arrays, switch, _sessions) = arrays("mixed", &[Manner::Stops, Manner::Older]);
    unconfirmed(&switch);
    let other = StopName { source: 77, sequence: 1 };
    latch(&mut arrays[0].state.lock().unwrap(), other);
    arrays.iter().for_each(Array::report);
    let stops = || switch.stops(TIME_LIMIT).iter().map(|stop| stop.name).collect::<Vec<_>>();
    let own = stops().into_iter().find(|name| *name != other).unwrap();
    let open = match switch.rearm_and_confirm(&[own], "clear", SHORT).unwrap_err() {
        UiError::RearmUnconfirmed { arrays, .. } => arrays,
        error => panic!("{error}"),
    };
    assert!(open.iter().any(|open| open.contains("array 1 knows no names of stops: release all")), "{open:?}");
    assert_eq!(arrays[0].stops(), [other], "the stop of the other operator stays");
    assert_eq!(arrays[1].state.lock().unwrap().unnamed, 0);
    arrays.iter().for_each(Array::report);
    switch.rearm_and_confirm(&stops(), "clear", TIME_LIMIT).unwrap();
    assert!(arrays.iter().all(|array| array.stops().is_empty()));
}

#[test]
fn each_press_has_a_name_of_its_own_so_that_no_rearm_on_its_way_releases_it() {
    let (arrays, switch, _sessions) = arrays("pressed", &[Manner::Stops]);
    switch.stop_and_confirm("test", TIME_LIMIT).unwrap();
    let first = arrays[0].stops()[0];
    let pressed = switch.stop("test").unwrap().name();
    assert!(pressed.source == first.source && pressed.sequence > first.sequence, "{first} {pressed}");
}

#[test]
fn a_stop_that_one_array_reports_is_repeated_to_an_array_that_appears_later() {
    let (live, switch, (own, _bus)) = announced("later", &[Manner::Stops], Some(2));
    let other = StopName { source: 77, sequence: 1 };
    latch(&mut live[0].state.lock().unwrap(), other);
    live[0].report();
    assert_eq!(switch.stops(TIME_LIMIT)[0].arrays, [0, 1], "a stop concerns every array");
    let later = Array::new(&own, 1, Manner::Deaf, None);
    awaited("the stop", || {
        later.report();
        switch.repeat();
        later.stops() == [other]
    });
}

#[test]
fn a_rearm_succeeds_although_an_array_never_had_the_stop() {
    let (arrays, switch, _sessions) = arrays("never", &[Manner::Stops, Manner::Stops]);
    let other = StopName { source: 77, sequence: 1 };
    latch(&mut arrays[0].state.lock().unwrap(), other);
    awaited("the stop of both arrays", || switch.known_stops().first().is_some_and(|stop| stop.arrays == [0, 1]));
    switch.rearm_and_confirm(&[other], "clear", TIME_LIMIT).unwrap();
    assert_eq!((arrays[0].stops(), switch.known_stops()), (vec![], vec![]));
}

#[test]
fn a_rearm_names_the_array_that_does_not_answer() {
    let (_arrays, switch, _sessions) = announced("half", &[Manner::Stops], Some(2));
    unconfirmed(&switch);
    let name = switch.stops(TIME_LIMIT)[0].name;
    let open = switch.rearm_and_confirm(&[name], "clear", SHORT).unwrap_err().to_string();
    assert!(open.contains("after 8 s: array 1 has not confirmed: it may be released when it answers again"), "{open}");
    assert!(!open.contains("array 0") && !open.contains("stays stopped"), "{open}");
}

#[test]
fn a_text_that_is_too_long_keeps_no_stop_and_no_release_back() {
    let (arrays, switch, sessions) = arrays("long", &[Manner::Stops]);
    let long = "é".repeat(3000);
    switch.stop_and_confirm(&long, TIME_LIMIT).unwrap();
    assert_eq!(arrays[0].stops().len(), 1);
    let other = StopSwitch::new(&long);
    other.join(&sessions.1).unwrap();
    let names: Vec<_> = other.stops(TIME_LIMIT).iter().map(|stop| stop.name).collect();
    other.rearm_and_confirm(&names, &long, TIME_LIMIT).unwrap();
    assert!(arrays[0].stops().is_empty());
}

#[test]
fn a_stop_of_another_operator_stays_in_force() {
    let (arrays, switch, _sessions) = arrays("others", &[Manner::Stops]);
    switch.stop_and_confirm("test", TIME_LIMIT).unwrap();
    let own = switch.stops(TIME_LIMIT)[0].name;
    let other = StopName { source: 77, sequence: 1 };
    latch(&mut arrays[0].state.lock().unwrap(), other);
    arrays[0].report();
    switch.rearm_and_confirm(&[own], "clear", TIME_LIMIT).unwrap();
    assert_eq!(arrays[0].stops(), [other]);
    assert_eq!(switch.stops(TIME_LIMIT).iter().map(|stop| stop.name).collect::<Vec<_>>(), [other]);
}

#[test]
fn a_stop_that_its_holder_repeats_after_a_release_is_a_further_one() {
    let (arrays, switch, _sessions) = arrays("further", &[Manner::Stops]);
    switch.stop_and_confirm("test", TIME_LIMIT).unwrap();
    let known: Vec<_> = switch.known_stops().iter().map(|stop| stop.name).collect();
    assert!(switch.further_stops(&known, Duration::ZERO).is_empty());
    switch.rearm_and_confirm(&known, "clear", TIME_LIMIT).unwrap();
    let other = StopName { source: 77, sequence: 1 };
    latch(&mut arrays[0].state.lock().unwrap(), other);
    let mut further = Vec::new();
    awaited("a further stop", || {
        further = switch.further_stops(&known, TIME_LIMIT);
        !further.is_empty()
    });
    assert_eq!(further.iter().map(|stop| stop.name).collect::<Vec<_>>(), [other]);
}

#[test]
fn a_rearm_of_an_array_that_is_not_stopped_sends_nothing() {
    let (arrays, switch, _sessions) = arrays("moving", &[Manner::Stops]);
    // Until its first report the array is not known.
    awaited("the first report", || {
        arrays[0].report();
        matches!(switch.rearm(&[], "clear").unwrap_err(), UiError::NotStopped)
    });
    let error = switch.rearm_and_confirm(&[], "clear", TIME_LIMIT).unwrap_err();
    assert!(matches!(error, UiError::NotStopped), "{error}");
    assert!(arrays[0].state.lock().unwrap().rearms.is_empty());
}
