//! Nothing is allocated between the first byte of a payload and the last byte of the command.

use allocation_counter::measure;
use clap::ValueEnum;
use heliostat_channel::MirrorAngles;
use heliostat_core::{
    core::{DegradedMode, Timing},
    policy::{Policy, PolicyKind},
    refusal::Stream,
    room_core::{Input, InputKey, Output, Publish, RoomCore, RoomSettings},
    tenure::Tenure,
};
use heliostat_proto::{Obstacle, encode};
use heliostat_scenario::Scenario;

use crate::support::{Room, build, scenario};

fn large() -> Scenario {
    scenario(&["mirrors.rows=10", "mirrors.columns=10", "control.slew_deg_per_s=6000"])
}

/// Survey, orientations, gains and positions of a tick.
type Payloads = [Vec<u8>; 4];

/// The payloads of a tick with these users, of whom some report orientations.
fn encoded(room: &mut Room, tick: u64, obstacles: Vec<Obstacle>, users: &[u32], held: &[u32]) -> Payloads {
    let (gains, positions) = (room.gains_of(tick, 1e-6, users), room.positions_of(tick, users));
    let mut payloads = Payloads::default();
    encode(&room.survey(tick, obstacles), &mut payloads[0]).unwrap();
    encode(&room.orientations_of(tick, 0.5, held), &mut payloads[1]).unwrap();
    encode(&gains, &mut payloads[2]).unwrap();
    encode(&positions, &mut payloads[3]).unwrap();
    payloads
}

/// The payloads of some ticks, made before anything is measured.
fn payloads() -> Vec<Payloads> {
    let mut room = Room::new(&scenario(&[]));
    let pillar = Obstacle { x_m: 1.0, y_m: 0.5, radius_m: 0.25, height_m: 1.75 };
    (1..=60).map(|tick| encoded(&mut room, tick, vec![pillar; 3], &[0, 1, 2], &[2, 0])).collect()
}

/// Counts the commands.
struct Commands(u64);

impl Publish for Commands {
    fn publish(&mut self, output: Output, _payload: &[u8]) {
        self.0 += u64::from(matches!(output, Output::Command(_)));
    }
}

fn core(scenario: &Scenario, policy: Box<dyn Policy>) -> RoomCore {
    RoomCore::new(scenario, policy, RoomSettings::new(3, Tenure::fixed(7))).unwrap()
}

fn tick(core: &mut RoomCore, tick: u64, payloads: &Payloads) {
    let (now, mut commands) = (Room::time(tick), Commands(0));
    let streams = [Stream::Obstacles, Stream::Orientation, Stream::Channel, Stream::Users];
    for (stream, bytes) in streams.into_iter().zip(payloads) {
        core.handle(now, Input::Payload { key: InputKey::Report(stream.into()), bytes }, &mut commands);
    }
    core.decide(now, Timing::InTime, &mut |_| {}, &mut commands);
    assert_eq!(commands.0, 1, "tick {tick}");
}

/// Allocations in each of the last ticks, after the first have sized all buffers.
fn allocations(mut core: RoomCore) -> Vec<u64> {
    let payloads = payloads();
    let ticks = (1..).zip(&payloads);
    let counts = ticks.map(|(number, payloads)| measure(|| tick(&mut core, number, payloads)).count_total);
    counts.skip(20).collect()
}

#[test]
fn no_policy_allocates() {
    let scenario = large();
    // The exhaustive search cannot run in a large room, and is no policy for a tick anywhere.
    for kind in PolicyKind::value_variants().iter().filter(|kind| **kind != PolicyKind::Exhaustive) {
        let counts = allocations(core(&scenario, build(*kind, &scenario).unwrap()));
        assert!(counts.len() == 40 && counts.iter().all(|count| *count == 0), "{kind:?}: {counts:?}");
    }
}

/// Users who come and go: one at first, then up to the largest number of the contract, and none.
fn crowds() -> Vec<Payloads> {
    let mut room = Room::new(&scenario(&[]));
    (1..=26)
        .map(|tick| {
            let count = if tick < 6 { 1 } else { [3, 2, 5, 0, 12, 1, 64][tick as usize % 7] };
            let mut ids: Vec<u32> = (0..count).map(|user| u32::MAX - user * 7 - tick as u32 % 3).collect();
            if tick % 2 == 0 {
                ids.reverse();
            }
            encoded(&mut room, tick, Vec::new(), &ids, &ids)
        })
        .collect()
}

/// Lets a policy decide for the crowds; nothing may be allocated once the room was not empty.
fn assert_no_allocation_for_crowds(scenario: &Scenario, kind: PolicyKind) {
    let mut core = core(scenario, build(kind, scenario).unwrap());
    core.warm_up(0..2);
    for (number, payloads) in (1..).zip(&crowds()) {
        let counted = measure(|| tick(&mut core, number, payloads)).count_total;
        assert!(number < 5 || counted == 0, "{kind:?}, tick {number}: {counted}");
    }
    let controller = core.controller();
    let failed = controller.counters().degraded(DegradedMode::PolicyFailed);
    let counted = (controller.counters().commands, failed, controller.inbox().refused().total());
    assert_eq!(counted, (26, 0, 0), "{kind:?}");
}

#[test]
fn users_who_come_and_go_do_not_make_the_decision_allocate() {
    let small = ["mirrors.rows=4", "mirrors.columns=4"];
    for kind in PolicyKind::value_variants().iter().filter(|kind| **kind != PolicyKind::Exhaustive) {
        assert_no_allocation_for_crowds(&scenario(&small), *kind);
    }
    for belief in ["constant-velocity", "filter"] {
        let scenario = scenario(&[&small[..], &[&format!("control.belief={belief}")]].concat());
        assert_no_allocation_for_crowds(&scenario, PolicyKind::FixedPoint);
    }
}

#[test]
fn the_counter_sees_allocations() {
    assert_eq!(measure(|| drop(std::hint::black_box(vec![1u8; 100]))).count_total, 1);
}

#[test]
fn a_failing_policy_does_not_make_the_fallback_allocate() {
    let scenario = large();
    let failing = crate::support::Scripted(|_, out: &mut MirrorAngles| {
        out.roll[3] = f64::NAN;
        Ok(())
    });
    assert_eq!(allocations(core(&scenario, Box::new(failing))), [0; 40]);
}
