//! Environment steps a second on one core: scene update and gains at given angles, beside a straightforward
//! implementation of the same that calls the functions of one path for every pair.
//!
//! `cargo bench -p heliostat-channel`. Times depend on the machine; the ratio is what to compare.

#[path = "../tests/common/mod.rs"]
mod common;

use common::{PAPER, Random, Room};
use heliostat_channel::blockage::blocks;
use heliostat_channel::decode::aim;
use heliostat_channel::diffuse::{self, Reading};
use heliostat_channel::specular::{self, Plate};
use heliostat_channel::{ChannelModel, Cylinder, MirrorAngles, Mode, Scene, Vec3, los};
use std::hint::black_box;
use std::time::Instant;

const STATES: usize = 640;

struct State {
    users: Vec<Vec3>,
    blockers: Vec<Cylinder>,
    angles: MirrorAngles,
}

fn main() {
    println!("{:<32} {:>4} {:>6} {:>12} {:>12} {:>7}", "mode", "K", "M", "steps/s", "reference/s", "ratio");
    let rooms = [
        ("specular, point LED", Room::paper()),
        ("specular, panel of 5 x 5 points", Room::paper().with_panel()),
        ("paper", Room::paper().with_mode(PAPER)),
    ];
    for (name, room) in &rooms {
        for side in [7, 10, 32] {
            compare(name, room, 5, side);
        }
    }
    for users in [10, 20, 40] {
        compare(rooms[0].0, &rooms[0].1, users, 10);
    }
}

/// Prints one line for an array of `side` x `side` mirrors.
fn compare(name: &str, room: &Room, users: usize, side: usize) {
    let mut room = room.clone();
    (room.array.rows, room.array.columns) = (side, side);
    if side == 32 {
        (room.array.mirror_width_m, room.array.mirror_height_m, room.array.gap_m) = (0.1, 0.04, 0.005);
    }
    let model = room.model();
    let states: Vec<State> = (0..STATES).map(|seed| state(&model, users, seed as u64)).collect();
    let mut scene = Scene::new(&model, users);
    let (mut gains, forced) = (vec![0.0; users], vec![false; users]);
    let fast = steps_per_second(|step| {
        let state = &states[step % STATES];
        scene.update(&model, &state.users, &state.blockers, &forced);
        scene.irs_gain(&model, &state.angles, &mut gains);
        black_box(&gains);
    });
    let slow = steps_per_second(|step| {
        black_box(reference(&model, &states[step % STATES]));
    });
    println!("{name:<32} {users:>4} {:>6} {fast:>12.0} {slow:>12.0} {:>7.1}", side * side, fast / slow);
}

/// Users, obstacles and bodies at random; each mirror aimed at somebody.
fn state(model: &ChannelModel, count: usize, seed: u64) -> State {
    let mut random = Random::new(seed);
    let users = random.positions(count);
    let blockers = random.blockers(&users);
    let mut scene = Scene::new(model, count);
    scene.update(model, &users, &blockers, &vec![false; count]);
    let served: Vec<usize> = (0..model.mirrors.len()).map(|_| random.next() as usize % count).collect();
    let mut angles = MirrorAngles::flat(served.len());
    aim(model, &scene, &served, &mut angles);
    State { users, blockers, angles }
}

/// Best of several runs of about 0.2 s.
fn steps_per_second(mut step: impl FnMut(usize)) -> f64 {
    let mut run = |steps: usize| {
        let start = Instant::now();
        (0..steps).for_each(&mut step);
        steps as f64 / start.elapsed().as_secs_f64()
    };
    let steps = (run(20) * 0.2).max(20.0) as usize;
    (0..4).map(|_| run(steps)).fold(0.0, f64::max)
}

/// The same step, pair by pair: direct gain, gain of the aimed mirror, gain at the given angles.
fn reference(model: &ChannelModel, state: &State) -> f64 {
    let (led, receiver, branch) = (&model.leds[0], &model.receiver, &model.receiver.branches[0]);
    let clear = |a: &Vec3, b: &Vec3| !state.blockers.iter().any(|cylinder| blocks(cylinder, a, b));
    let mut total = 0.0;
    for user in &state.users {
        if clear(&led.position, user) {
            total += los::gain(led, receiver, branch, user).expect("apart");
        }
        for (mirror, centre) in model.mirrors.positions().iter().enumerate() {
            if !(clear(&led.position, centre) && clear(centre, user)) {
                continue;
            }
            let aimed = specular::bisector(centre, &led.position, user).map(|normal| model.mirrors.angles_of(&normal));
            let given = (state.angles.roll[mirror], state.angles.yaw[mirror]);
            total +=
                [aimed.unwrap_or_default(), given].map(|angles| pair(model, mirror, angles, user)).iter().sum::<f64>();
        }
    }
    total
}

fn pair(model: &ChannelModel, mirror: usize, (roll, yaw): (f64, f64), user: &Vec3) -> f64 {
    let (led, receiver, branch) = (&model.leds[0], &model.receiver, &model.receiver.branches[0]);
    match model.mode {
        Mode::Specular => {
            let plate = Plate::of(&model.mirrors, mirror, roll, yaw);
            let reflectivity = model.mirrors.spec().reflectivity;
            specular::gain(led, &plate, reflectivity, (receiver, branch), user).expect("finite")
        }
        Mode::Paper { .. } => {
            let path = (led, &model.mirrors, mirror);
            diffuse::gain(Reading::Sensible, path, (roll, yaw), (receiver, branch), user)
        }
    }
}
