//! The check of an array that is stopped, before it or during it.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::time::{Duration, Instant};

use heliostat_array::latch::LatchedStop;
use heliostat_array::moment::Moment;
use heliostat_bus::arriving::fetch;
use heliostat_bus::{Bus, BusConfig, Class, join_through, private_endpoint};
use heliostat_driver::run::Settings;
use heliostat_driver::stop_record::StopRecordSettings;
use heliostat_driver::{Kit, check, run};
use heliostat_proto::{EmergencyStop, MAX_STOPS, Room, Stamp, StopAction, StopName, StopReport, decode, encode};
use heliostat_service::Stop;
use heliostat_service::clock::utc_ns;
use heliostat_service::exit::Interrupted;

use super::{Exact, broken, checked, checked_until, wait_for_drivers};
use crate::LIMIT;

/// The name of the stop of an operator.
const ANN: StopName = StopName { source: 7, sequence: 1 };

/// The message of that stop.
fn stop_of_ann() -> Vec<u8> {
    let stamp = Stamp { source: ANN.source, sequence: ANN.sequence, time_ns: utc_ns() };
    let order = EmergencyStop { stamp, operator: "ann".into(), ..EmergencyStop::default() };
    let mut payload = Vec::new();
    encode(&order, &mut payload).unwrap();
    payload
}

/// Whether an array lists a stop of this name.
fn lists(bus: &Bus, array: usize, name: StopName) -> bool {
    let report: Option<StopReport> = fetch(bus, &bus.room().array(array).stops(), LIMIT).unwrap();
    report.is_some_and(|report| report.lists(name))
}

#[test]
fn a_check_ends_with_a_stop_where_it_began_with_one_and_a_later_check_releases_that_stop() {
    let begins_stopped = |room: &str, stopped_by: Option<&str>| {
        let folder = tempfile::tempdir().unwrap();
        checked(room, |bus, stop| {
            let mut kit = Kit::new(Exact::new());
            // A check that was killed can leave several.
            for (source, operator) in stopped_by.into_iter().flat_map(|operator| [(7, operator), (8, operator)]) {
                let stop = LatchedStop { source, sequence: 1, operator: operator.into(), ..Default::default() };
                kit.stop(Moment::default(), stop);
            }
            let record = StopRecordSettings { directory: Some(folder.path().to_owned()), start_armed: true };
            drop(run::run(kit, &Settings { record, ..Settings::new(bus) }, stop).unwrap());
        })
    };
    std::thread::scope(|scope| {
        let released = scope.spawn(|| begins_stopped("released", None));
        let again = begins_stopped("again", Some("driver check"));
        assert_eq!((released.join().unwrap().is_stopped, again.is_stopped), (None, Some(true)), "{again}");
        assert_eq!(broken(&again), [""; 0], "{again}");
    });
}

#[test]
fn a_check_that_is_interrupted_stops_an_array_again_that_began_stopped() {
    let end = Stop::default();
    let show = |line: String| {
        if line.starts_with("rule 3 of ") {
            end.request();
        }
    };
    // Without a record each start is stopped.
    let ended = checked_until("interrupted", (&end, &show), |bus, stop| {
        drop(run::run(Kit::new(Exact::new()), &Settings::new(bus), stop).unwrap());
    });
    let error = ended.unwrap_err();
    assert!(error.is::<Interrupted>(), "{error:#}");
    let words = format!("{error:#}");
    assert!(words.starts_with("the array is stopped again, as before the check"), "{words}");
    assert!(words.contains("before the rule follow"), "{words}");
}

#[test]
fn an_array_that_an_operator_stopped_is_not_checked() {
    let endpoint = private_endpoint().unwrap();
    let config = BusConfig::new(Room::new("stopped").unwrap());
    let stop = Stop::default();
    let mut kit = Kit::new(Exact::new());
    kit.stop(Moment::default(), LatchedStop { source: 7, sequence: 1, operator: "ann".into(), ..Default::default() });
    let folder = tempfile::tempdir().unwrap();
    let record = StopRecordSettings { directory: Some(folder.path().to_owned()), start_armed: true };
    let settings = Settings { record, ..Settings::new(config.clone().listen_at(&endpoint)) };
    std::thread::scope(|scope| {
        scope.spawn(|| run::run(kit, &settings, &stop).unwrap());
        let config = config.connect_to(&endpoint);
        wait_for_drivers(&config, 1);
        let refusal = check::run(&config, 0, LIMIT, &Stop::default(), &drop);
        stop.request();
        let refusal = format!("{:#}", refusal.unwrap_err());
        assert!(refusal.contains("stopped by \"ann\"") && refusal.contains("heliostat rearm"), "{refusal}");
    });
}

#[test]
fn a_stop_of_an_operator_during_the_check_ends_it_and_stays_in_force() {
    let endpoint = private_endpoint().unwrap();
    let config = BusConfig::new(Room::new("meanwhile").unwrap());
    let settings = Settings::new(config.clone().listen_at(&endpoint));
    let stop = Stop::default();
    std::thread::scope(|scope| {
        scope.spawn(|| run::run(Kit::new(Exact::new()), &settings, &stop).unwrap());
        let config = config.connect_to(&endpoint);
        wait_for_drivers(&config, 1);
        let bus = Bus::open(&config).unwrap();
        let stops = bus.publisher(&bus.room().stop(), Class::RealTimeBlock).unwrap();
        let payload = stop_of_ann();
        let is_held = || lists(&bus, 0, ANN);
        // Before the rule that releases each earlier stop by its time.
        let show = |line: String| {
            let begun = Instant::now();
            while line.ends_with(": stop") && !is_held() && begun.elapsed() < LIMIT {
                stops.put(&payload).unwrap();
            }
        };
        let refusal = check::run(&config, 0, LIMIT, &Stop::default(), &show);
        let is_held = is_held();
        stop.request();
        let refusal = format!("{:#}", refusal.unwrap_err());
        assert!(is_held && refusal.contains("\"ann\" has stopped an array of this room"), "{is_held}, {refusal}");
    });
}

#[test]
fn a_stop_of_an_operator_at_another_array_ends_the_check_and_stays_in_force() {
    let endpoints = [private_endpoint().unwrap(), private_endpoint().unwrap()];
    let config = BusConfig::new(Room::new("beside").unwrap());
    let both = endpoints.iter().fold(config.clone(), |config, endpoint| config.connect_to(endpoint));
    let folder = tempfile::tempdir().unwrap();
    let stop = Stop::default();
    std::thread::scope(|scope| {
        for (array, endpoint) in endpoints.iter().enumerate() {
            let record = StopRecordSettings { directory: Some(folder.path().to_owned()), start_armed: true };
            let settings = Settings { record, array, ..Settings::new(config.clone().listen_at(endpoint)) };
            let mut kit = Kit::new(Exact::new());
            if array == 1 {
                let StopName { source, sequence } = ANN;
                let stop = LatchedStop { source, sequence, operator: "ann".into(), ..Default::default() };
                kit.stop(Moment::default(), stop);
            }
            let stop = &stop;
            scope.spawn(move || run::run(kit, &settings, stop).unwrap());
        }
        wait_for_drivers(&both, 1);
        let bus = Bus::open(&both).unwrap();
        let begun = Instant::now();
        while !lists(&bus, 1, ANN) && begun.elapsed() < LIMIT {
            std::thread::sleep(Duration::from_millis(20));
        }
        let refusal = check::run(&both, 0, LIMIT, &Stop::default(), &drop);
        let is_held = lists(&bus, 1, ANN);
        stop.request();
        let refusal = format!("{:#}", refusal.unwrap_err());
        assert!(is_held && refusal.contains("\"ann\" has stopped an array of this room"), "{is_held}, {refusal}");
    });
}

/// The array holds it without its name, and the rule of the list releases all stops that the array holds.
#[test]
fn a_stop_of_an_operator_that_arrives_while_the_list_is_full_is_not_released() {
    let endpoint = private_endpoint().unwrap();
    let config = BusConfig::new(Room::new("full").unwrap());
    let settings = Settings::new(config.clone().listen_at(&endpoint));
    let stop = Stop::default();
    std::thread::scope(|scope| {
        scope.spawn(|| run::run(Kit::new(Exact::new()), &settings, &stop).unwrap());
        let config = config.connect_to(&endpoint);
        wait_for_drivers(&config, 1);
        // As `heliostat stop`: the driver passes its messages on.
        let bus = join_through(&config, LIMIT).0.expect("the driver accepts connections");
        let stops = bus.publisher(&bus.room().stop(), Class::RealTimeBlock).unwrap();
        let is_list_judged = Arc::new(AtomicBool::new(false));
        let (is_counted, mut count) = (Arc::clone(&is_list_judged), 0);
        let (full, is_full) = mpsc::channel();
        let watch = bus.subscribe(&bus.room().stop(), move |payload| {
            let is_stop = decode::<EmergencyStop>(payload).is_ok_and(|order| order.action == StopAction::Stop);
            count += usize::from(is_stop && is_counted.load(Ordering::SeqCst));
            if count > MAX_STOPS {
                // The receiver ends after the first one.
                let _ = full.send(());
            }
        });
        let watch = watch.unwrap();
        let sender = scope.spawn(move || {
            // Ends with the subscription, where a check has not come so far.
            if is_full.recv().is_ok() {
                stops.put(&stop_of_ann()).unwrap();
            }
        });
        let show = |line: String| is_list_judged.store(line.ends_with(": stop-list"), Ordering::SeqCst);
        let refusal = check::run(&config, 0, LIMIT, &Stop::default(), &show);
        drop(watch);
        sender.join().unwrap();
        // By its name, or by the stop without sender that stands for it.
        let is_held = || [ANN, StopName::default()].into_iter().any(|name| lists(&bus, 0, name));
        let begun = Instant::now();
        let mut is_stopped = is_held();
        while !is_stopped && begun.elapsed() < LIMIT {
            std::thread::sleep(Duration::from_millis(20));
            is_stopped = is_held();
        }
        stop.request();
        let refusal = format!("{:#}", refusal.unwrap_err());
        assert!(is_stopped && refusal.contains("\"ann\" has stopped an array of this room"), "{is_stopped}, {refusal}");
    });
}
