//! `heliostat-lab bench env`: a step of the environment is the blockage of every path, direct and aimed gains, and gains
//! at given angles.
//!
//! The reference computes the same pair by pair with the channel's functions for one path, as a
//! script would. The two alternate, so that a drift of the machine cancels in the ratio.
//!
//! With bodies every user is a blocker, so the pairs of path and blocker grow with the square of
//! the number of users. The rows without bodies show how the rest grows.

use std::hint::black_box;
use std::time::{Duration, Instant};

use anyhow::Result;
use heliostat_channel::blockage::blocks;
use heliostat_channel::diffuse::{self, Reading};
use heliostat_channel::specular::{self, Plate};
use heliostat_channel::{ChannelModel, Cylinder, MirrorAngles, Mode, Scene, Vec3, decode, los};
use heliostat_room::world::World;
use heliostat_scenario::Scenario;
use heliostat_service::duration;
use serde::Serialize;

use heliostat_service::outln;

/// Measure environment steps a second on one core for each mode, 49 to 1024 mirrors and 5 to 40
/// users, and of rooms whose users move by social forces or hold tilted receivers.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    /// Time spent on each row, in s
    #[arg(long, value_name = "S", default_value = "1", value_parser = duration::seconds, allow_negative_numbers = true)]
    seconds: Duration,
}

/// States of a row: more than a branch predictor can learn.
const STATES: u64 = 512;
/// Users, mirrors along a side, and whether the users' own bodies block light.
const SIZES: [(usize, usize, bool); 8] = [
    (5, 7, true),
    (5, 10, true),
    (5, 32, true),
    (40, 10, true),
    (5, 10, false),
    (10, 10, false),
    (20, 10, false),
    (40, 10, false),
];
/// How often the two implementations alternate.
const TURNS: u32 = 5;

#[derive(Debug, Serialize)]
struct Row {
    mode: &'static str,
    led: &'static str,
    users: usize,
    mirrors: usize,
    bodies: bool,
    steps_per_s: f64,
    reference_steps_per_s: f64,
    ratio: f64,
}

/// Runs the benchmark.
pub fn run(args: &Args) -> Result<()> {
    let mut rows = Vec::new();
    if !args.json {
        outln!(
            "{:<18}{:<16}{:>6}{:>9}{:>8}{:>13}{:>13}{:>8}",
            "mode",
            "LED",
            "users",
            "mirrors",
            "bodies",
            "steps/s",
            "reference/s",
            "ratio"
        )?;
    }
    for (mode, panel) in [("specular", false), ("specular", true), ("paper", false), ("paper-calibrated", false)] {
        for (users, side, bodies) in SIZES {
            let mut set = super::room::overrides(users, side);
            set.push(format!("led.side_m={}", if panel { 0.1 } else { 0.0 }));
            set.push(format!("blockage.bodies={bodies}"));
            let scenario = Scenario::builtin(mode)?.with_overrides(&set)?;
            let row = measure(&scenario, args.seconds)?;
            if !args.json {
                outln!(
                    "{:<18}{:<16}{:>6}{:>9}{:>8}{:>13.0}{:>13.0}{:>8.1}",
                    row.mode,
                    row.led,
                    row.users,
                    row.mirrors,
                    if row.bodies { "yes" } else { "no" },
                    row.steps_per_s,
                    row.reference_steps_per_s,
                    row.ratio
                )?;
            }
            rows.push(row);
        }
    }
    let moving = super::moving::measure(args.seconds, args.json)?;
    if args.json {
        outln!("{}", serde_json::json!({ "rows": rows, "moving": moving }))?;
    }
    Ok(())
}

/// One state of the room, with angles to evaluate.
struct State {
    users: Vec<Vec3>,
    blockers: Vec<Cylinder>,
    angles: MirrorAngles,
}

fn measure(scenario: &Scenario, time: Duration) -> Result<Row> {
    let users = scenario.users.count;
    let model = scenario.channel_model()?;
    let states = (0..STATES).map(|seed| state(scenario, &model, seed)).collect::<Result<Vec<_>>>()?;
    let mut scene = Scene::new(&model, users);
    let (mut gains, forced) = (vec![0.0; users], vec![false; users]);
    let mut fast = Pace::default();
    let mut slow = Pace::default();
    for _ in 0..TURNS {
        fast.run(&states, time / (2 * TURNS), |state| {
            scene.update(&model, &state.users, &state.blockers, &forced);
            scene.irs_gain(&model, &state.angles, &mut gains);
            black_box(&gains);
        });
        slow.run(&states, time / (2 * TURNS), |state| {
            black_box(reference(&model, state));
        });
    }
    let (steps_per_s, reference_steps_per_s) = (fast.per_second(), slow.per_second());
    Ok(Row {
        mode: scenario.channel.mode.name(),
        led: if scenario.led.side_m > 0.0 { "5 x 5 points" } else { "point" },
        users,
        mirrors: model.mirrors.len(),
        bodies: scenario.blockage.bodies,
        steps_per_s,
        reference_steps_per_s,
        ratio: steps_per_s / reference_steps_per_s,
    })
}

/// Users, obstacles and bodies as the simulator places them; the mirrors serve the users in turn.
fn state(scenario: &Scenario, model: &ChannelModel, seed: u64) -> Result<State> {
    let world = World::new(scenario, scenario.read_trace()?.as_deref(), seed)?;
    let served: Vec<usize> = (0..model.mirrors.len()).map(|mirror| mirror % scenario.users.count).collect();
    let mut angles = MirrorAngles::flat(served.len());
    decode::aim(model, world.scene(), &served, &mut angles);
    Ok(State { users: world.positions().to_vec(), blockers: world.blockers().to_vec(), angles })
}

/// Number of steps and the time that they took.
#[derive(Default)]
struct Pace {
    steps: u64,
    spent: Duration,
}

impl Pace {
    fn run(&mut self, states: &[State], time: Duration, mut step: impl FnMut(&State)) {
        let start = Instant::now();
        while start.elapsed() < time {
            // The clock is read once every 16 steps, so that its cost does not count.
            for state in states.iter().cycle().skip(self.steps as usize % states.len()).take(16) {
                step(state);
            }
            self.steps += 16;
        }
        self.spent += start.elapsed();
    }

    fn per_second(&self) -> f64 {
        self.steps as f64 / self.spent.as_secs_f64()
    }
}

/// The same step, pair by pair: direct gain, gain of the aimed mirror, gain at the given angles.
fn reference(model: &ChannelModel, state: &State) -> f64 {
    let (led, receiver, branch) = (&model.leds[0], &model.receiver, &model.receiver.branches[0]);
    let clear = |a: &Vec3, b: &Vec3| !state.blockers.iter().any(|cylinder| blocks(cylinder, a, b));
    let mut total = 0.0;
    for user in &state.users {
        if clear(&led.position, user) {
            total += los::gain(led, receiver, branch, user).unwrap_or_default();
        }
        for (mirror, centre) in model.mirrors.positions().iter().enumerate() {
            if !(clear(&led.position, centre) && clear(centre, user)) {
                continue;
            }
            let aimed =
                specular::bisector(centre, &led.position, user).map(|normal| model.mirrors.angles_of(mirror, &normal));
            let given = (state.angles.roll[mirror], state.angles.yaw[mirror]);
            total += pair(model, mirror, aimed.unwrap_or_default(), user) + pair(model, mirror, given, user);
        }
    }
    total
}

fn pair(model: &ChannelModel, mirror: usize, (roll, yaw): (f64, f64), user: &Vec3) -> f64 {
    let (led, receiver, branch) = (&model.leds[0], &model.receiver, &model.receiver.branches[0]);
    match model.mode {
        Mode::Specular => {
            let plate = Plate::of(&model.mirrors, mirror, roll, yaw);
            let reflectivity = model.mirrors.reflectivity(mirror);
            specular::gain(led, &plate, reflectivity, (receiver, branch), user).unwrap_or_default()
        }
        Mode::Paper { .. } => {
            diffuse::gain(Reading::Sensible, (led, &model.mirrors, mirror), (roll, yaw), (receiver, branch), user)
        }
    }
}
