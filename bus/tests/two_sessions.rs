//! Two sessions in one process over a loopback port.

use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use heliostat_bus::*;
use heliostat_proto::{NodeKind, Room};

/// Long enough for a busy machine; nothing waits for it when things go well.
const PATIENCE: Duration = Duration::from_secs(20);

fn room() -> Room {
    Room::new("test").expect("a plain name")
}

fn listening(endpoint: &str) -> Bus {
    Bus::open(&BusConfig::new(room()).listen_at(endpoint)).expect("a free port")
}

fn connecting(endpoint: &str) -> Bus {
    Bus::open(&BusConfig::new(room()).connect_to(endpoint)).expect("no need that anybody answers")
}

fn pair() -> (Bus, Bus) {
    let endpoint = free_loopback_endpoint().expect("a free port");
    let first = listening(&endpoint);
    let second = connecting(&endpoint);
    (first, second)
}

/// What a subscriber to the key hears.
fn ear(bus: &Bus, key: &str) -> (Subscription, Receiver<Vec<u8>>) {
    let (sender, receiver) = channel();
    let heard = move |payload: &[u8]| {
        let _ = sender.send(payload.to_vec());
    };
    (bus.subscribe(key, heard).expect("a sound key"), receiver)
}

/// Publishes until the other side hears the payload, since declarations take a moment to travel.
fn heard(publisher: &Publisher, payload: &[u8], receiver: &Receiver<Vec<u8>>) {
    let deadline = Instant::now() + PATIENCE;
    while Instant::now() < deadline {
        publisher.put(payload).expect("the session is open");
        if receiver.recv_timeout(Duration::from_millis(50)).is_ok_and(|found| found == payload) {
            return;
        }
    }
    panic!("nobody heard the payload");
}

/// Waits for a presence of this key.
fn seen(receiver: &Receiver<(String, Presence)>, key: &str, presence: Presence) {
    let wanted = (key.to_owned(), presence);
    let found = receiver.recv_timeout(PATIENCE).expect("something changes");
    assert_eq!(found, wanted);
}

fn eye(bus: &Bus) -> (Subscription, Receiver<(String, Presence)>) {
    let (sender, receiver) = channel();
    let pattern = bus.room().all_alive();
    let watch = bus.watch(&pattern, move |key, presence| {
        let _ = sender.send((key.to_owned(), presence));
    });
    (watch.expect("a sound pattern"), receiver)
}

#[test]
fn both_hear_each_other_in_every_class() {
    let (first, second) = pair();
    for class in [Class::Control, Class::State, Class::Info, Class::Order] {
        for (from, to) in [(&first, &second), (&second, &first)] {
            let key = from.room().command();
            let (_ear, receiver) = ear(to, &key);
            let publisher = from.publisher(&key, class).expect("a sound key");
            heard(&publisher, format!("{class:?}").as_bytes(), &receiver);
        }
    }
    first.close().expect("closes");
    second.close().expect("closes");
}

#[test]
fn payloads_arrive_whole_and_in_order() {
    let (first, second) = pair();
    let (_eye, presence) = eye(&first);
    let (_ear, receiver) = ear(&second, &first.room().stop());
    // Once the token is seen, so is the subscription before it. Until then what is published may be lost, even after something was heard: a
    // fresh link is given everything at first, and then what was subscribed to.
    let key = second.room().alive(NodeKind::Controller, 1);
    let _token = second.announce(&key).expect("a sound key");
    seen(&presence, &key, Presence::Alive);
    let publisher = first.publisher(&first.room().stop(), Class::Order).expect("a sound key");
    let payload = |number: usize| vec![number as u8; 1 + number * 30_000];
    for number in 0..8 {
        publisher.put(&payload(number)).expect("open");
    }
    for number in 0..8 {
        let found = receiver.recv_timeout(PATIENCE);
        let found =
            found.unwrap_or_else(|_| panic!("payload {number}, of {} bytes, was dropped", payload(number).len()));
        assert!(found == payload(number), "in place of payload {number} came {} bytes", found.len());
    }
}

#[test]
fn patterns_give_the_key() {
    let (first, second) = pair();
    let (sender, receiver) = channel();
    let keep = move |key: &str, payload: &[u8]| {
        let _ = sender.send((key.to_owned(), payload.to_vec()));
    };
    let _ear = second.subscribe_keyed(&second.room().all_status(), keep).expect("a sound pattern");
    let key = first.room().status(NodeKind::Controller);
    let publisher = first.publisher(&key, Class::Info).expect("a sound key");
    let deadline = Instant::now() + PATIENCE;
    let found = loop {
        publisher.put(b"well").expect("open");
        match receiver.recv_timeout(Duration::from_millis(50)) {
            Ok(found) => break found,
            Err(_) => assert!(Instant::now() < deadline, "nobody heard the status"),
        }
    };
    assert_eq!(found, (key, b"well".to_vec()));
}

#[test]
fn a_dropped_subscription_hears_no_more() {
    let (first, second) = pair();
    let key = first.room().users();
    let publisher = first.publisher(&key, Class::Control).expect("a sound key");
    let (ear_1, receiver_1) = ear(&second, &key);
    let (_ear_2, receiver_2) = ear(&second, &key);
    heard(&publisher, b"both", &receiver_1);
    drop(ear_1);
    while receiver_1.try_recv().is_ok() {}
    heard(&publisher, b"one", &receiver_2);
    assert!(receiver_1.recv_timeout(Duration::from_millis(100)).is_err());
}

#[test]
fn tokens_appear_and_go() {
    let (first, second) = pair();
    let key = first.room().alive(NodeKind::SimNode, 7);
    let (_eye, receiver) = eye(&second);
    let token = first.announce(&key).expect("a sound key");
    seen(&receiver, &key, Presence::Alive);
    assert_eq!(second.alive(&second.room().alive_of(NodeKind::SimNode), PATIENCE), Ok(vec![key.clone()]));
    assert_eq!(second.alive(&second.room().alive_of(NodeKind::Driver), PATIENCE), Ok(vec![]));
    let (_late_eye, late) = eye(&second);
    seen(&late, &key, Presence::Alive);
    drop(token);
    seen(&receiver, &key, Presence::Gone);
    seen(&late, &key, Presence::Gone);
    assert_eq!(second.alive(&second.room().all_alive(), PATIENCE), Ok(vec![]));
}

#[test]
fn tokens_go_with_their_session() {
    let (first, second) = pair();
    let key = first.room().alive(NodeKind::Controller, 8);
    let (_eye, receiver) = eye(&second);
    let _token = first.announce(&key).expect("a sound key");
    seen(&receiver, &key, Presence::Alive);
    first.close().expect("closes");
    seen(&receiver, &key, Presence::Gone);
}

#[test]
fn whoever_connects_may_start_first_and_outlives_the_other() {
    let endpoint = free_loopback_endpoint().expect("a free port");
    let early = connecting(&endpoint);
    let key = early.room().users();
    let (_ear, receiver) = ear(&early, &key);
    let (_eye, presence) = eye(&early);
    for instance in 1..3 {
        let late = listening(&endpoint);
        let alive = late.room().alive(NodeKind::SimNode, instance);
        let _token = late.announce(&alive).expect("a sound key");
        seen(&presence, &alive, Presence::Alive);
        let publisher = late.publisher(&key, Class::Control).expect("a sound key");
        heard(&publisher, format!("instance {instance}").as_bytes(), &receiver);
        late.close().expect("closes");
        seen(&presence, &alive, Presence::Gone);
    }
}

#[test]
fn services_answer_and_end() {
    let (first, second) = pair();
    let key = first.room().capabilities();
    assert_eq!(second.fetch(&key, PATIENCE), Ok(vec![]));
    let answer = |payload: &mut Vec<u8>| payload.extend_from_slice(b"ten by ten");
    let service = first.serve(&key, answer).expect("a sound key");
    let deadline = Instant::now() + PATIENCE;
    while second.fetch(&key, PATIENCE) != Ok(vec![b"ten by ten".to_vec()]) {
        assert!(Instant::now() < deadline, "nobody answers");
    }
    drop(service);
    while second.fetch(&key, PATIENCE) != Ok(vec![]) {
        assert!(Instant::now() < deadline, "the service still answers");
    }
}
