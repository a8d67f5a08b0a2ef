//! What a view notes of the messages of a room.

use std::time::{Duration, Instant};

use heliostat_bus::{Bus, BusConfig, Class, private_endpoint};
use heliostat_proto::messages::fault;
use heliostat_proto::{Capabilities, Message, MirrorTelemetry, Room, Stamp, encode};
use heliostat_service::clock::utc_ns;
use heliostat_ui::View;

/// Time limit for an action that takes some seconds on an idle machine.
const TIME_LIMIT: Duration = Duration::from_secs(60);

fn encoded(message: &impl Message) -> Vec<u8> {
    let mut payload = Vec::new();
    encode(message, &mut payload).unwrap();
    payload
}

#[test]
fn telemetry_that_is_old_at_each_arrival_is_noted_of_every_array() {
    let (endpoint, config) = (private_endpoint().unwrap(), BusConfig::new(Room::new("old").unwrap()));
    let room = Bus::open(&config.clone().listen_at(&endpoint)).unwrap();
    let bus = Bus::open(&config.connect_to(&endpoint)).unwrap();
    let view = View::open(&bus, None).unwrap();
    let arrays = [0, 1].map(|array| {
        let keys = room.room().array(array);
        [keys.capabilities(), keys.telemetry()].map(|key| room.publisher(&key, Class::HighDrop).unwrap())
    });
    let is_noted = |array: &str| {
        let start = format!("telemetry of {array} is 0.4");
        view.figures().notes.iter().any(|note| note.starts_with(&start))
    };
    let (begun, mut sequence) = (Instant::now(), 0);
    while !["mirrors", "mirrors-1"].into_iter().all(is_noted) {
        assert!(begun.elapsed() < TIME_LIMIT, "{:?}", view.figures().notes);
        sequence += 1;
        for [capabilities, telemetry] in &arrays {
            let stamp = Stamp { source: 7, sequence, time_ns: utc_ns() - 400_000_000 };
            capabilities.put(&encoded(&Capabilities { stamp, ..Capabilities::default() })).unwrap();
            telemetry.put(&encoded(&MirrorTelemetry { stamp, ..MirrorTelemetry::default() })).unwrap();
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn a_fault_of_an_array_is_a_note_with_what_ends_it() {
    let (endpoint, config) = (private_endpoint().unwrap(), BusConfig::new(Room::new("faults").unwrap()));
    let room = Bus::open(&config.clone().listen_at(&endpoint)).unwrap();
    let bus = Bus::open(&config.connect_to(&endpoint)).unwrap();
    let view = View::open(&bus, None).unwrap();
    let telemetry = room.publisher(&room.room().array(0).telemetry(), Class::HighDrop).unwrap();
    let is_noted = || view.figures().notes.iter().any(|note| note.starts_with("faults of the array: mirror (mirrors "));
    let (begun, mut sequence) = (Instant::now(), 0);
    while !is_noted() {
        assert!(begun.elapsed() < TIME_LIMIT, "{:?}", view.figures().notes);
        sequence += 1;
        let stamp = Stamp { source: 7, sequence, time_ns: utc_ns() };
        let report = MirrorTelemetry { stamp, faults: fault::MIRROR, ..MirrorTelemetry::default() };
        telemetry.put(&encoded(&report)).unwrap();
        std::thread::sleep(Duration::from_millis(20));
    }
}
