//! The fault campaign: one test for each row of the table of faults in docs/faults.md.
//!
//! `HELIOSTAT_WRITE_FAULTS=1` writes the measured effects to the page, and
//! `HELIOSTAT_FAULT_RUNS=N` repeats each fault.

mod building;
mod clocks;
mod devices;
mod disks;
mod duplicates;
mod network;
mod page;
mod payloads;
mod processes;
mod stops;
mod takeovers;

use std::time::Duration;

use heliostat_tests::faults::page::{Origin, record};
use heliostat_tests::faults::{Effect, Fault};
use heliostat_tests::{Pauses, Process};

/// A pause of the machine above this time explains an effect beyond the bound: a command is valid for 200 ms.
const PAUSE_MAX: Duration = Duration::from_millis(150);

/// Runs of a fault whose effect a pause of the machine explains.
const RUNS_MAX: usize = 5;

/// Measures the effect of the fault of a test, and compares it with the bound.
fn measure(test: &str, mut run: impl FnMut() -> Effect) {
    let fault = Fault::of(test);
    let runs = std::env::var("HELIOSTAT_FAULT_RUNS").map_or(1, |runs| runs.parse().expect("a number of runs"));
    let effects: Vec<Effect> = (0..runs).map(|_| without_pause(fault, &mut run)).collect();
    effects.iter().for_each(|effect| println!("{test}: {effect:?}"));
    if std::env::var_os("HELIOSTAT_WRITE_FAULTS").is_some() {
        record(fault, &effects, &Origin::here());
    }
    for effect in &effects {
        fault.promise.check(effect).unwrap_or_else(|problem| panic!("{}: {problem}", fault.action));
    }
}

/// The effect of a fault; it is measured again where it is beyond the bound and the machine has paused.
fn without_pause(fault: &Fault, mut run: impl FnMut() -> Effect) -> Effect {
    for _ in 1..RUNS_MAX {
        let pauses = Pauses::start();
        let effect = run();
        let longest = pauses.longest();
        match fault.promise.check(&effect) {
            Err(problem) if longest > PAUSE_MAX => {
                println!("measured again, the machine paused for {longest:?}: {problem}");
            }
            _ => return effect,
        }
    }
    run()
}

fn wait_s(seconds: f64) {
    std::thread::sleep(Duration::from_secs_f64(seconds));
}

/// Freezes a process for a time.
fn freeze(process: &Process, seconds: f64) {
    process.signal("STOP");
    wait_s(seconds);
    process.signal("CONT");
}
