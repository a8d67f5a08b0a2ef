//! The part of `heliostat-lab bench env` about moving users: steps of a room in which users move by social
//! forces and hold tilted receivers, beside the same room with random waypoints and upright receivers.
//!
//! A step moves the users on and updates the scene. The forces have a grid of 20 ms and the
//! orientations nodes every 5 ms, so that their cost grows with the duration of a step.

use std::time::{Duration, Instant};

use anyhow::Result;
use heliostat_room::world::World;
use heliostat_scenario::Scenario;
use serde::Serialize;

use heliostat_service::outln;

/// Durations of a step in s: that of the reports, and of ten of them.
const STEPS_S: [f64; 2] = [0.01, 0.1];
/// What differs from the reference.
const MOVEMENTS: [(&str, &[&str]); 3] = [
    ("orientation", &["users.orientation.model=measured"]),
    ("social force", &["users.mobility=social-force"]),
    ("both", &["users.mobility=social-force", "users.orientation.model=measured"]),
];
/// How often the two rooms alternate.
const TURNS: u32 = 20;
/// Steps between two readings of the clock.
const STEPS: u32 = 16;

/// The speed of one room.
#[derive(Debug, Serialize)]
pub struct MovingRow {
    /// What differs from the reference.
    movement: &'static str,
    /// Duration of a step in s.
    step_s: f64,
    steps_per_s: f64,
    reference_steps_per_s: f64,
    ratio: f64,
}

/// Measures every row for a time, and prints it unless `json`.
pub fn measure(time: Duration, json: bool) -> Result<Vec<MovingRow>> {
    let mut rows = Vec::new();
    if !json {
        outln!("\n{:<14}{:>8}{:>13}{:>13}{:>8}", "movement", "step in s", "steps/s", "plain/s", "ratio")?;
    }
    for step_s in STEPS_S {
        for (movement, set) in MOVEMENTS {
            let row = row(movement, set, step_s, time)?;
            if !json {
                let MovingRow { steps_per_s, reference_steps_per_s, ratio, .. } = row;
                outln!("{movement:<14}{step_s:>9}{steps_per_s:>13.0}{reference_steps_per_s:>13.0}{ratio:>8.2}")?;
            }
            rows.push(row);
        }
    }
    Ok(rows)
}

fn row(movement: &'static str, set: &[&str], step_s: f64, time: Duration) -> Result<MovingRow> {
    let world =
        |set: &[&str]| -> Result<World> { Ok(World::new(&Scenario::builtin("hall")?.with_overrides(set)?, None, 1)?) };
    let (mut measured, mut reference) = ((world(set)?, 0, Duration::ZERO), (world(&[])?, 0, Duration::ZERO));
    for _ in 0..TURNS {
        for (world, steps, spent) in [&mut measured, &mut reference] {
            let start = Instant::now();
            while start.elapsed() < time / (2 * TURNS) {
                (0..STEPS).for_each(|_| world.step(step_s));
                *steps += STEPS;
            }
            *spent += start.elapsed();
        }
    }
    let [steps_per_s, reference_steps_per_s] =
        [&measured, &reference].map(|(_, steps, spent)| f64::from(*steps) / spent.as_secs_f64());
    Ok(MovingRow { movement, step_s, steps_per_s, reference_steps_per_s, ratio: steps_per_s / reference_steps_per_s })
}
