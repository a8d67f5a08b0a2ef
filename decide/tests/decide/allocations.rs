//! Nothing is allocated between the first byte of a payload and the last byte of the command; what the inference engine
//! allocates is its own, and is measured against the engine alone.

use std::{path::Path, sync::mpsc, time::Duration};

use allocation_counter::measure;
use clap::ValueEnum;
use heliostat_bus::{Bus, BusConfig, Class, free_loopback_endpoint};
use heliostat_channel::MirrorAngles;
use heliostat_controller::{
    core::{Controller, Decision},
    inbox::Message,
    policy::{Actor, ActorSource, PolicyKind, actor_file::ActorFile, build},
};
use heliostat_proto::{ChannelReport, Obstacle, ObstacleReport, Room as RoomName, UserReport, decode_into, encode};
use heliostat_scenario::Scenario;

use crate::support::{ActorRecipe, Room, controller, scenario};

fn large() -> Scenario {
    scenario(&["mirrors.rows=10", "mirrors.columns=10", "control.slew_deg_per_s=6000"])
}

fn actor_of(scenario: &Scenario) -> ActorFile {
    ActorRecipe::fitting(scenario).file()
}

/// The payloads of some ticks, made before anything is measured.
fn payloads(scenario: &Scenario) -> Vec<[Vec<u8>; 3]> {
    let mut room = Room::new(scenario);
    let bytes = |message: &dyn Fn(&mut Vec<u8>)| {
        let mut payload = Vec::new();
        message(&mut payload);
        payload
    };
    (1..=60)
        .map(|tick| {
            let pillar = Obstacle { x_m: 1.0, y_m: 0.5, radius_m: 0.25, height_m: 1.75 };
            let (gains, users) = (room.gains(tick, 1e-6), room.positions(tick));
            let survey = room.survey(tick, vec![pillar; 3]);
            [
                bytes(&|out| encode(&survey, out).unwrap()),
                bytes(&|out| encode(&gains, out).unwrap()),
                bytes(&|out| encode(&users, out).unwrap()),
            ]
        })
        .collect()
}

/// What is reused from tick to tick at the edge.
#[derive(Default)]
struct Scratch {
    obstacles: ObstacleReport,
    channel: ChannelReport,
    users: UserReport,
    payload: Vec<u8>,
}

fn tick(controller: &mut Controller, scratch: &mut Scratch, tick: u64, [survey, gains, users]: &[Vec<u8>; 3]) {
    let now = Room::time(tick);
    decode_into(&mut scratch.obstacles, survey).unwrap();
    controller.receive(now, Message::Obstacles(&mut scratch.obstacles), &mut |_| {});
    decode_into(&mut scratch.channel, gains).unwrap();
    controller.receive(now, Message::Channel(&mut scratch.channel), &mut |_| {});
    decode_into(&mut scratch.users, users).unwrap();
    match controller.receive(now, Message::Users(&mut scratch.users), &mut |_| {}) {
        Some(Decision::Move { command, .. }) => encode(command, &mut scratch.payload).unwrap(),
        other => panic!("wanted a command, got {other:?}"),
    }
}

/// Allocations in each of the last ticks, after the first have sized all buffers.
fn allocations(scenario: &Scenario, kind: PolicyKind) -> Vec<u64> {
    let source = ActorSource::Bytes(actor_of(scenario));
    let mut controller = controller(scenario, build(kind, scenario, &source).unwrap());
    let mut scratch = Scratch::default();
    let payloads = payloads(scenario);
    let counts = payloads.iter().enumerate().map(|(index, payloads)| {
        measure(|| tick(&mut controller, &mut scratch, index as u64 + 1, payloads)).count_total
    });
    counts.skip(20).collect()
}

#[test]
fn no_policy_of_our_own_allocates() {
    let scenario = large();
    // The exhaustive search cannot run in a large room, and is no policy for a tick anywhere.
    let ours = |kind: &&PolicyKind| !kind.is_learned() && **kind != PolicyKind::Exhaustive;
    for kind in PolicyKind::value_variants().iter().filter(ours) {
        let counts = allocations(&scenario, *kind);
        assert!(counts.len() == 40 && counts.iter().all(|count| *count == 0), "{kind:?}: {counts:?}");
    }
}

#[test]
fn rehearsals_do_not_allocate() {
    let scenario = large();
    for kind in [PolicyKind::FixedPoint, PolicyKind::Greedy, PolicyKind::Nearest] {
        let mut controller = controller(&scenario, build(kind, &scenario, &ActorSource::Shipped).unwrap());
        let mut scratch = Scratch::default();
        for (index, payloads) in payloads(&scenario).iter().enumerate().take(5) {
            tick(&mut controller, &mut scratch, index as u64 + 1, payloads);
        }
        controller.rehearse();
        assert_eq!(measure(|| controller.rehearse()).count_total, 0, "{kind:?}");
    }
}

/// What the transport allocates on the deciding thread for one command, told for who wants to know; it is not ours to change.
#[test]
fn a_publication_allocates_little() {
    let room = RoomName::new("allocations").unwrap();
    let endpoint = free_loopback_endpoint().unwrap();
    let here = Bus::open(&BusConfig::new(room.clone()).listen_at(&endpoint)).unwrap();
    let there = Bus::open(&BusConfig::new(room.clone()).connect_to(&endpoint)).unwrap();
    let (heard, hears) = mpsc::channel();
    let _subscription =
        there.subscribe(&room.command(), move |payload| heard.send(payload.len()).unwrap_or_default()).unwrap();
    let publisher = here.publisher(&room.command(), Class::Control).unwrap();
    let payload = vec![0; 820];
    while hears.recv_timeout(Duration::from_millis(50)).is_err() {
        publisher.put(&payload).unwrap();
    }
    let counted = measure(|| publisher.put(&payload).unwrap());
    println!("Zenoh allocates {} times, {} bytes, for a put of 820 bytes", counted.count_total, counted.bytes_total);
    assert!((1..100).contains(&counted.count_total), "{counted:?}");
}

#[test]
fn the_counter_sees_allocations() {
    assert_eq!(measure(|| drop(std::hint::black_box(vec![1u8; 100]))).count_total, 1);
}

#[test]
fn with_an_actor_only_the_engine_allocates() {
    let scenario = large();
    let bare = bare_engine_allocations(&actor_of(&scenario), &scenario).0;
    let counts = allocations(&scenario, PolicyKind::Ddpg);
    println!("the inference engine allocates {bare} times a run of the test's network");
    assert!(bare > 0 && counts.iter().all(|count| *count == bare), "engine alone {bare}, with us {counts:?}");
}

/// Allocations of one run of the engine on a network, and their bytes, without anything of ours.
fn bare_engine_allocations(file: &ActorFile, scenario: &Scenario) -> (u64, u64) {
    let mut actor = Actor::load(file, scenario).unwrap();
    (0..20).for_each(|_| actor.run_engine_alone().unwrap());
    let run = measure(|| actor.run_engine_alone().unwrap());
    (run.count_total, run.bytes_total)
}

/// What the engine allocates for the actor that is shipped, told for who wants to know; it is not ours to change.
#[test]
fn what_the_engine_allocates_for_the_shipped_actor_does_not_grow() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../models/actors/ddpg-specular-10x10.onnx");
    let file = ActorFile::read(&file).unwrap();
    let scenario = Scenario::builtin("specular").unwrap();
    let (count, bytes) = bare_engine_allocations(&file, &scenario);
    println!("the inference engine allocates {count} times a run of the shipped actor, {bytes} bytes in all");
    assert_eq!((count, bytes), bare_engine_allocations(&file, &scenario));
}

#[test]
fn a_failing_policy_does_not_make_the_fallback_allocate() {
    let scenario = large();
    let failing = crate::support::Scripted(|_, out: &mut MirrorAngles| {
        out.roll[3] = f64::NAN;
        Ok(())
    });
    let mut controller = controller(&scenario, Box::new(failing));
    let mut scratch = Scratch::default();
    for (index, payloads) in payloads(&scenario).iter().enumerate() {
        let counted = measure(|| tick(&mut controller, &mut scratch, index as u64 + 1, payloads)).count_total;
        assert!(index < 20 || counted == 0, "tick {index}: {counted}");
    }
}
