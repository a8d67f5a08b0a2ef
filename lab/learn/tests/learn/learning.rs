//! A short run of `ddpg` improves the score, and its parameters stay finite.

use heliostat_learn::environment::features::{BaselineWeight, Head};
use heliostat_learn::evaluation::HeldOut;
use heliostat_learn::learners::ddpg;
use heliostat_learn::networks::on_one_thread;
use heliostat_learn::training::{RunSettings, Training, checkpoint};
use heliostat_scenario::{ChannelMode, Scenario};

const MODE: ChannelMode = ChannelMode::Specular;

/// With uniform baseline weights the initial score is low.
fn uniform(head: Head) -> Head {
    Head { baseline_weight: BaselineWeight::Uniform, ..head }
}

fn short(run: RunSettings) -> RunSettings {
    RunSettings { episodes: 24, steps: 25, ..run }
}

#[test]
fn a_short_run_of_ddpg_learns_to_meet_minimum_rates() {
    let tuned = ddpg::Settings::tuned(1, MODE);
    let settings = ddpg::Settings { run: short(tuned.run.clone()), head: uniform(tuned.head), warm_up: 100, ..tuned };
    check(0.15, |scenario| Training::new(scenario, settings.clone(), ddpg::Ddpg::new));
}

/// Trains in small rooms in which the mirrors serve all users; the share of minimum rates met must
/// rise by more than `gain`.
fn check(gain: f64, begin: impl Fn(Scenario) -> anyhow::Result<Training> + Sync + Send) {
    on_one_thread(|| {
        let overrides = ["mirrors.rows=6", "mirrors.columns=6", "blockage.forced_users=5"];
        let scenario = Scenario::builtin("specular").and_then(|scenario| scenario.with_overrides(&overrides));
        let scenario = scenario.expect("a valid scenario");
        let mut training = begin(scenario.clone()).expect("a valid run");
        let mut held_out = HeldOut::default();
        held_out.add(&scenario, 25).expect("held-out states");
        let before = held_out.score(|room| training.act(room)).expect("a score").qos_met;
        for _ in 0..training.run().episodes {
            training.run_episode().expect("an episode");
        }
        let after = held_out.score(|room| training.act(room)).expect("a score").qos_met;
        assert!(after > before + gain, "share of minimum rates met: {before} before and {after} after training");
        // A checkpoint refuses values that are not finite.
        let folder = tempfile::tempdir().expect("a temporary folder");
        checkpoint::save(&mut training, &folder.path().join("checkpoint.safetensors")).expect("finite parameters");
    })
    .expect("a thread");
}
