//! The check of an array that is stopped, before it or during it.

use std::time::Instant;

use heliostat_array::latch::LatchedStop;
use heliostat_array::moment::Moment;
use heliostat_bus::arriving::fetch;
use heliostat_bus::{Bus, BusConfig, Class, private_endpoint};
use heliostat_driver::run::Settings;
use heliostat_driver::stop_record::StopRecordSettings;
use heliostat_driver::{Kit, check, run};
use heliostat_proto::{EmergencyStop, Room, Stamp, StopReport, encode};
use heliostat_service::Stop;
use heliostat_service::clock::utc_ns;
use heliostat_service::exit::Interrupted;

use super::{Exact, broken, checked, checked_until, wait_for_drivers};
use crate::LIMIT;

#[test]
fn a_check_ends_with_a_stop_where_it_began_with_one_and_a_later_check_releases_that_stop() {
    let begins_stopped = |room: &str, stopped_by: Option<&str>| {
        let folder = tempfile::tempdir().unwrap();
        checked(room, |bus, stop| {
            let mut kit = Kit::new(Exact::new());
            if let Some(operator) = stopped_by {
                let stop = LatchedStop { source: 7, sequence: 1, operator: operator.into(), ..Default::default() };
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
        let stamp = Stamp { source: 7, sequence: 1, time_ns: utc_ns() };
        let order = EmergencyStop { stamp, operator: "ann".into(), ..EmergencyStop::default() };
        let mut payload = Vec::new();
        encode(&order, &mut payload).unwrap();
        let is_held = || {
            let report: Option<StopReport> = fetch(&bus, &bus.room().array(0).stops(), LIMIT).unwrap();
            report.is_some_and(|report| report.lists(order.name()))
        };
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
        assert!(is_held && refusal.contains("\"ann\" has stopped the array during the check"), "{is_held}, {refusal}");
    });
}
