//! Allocations of the transport for one command.

use std::{sync::mpsc, time::Duration};

use allocation_counter::measure;
use heliostat_bus::{Bus, BusConfig, Class, free_loopback_endpoint};
use heliostat_proto::Room as RoomName;

/// Allocations of the transport, on the thread that decides, for one command; printed for the
/// results page.
#[test]
fn a_publication_allocates_little() {
    let room = RoomName::new("allocations").unwrap();
    let endpoint = free_loopback_endpoint().unwrap();
    let here = Bus::open(&BusConfig::new(room.clone()).listen_at(&endpoint)).unwrap();
    let there = Bus::open(&BusConfig::new(room.clone()).connect_to(&endpoint)).unwrap();
    let (sender, received) = mpsc::channel();
    let _subscription =
        there.subscribe(&room.command(), move |payload| sender.send(payload.len()).unwrap_or_default()).unwrap();
    let publisher = here.publisher(&room.command(), Class::RealTimeDrop).unwrap();
    let payload = vec![0; 820];
    while received.recv_timeout(Duration::from_millis(50)).is_err() {
        publisher.put(&payload).unwrap();
    }
    let counted = measure(|| publisher.put(&payload).unwrap());
    println!("Zenoh allocates {} times, {} bytes, for a put of 820 bytes", counted.count_total, counted.bytes_total);
    assert!((1..100).contains(&counted.count_total), "{counted:?}");
}
