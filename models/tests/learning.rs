//! A short run improves the score, and its parameters stay finite.

use heliostat_models::environment::features::{BaselineWeight, Head};
use heliostat_models::evaluation::HeldOut;
use heliostat_models::learners::ddpg::{Ddpg, Settings};
use heliostat_models::networks::on_one_thread;
use heliostat_models::training::{RunSettings, Training, checkpoint};
use heliostat_scenario::{ChannelMode, Scenario};

#[test]
fn a_short_run_learns_to_meet_minimum_rates() {
    on_one_thread(check).expect("a thread");
}

fn check() {
    let overrides = ["mirrors.rows=6", "mirrors.columns=6", "blockage.forced_users=5"].map(String::from);
    let scenario = Scenario::builtin("specular").and_then(|scenario| scenario.with_overrides(&overrides));
    let scenario = scenario.expect("a valid scenario");
    let tuned = Settings::tuned(1, ChannelMode::Specular);
    let run = RunSettings { episodes: 24, steps: 25, ..tuned.run };
    // With uniform baseline weights the initial score is low.
    let head = Head { baseline_weight: BaselineWeight::Uniform, ..tuned.head };
    let settings = Settings { run, head, warm_up: 100, ..tuned };
    let mut training = Training::new(scenario.clone(), settings, Ddpg::new).expect("a valid run");
    let mut held_out = HeldOut::default();
    held_out.add(&scenario, 25).expect("held-out states");
    let before = held_out.score(|room| training.act(room)).expect("a score").qos_met;
    for _ in 0..24 {
        training.run_episode().expect("an episode");
    }
    let after = held_out.score(|room| training.act(room)).expect("a score").qos_met;
    assert!(after > before + 0.15, "share of minimum rates met: {before} before and {after} after training");
    // A checkpoint refuses values that are not finite.
    let folder = tempfile::tempdir().expect("a temporary folder");
    checkpoint::save(&mut training, &folder.path().join("checkpoint.safetensors")).expect("finite parameters");
}
