//! Two sessions in one process over a loopback port.

use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

use heliostat_bus::*;
use heliostat_proto::{MAX_PAYLOAD, NodeKind, Room};

use crate::common::{LIMIT, wait_until};

fn room() -> Room {
    Room::new("test").expect("a valid name")
}

fn listening(endpoint: &str) -> Bus {
    Bus::open(&BusConfig::new(room()).listen_at(endpoint)).expect("a free port")
}

fn connecting(endpoint: &str) -> Bus {
    Bus::open(&BusConfig::new(room()).connect_to(endpoint)).expect("opening does not need an answer")
}

fn pair() -> (Bus, Bus) {
    let endpoint = private_endpoint().expect("an endpoint");
    let first = listening(&endpoint);
    let second = connecting(&endpoint);
    (first, second)
}

/// Subscribes to the key and forwards the payloads.
fn subscribed(bus: &Bus, key: &str) -> (Subscription, Receiver<Vec<u8>>) {
    let (sender, receiver) = channel();
    let forward = move |payload: &[u8]| {
        let _ = sender.send(payload.to_vec());
    };
    (bus.subscribe(key, forward).expect("a valid key"), receiver)
}

/// Publishes until the other side receives the payload, since declarations take a moment to arrive.
fn publish_until_received(publisher: &Publisher, payload: &[u8], receiver: &Receiver<Vec<u8>>) {
    wait_until("a subscriber receives the payload", || {
        publisher.put(payload).expect("the session is open");
        receiver.recv_timeout(Duration::from_millis(50)).is_ok_and(|found| found == payload)
    });
}

/// Waits for the next change of presence, which must be this one.
fn expect_presence(receiver: &Receiver<(String, Presence)>, key: &str, presence: Presence) {
    let expected = (key.to_owned(), presence);
    let found = receiver.recv_timeout(LIMIT).expect("a presence changes");
    assert_eq!(found, expected);
}

fn watched(bus: &Bus) -> (Subscription, Receiver<(String, Presence)>) {
    let (sender, receiver) = channel();
    let pattern = bus.room().all_alive();
    let watch = bus.watch(&pattern, move |key, presence| {
        let _ = sender.send((key.to_owned(), presence));
    });
    (watch.expect("a valid pattern"), receiver)
}

#[test]
fn peers_receive_each_other_in_every_class() {
    let (first, second) = pair();
    for class in [Class::RealTimeDrop, Class::HighDrop, Class::LowDrop, Class::RealTimeBlock] {
        for (from, to) in [(&first, &second), (&second, &first)] {
            let key = from.room().command();
            let (_subscription, receiver) = subscribed(to, &key);
            let publisher = from.publisher(&key, class).expect("a valid key");
            publish_until_received(&publisher, format!("{class:?}").as_bytes(), &receiver);
        }
    }
    first.close().expect("the session closes");
    second.close().expect("the session closes");
}

#[test]
fn payloads_arrive_complete_and_in_order() {
    let (first, second) = pair();
    let (_watch, presence) = watched(&first);
    let (_subscription, receiver) = subscribed(&second, &first.room().stop());
    // The subscription was declared before the token, so that it is known once the token is.
    // Earlier publications may be lost, even after one arrived: a new link first carries every key,
    // and then only the subscribed ones.
    let key = second.room().alive(NodeKind::Controller, 1);
    let _token = second.announce(&key).expect("a valid key");
    expect_presence(&presence, &key, Presence::Alive);
    let publisher = first.publisher(&first.room().stop(), Class::RealTimeBlock).expect("a valid key");
    let payload = |number: usize| vec![number as u8; 1 + number * 30_000];
    for number in 0..8 {
        publisher.put(&payload(number)).expect("open");
    }
    for number in 0..8 {
        let found = receiver.recv_timeout(LIMIT);
        let found =
            found.unwrap_or_else(|_| panic!("payload {number}, of {} bytes, was dropped", payload(number).len()));
        assert!(found == payload(number), "expected payload {number}, received {} bytes", found.len());
    }
}

#[test]
fn of_a_payload_that_no_message_can_have_the_part_arrives_that_shows_it() {
    let (first, second) = pair();
    let (_subscription, receiver) = subscribed(&second, &first.room().stop());
    let publisher = first.publisher(&first.room().stop(), Class::RealTimeBlock).expect("a valid key");
    publish_until_received(&publisher, b"connected", &receiver);
    let payload = vec![7_u8; 3 * MAX_PAYLOAD];
    publisher.put(&payload).expect("open");
    let is_short = |found: &Vec<u8>| found == b"connected";
    let found = std::iter::from_fn(|| receiver.recv_timeout(LIMIT).ok()).find(|found| !is_short(found));
    assert_eq!(found.map(|found| found.len()), Some(MAX_PAYLOAD + 1));
}

#[test]
fn subscriptions_to_patterns_give_the_key() {
    let (first, second) = pair();
    let (sender, receiver) = channel();
    let keep = move |key: &str, payload: &[u8]| {
        let _ = sender.send((key.to_owned(), payload.to_vec()));
    };
    let _subscription = second.subscribe_keyed(&second.room().all_status(), keep).expect("a valid pattern");
    let key = first.room().status(NodeKind::Controller);
    let publisher = first.publisher(&key, Class::LowDrop).expect("a valid key");
    let mut found = None;
    wait_until("a subscriber receives the status", || {
        publisher.put(b"well").expect("open");
        found = receiver.recv_timeout(Duration::from_millis(50)).ok();
        found.is_some()
    });
    assert_eq!(found, Some((key, b"well".to_vec())));
}

#[test]
fn a_dropped_subscription_receives_nothing() {
    let (first, second) = pair();
    let key = first.room().users();
    let publisher = first.publisher(&key, Class::RealTimeDrop).expect("a valid key");
    let (dropped, receiver_1) = subscribed(&second, &key);
    let (_kept, receiver_2) = subscribed(&second, &key);
    publish_until_received(&publisher, b"both", &receiver_1);
    drop(dropped);
    while receiver_1.try_recv().is_ok() {}
    publish_until_received(&publisher, b"one", &receiver_2);
    assert!(receiver_1.recv_timeout(Duration::from_millis(100)).is_err());
}

#[test]
fn tokens_appear_and_disappear() {
    let (first, second) = pair();
    let key = first.room().alive(NodeKind::SimNode, 7);
    let (_watch, receiver) = watched(&second);
    let token = first.announce(&key).expect("a valid key");
    expect_presence(&receiver, &key, Presence::Alive);
    assert_eq!(second.alive(&second.room().alive_of(NodeKind::SimNode), LIMIT), Ok(vec![key.clone()]));
    assert_eq!(second.alive(&second.room().alive_of(NodeKind::Driver), LIMIT), Ok(vec![]));
    let (_late_watch, late) = watched(&second);
    expect_presence(&late, &key, Presence::Alive);
    drop(token);
    expect_presence(&receiver, &key, Presence::Gone);
    expect_presence(&late, &key, Presence::Gone);
    assert_eq!(second.alive(&second.room().all_alive(), LIMIT), Ok(vec![]));
}

#[test]
fn the_rooms_that_a_session_reaches_are_those_with_a_process_other_than_a_viewer() {
    let (first, second) = pair();
    let named = |name: &str, node| Room::new(name).expect("a valid name").alive(node, 7);
    let _viewer = first.announce(&named("seen", NodeKind::Viewer)).expect("a valid key");
    let _driver = first.announce(&named("lab", NodeKind::Driver)).expect("a valid key");
    let controller = first.announce(&named("hall", NodeKind::Controller)).expect("a valid key");
    // The viewer's token was declared before the others.
    wait_until("both rooms", || reached_rooms(&second).into_iter().eq(["hall", "lab"]));
    drop(controller);
    wait_until("the room that is left", || reached_rooms(&second).into_iter().eq(["lab"]));
}

#[test]
fn tokens_disappear_with_their_session() {
    let (first, second) = pair();
    let key = first.room().alive(NodeKind::Controller, 8);
    let (_watch, receiver) = watched(&second);
    let _token = first.announce(&key).expect("a valid key");
    expect_presence(&receiver, &key, Presence::Alive);
    first.close().expect("the session closes");
    expect_presence(&receiver, &key, Presence::Gone);
}

#[test]
fn a_connecting_peer_may_start_first_and_reconnects() {
    let endpoint = private_endpoint().expect("an endpoint");
    let early = connecting(&endpoint);
    let key = early.room().users();
    let (_subscription, receiver) = subscribed(&early, &key);
    let (_watch, presence) = watched(&early);
    for instance in 1..3 {
        let late = listening(&endpoint);
        let alive = late.room().alive(NodeKind::SimNode, instance);
        let _token = late.announce(&alive).expect("a valid key");
        expect_presence(&presence, &alive, Presence::Alive);
        let publisher = late.publisher(&key, Class::RealTimeDrop).expect("a valid key");
        publish_until_received(&publisher, format!("instance {instance}").as_bytes(), &receiver);
        late.close().expect("the session closes");
        expect_presence(&presence, &alive, Presence::Gone);
    }
}

#[test]
fn services_answer_until_they_are_dropped() {
    let (first, second) = pair();
    let key = first.room().capabilities();
    assert_eq!(second.fetch(&key, LIMIT), Ok(vec![]));
    let answer = |payload: &mut Vec<u8>| payload.extend_from_slice(b"ten by ten");
    let service = first.serve(&key, answer).expect("a valid key");
    wait_until("a service answers", || second.fetch(&key, LIMIT) == Ok(vec![b"ten by ten".to_vec()]));
    drop(service);
    wait_until("no service answers", || second.fetch(&key, LIMIT) == Ok(vec![]));
}

#[test]
fn a_stop_published_right_before_the_close_arrives() {
    let endpoint = private_endpoint().expect("an endpoint");
    let receiving = listening(&endpoint);
    let (_subscription, receiver) = subscribed(&receiving, &room().stop());
    for number in 0..20_u8 {
        let sender = connecting(&endpoint);
        let publisher = sender.publisher(&room().stop(), Class::RealTimeBlock).expect("a valid key");
        wait_until("the subscriber is discovered", || publisher.has_subscribers().expect("the session is open"));
        publisher.put(&[number]).expect("the session is open");
        drop(publisher);
        sender.close().expect("the session closes");
        let found = receiver.recv_timeout(LIMIT);
        assert_eq!(found, Ok(vec![number]), "the close discards what was published before it");
    }
}
