//! The whole system in one thread, in virtual time, from one seed.
//!
//! The production code that decides runs unchanged: the controller of a room from payloads to payloads,
//! the array's side of the contract, the record of stops, the rule of an operator, the session of a
//! calibration, and the replay of recorded inputs. The
//! harness owns time, network, disks and devices. There is no thread, no sleep and no wall clock, so a
//! seed is a complete run, and a run that fails can be repeated.
//!
//! # Hosts
//!
//! | host | runs | replaced |
//! | --- | --- | --- |
//! | tracker | reports of positions, of gains in half of the seeds; users come and go | the tracker |
//! | 1 or 2 arrays | `Station`, with its queue, stop record and rules | device, disk, transport |
//! | 1 to 3 controllers | `RoomCore`, and a replay from the states that it publishes | transport, threads |
//! | operator | `ReportedStops`, the rule of page and command line for "stopped" | page and command line |
//! | calibration, in some plans | `Commander` and `Session` of `heliostat calibrate --take-over` | transport, files |
//! | attacker | truncated, foreign, stale, repeated and forged payloads | |
//!
//! Each host has a clock of its own: an offset, a rate, and steps of UTC.
//!
//! Viewers and recorders are left to real processes: they publish nothing to controllers and arrays, and a
//! simulated link has no queue that a slow receiver could fill. `tests/tests/faults` and `frozen_viewers.rs`
//! have them frozen, killed and with a full disk.
//!
//! # Time
//!
//! | what takes time | model |
//! | --- | --- |
//! | a message | a delay of its link, and jitter; a connection keeps the order |
//! | a link that was cut | retransmissions of TCP, the lease and the attempts to connect: `world/connections.rs` |
//! | a backlog of a controller | two threads share it: `world/backlog.rs` |
//! | processes of a busy machine | pauses, in the table of effects: `world/pauses.rs` |
//!
//! # Faults
//!
//! A plan is a list of [`Timed`] faults, drawn from the seed. Links lose, delay, repeat and
//! reorder messages, and are cut with or without delivery afterwards. Processes crash, with or without
//! their disk, freeze, and end in order. Clocks step and run at a wrong rate. Disks are full or tear a
//! record. Devices fail, block, refuse angles or stops, or are silent. Policies are slow or fail.
//! Receivers fall silent. The operator stops and re-arms, by name and by time. The attacker publishes.
//! An array is calibrated.
//! Some faults are drawn together, because a random plan would seldom combine them.
//!
//! # Invariants
//!
//! [`Invariant`] lists what is checked after each event. The models in `monitor` are written from
//! CONTRACT.md and read the payloads as they arrived.
//!
//! [`Mutation`] lists deliberate bugs. A test shows that each of them is found.
//!
//! # A seed again
//!
//! A seed that fails prints itself, the smallest part of its plan that fails alone, and the last events.
//!
//! ```text
//! HELIOSTAT_SIM_SEED=123 cargo test --release -p heliostat-simulation --test seeds
//! HELIOSTAT_SIM_SECONDS=600 cargo test --release -p heliostat-simulation --test seeds -- --nocapture
//! ```
//!
//! The second command runs fresh seeds for ten minutes. Add the part of a plan that found a defect to
//! `tests/scenarios.rs`, with a name that states what holds.

mod clock;
pub mod effects;
mod hosts;
mod monitor;
mod mutation;
mod network;
pub mod plan;
mod random;
mod room;
mod shrink;
mod topic;
mod trace;
mod violation;
mod world;

use std::fmt::Write;

pub use mutation::Mutation;
pub use violation::{Invariant, Violation};
pub use world::Outcome;

use plan::{Setup, Timed};

/// Runs the plan of a seed.
pub fn run_seed(seed: u64, mutation: Option<Mutation>) -> Outcome {
    let setup = Setup::draw(seed);
    world::run(&setup, &plan::draw(&setup), mutation, false)
}

/// Runs faults in a room.
pub fn run_plan(setup: &Setup, faults: &[Timed]) -> Outcome {
    world::run(setup, faults, None, true)
}

/// What a developer needs of a seed that fails: the violation, the smallest part of its plan, and the
/// last events; `None` if it does not fail.
pub fn report(seed: u64, mutation: Option<Mutation>) -> Option<String> {
    let setup = Setup::draw(seed);
    let faults = plan::draw(&setup);
    let found = world::run(&setup, &faults, mutation, false).violation?;
    let fails = |faults: &[Timed]| {
        let violation = world::run(&setup, faults, mutation, false).violation;
        violation.is_some_and(|violation| violation.invariant == found.invariant)
    };
    let least = shrink::shrink(&faults, fails);
    let Outcome { violation, trace, .. } = world::run(&setup, &least, mutation, true);
    let mut text = format!("seed {seed} fails: {found}\n{setup:?}\nits smallest failing part:\n");
    for timed in &least {
        let _ = writeln!(text, "    {timed},");
    }
    if let Some(violation) = violation {
        let _ = writeln!(text, "with it alone: {violation}");
    }
    let _ = writeln!(text, "the last events:\n{}", trace.join("\n"));
    let _ = write!(text, "again: HELIOSTAT_SIM_SEED={seed} cargo test --release -p heliostat-simulation --test seeds");
    Some(text)
}
