//! Runs the four environments, two of them with several forms of action; the Python package compares its own runs with it.
//!
//! `cargo run --release -p heliostat-environment --example trajectory -- STEPS FILE [NAME [ROOMS]]`
//! writes, for each step of each environment or of the named one, the reward, the sum rate and the
//! observation as little-endian numbers, and prints the steps per second of each. With ROOMS, so
//! many rooms of successive seeds step in turn on one thread.

use std::error::Error;
use std::io::Write;
use std::sync::Arc;
use std::time::Instant;

use heliostat_environment::action::ActionForm;
use heliostat_environment::room::{Reward, RewardForm};
use heliostat_environment::task::{ObservationForm, Task, TaskSettings};
use heliostat_scenario::Scenario;

/// Seed of the first room of every environment.
const SEED: u64 = 7;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let (Some(steps), Some(file)) = (arguments.next(), arguments.next()) else {
        return Err("expected the number of steps, and the file to write".into());
    };
    let (only, rooms) = (arguments.next(), arguments.next());
    let steps: usize = steps.parse()?;
    let rooms: u64 = rooms.map_or(Ok(1), |rooms| rooms.parse())?;
    if rooms == 0 {
        return Err("ROOMS = 0: expected an integer from 1".into());
    }
    let mut out = std::io::BufWriter::new(std::fs::File::create(file)?);
    let of = |name| Scenario::builtin(name);
    let paper = TaskSettings {
        observation: ObservationForm::AngleState,
        reward: Reward { form: RewardForm::AsPrinted, lambda: 1.0, margin: 1.0 },
        ..TaskSettings::of_true_state(of("paper")?)
    };
    let weights = TaskSettings { action: ActionForm::Weights, ..TaskSettings::of_true_state(of("specular")?) };
    let hall = TaskSettings::closed_loop(of("hall")?);
    for (name, settings) in [
        ("static", TaskSettings::of_true_state(of("specular")?)),
        ("static with weights", weights),
        ("hall", hall.clone()),
        ("hall with weights", TaskSettings { action: ActionForm::Weights, ..hall.clone() }),
        ("office", TaskSettings::closed_loop(of("office")?)),
        ("paper", paper),
    ] {
        if only.as_ref().is_some_and(|only| only != name) {
            continue;
        }
        let settings = Arc::new(settings);
        let mut tasks =
            (0..rooms).map(|room| Task::new(Arc::clone(&settings), SEED + room)).collect::<Result<Vec<_>, _>>()?;
        let (mut action, mut seen) = (vec![0.0; tasks[0].action_len()], vec![0.0; tasks[0].observation_len()]);
        let mut elapsed_s = 0.0;
        for step in 0..steps {
            for (index, value) in action.iter_mut().enumerate() {
                *value = ((index * 7 + step * 3) % 11) as f32 / 10.0 - 0.5;
            }
            for task in &mut tasks {
                let begun = Instant::now();
                let result = task.step(&action)?;
                task.write_observation(&mut seen);
                elapsed_s += begun.elapsed().as_secs_f64();
                out.write_all(&result.reward.to_le_bytes())?;
                out.write_all(&result.sum_rate_mbps.to_le_bytes())?;
                seen.iter().try_for_each(|value| out.write_all(&value.to_le_bytes()))?;
            }
        }
        println!("{name}: {:.0} steps/s", (steps * tasks.len()) as f64 / elapsed_s);
    }
    out.flush()?;
    Ok(())
}
