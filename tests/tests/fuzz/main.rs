//! Fuzz targets: for any payload and any file, no process crashes, hangs, or
//! allocates without bound, and a stopped array does not move. They have a process of their own,
//! because bolero replaces the panic hook.
//!
//! Each target is a test of [bolero](https://docs.rs/bolero). Plain `cargo test` replays the files
//! in `__fuzz__/TARGET/crashes` and `__fuzz__/TARGET/corpus`, and then tries random inputs for
//! [`SECONDS`]; `BOLERO_RANDOM_TEST_TIME_MS` sets another time. `cargo bolero test -p
//! heliostat-tests --test fuzz NAME` runs the same target under libFuzzer, guided by coverage. It
//! writes crashes to the same folders.
//!
//! - [`script`]: reads an input as a list of choices.
//! - [`forge`]: payloads as an attacker sends them.
//! - [`bench_device`] and [`room`]: the real state machines, and what must always hold.
//! - [`files`]: the readers of files; [`onnx_edits`]: edits that keep an ONNX file well-formed.
//! - [`bounds`]: limits of time and memory for one input.
//! - [`long_run`]: many payloads, and a page with the result; [`tally`]: their counts.

mod bench_device;
mod bounds;
mod files;
mod forge;
mod long_run;
mod onnx_edits;
mod room;
mod script;
mod tally;

use std::time::Duration;

use bounds::within_bounds;

/// Time of each target in a run of all tests, in s.
const SECONDS: u64 = 4;

/// Longest random input in bytes.
const INPUT_MAX: usize = 1024;

/// Runs a target: the name of its folder, and what it does with an input.
macro_rules! target {
    ($name:literal, $run:expr) => {
        bolero::check!(name = $name)
            .with_test_time(Duration::from_secs(SECONDS))
            .with_max_len(INPUT_MAX)
            .for_each(|input: &[u8]| within_bounds(input, || $run(input)))
    };
}

#[test]
fn a_room_stays_sound_and_works_again_after_payloads_on_every_key() {
    target!("payloads", |input| _ = long_run::attack_and_recover(input));
}

#[test]
fn a_scenario_is_read_or_refused() {
    target!("scenario", files::scenario);
}

#[test]
fn a_recorded_walk_is_read_or_refused() {
    target!("trace", files::trace);
}

#[test]
fn a_calibration_or_driver_configuration_is_read_or_refused() {
    target!("configuration", files::configuration);
}

#[test]
fn a_recording_is_replayed_or_refused() {
    target!("recording", files::recording);
}

#[test]
fn an_actor_is_loaded_or_refused() {
    target!("actor", files::actor);
}
