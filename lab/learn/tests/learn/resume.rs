//! A resumed run equals an uninterrupted one, and checkpoints that do not fit are refused.

use std::path::Path;

use heliostat_learn::learners::ddpg::{Ddpg, Settings};
use heliostat_learn::training::{RunSettings, Training, checkpoint};
use heliostat_scenario::{ChannelMode, Scenario};

const EPISODES: usize = 6;

fn training(settings: Settings) -> Training {
    let overrides = ["mirrors.rows=3", "mirrors.columns=3"];
    let scenario = Scenario::builtin("specular").and_then(|scenario| scenario.with_overrides(&overrides));
    Training::new(scenario.expect("a valid scenario"), settings, Ddpg::new).expect("a valid run")
}

fn short(preset: Settings) -> Settings {
    let run = RunSettings { episodes: EPISODES, steps: 12, ..preset.run };
    Settings { run, warm_up: 20, batch: 8, replay: 50, ..preset }
}

fn run(training: &mut Training, until: usize) {
    while training.episodes_done() < until {
        training.run_episode().expect("an episode");
    }
}

fn checkpoint(training: &mut Training, path: &Path) -> Vec<u8> {
    checkpoint::save(training, path).expect("a checkpoint");
    std::fs::read(path).expect("the file")
}

fn check(settings: Settings) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("checkpoint.safetensors");
    let mut uninterrupted = training(settings.clone());
    run(&mut uninterrupted, EPISODES);
    let expected = checkpoint(&mut uninterrupted, &path);

    let mut first = training(settings.clone());
    run(&mut first, EPISODES / 2);
    let half = checkpoint(&mut first, &path);
    assert_ne!(half, expected, "the second half of the run must change something");
    let mut second = training(settings);
    checkpoint::load(&mut second, &path).expect("the checkpoint fits");
    run(&mut second, EPISODES);
    assert!(checkpoint(&mut second, &path) == expected, "the resumed run differs from the uninterrupted one");
}

#[test]
fn tuned_runs_resume_bit_for_bit() {
    check(short(Settings::tuned(9, ChannelMode::Specular)));
}

#[test]
fn paper_runs_resume_bit_for_bit() {
    check(short(Settings::paper(9)));
}

#[test]
fn another_seed_is_another_run() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("checkpoint.safetensors");
    let mut one = training(short(Settings::tuned(1, ChannelMode::Specular)));
    run(&mut one, 1);
    let mut two = training(short(Settings::tuned(2, ChannelMode::Specular)));
    run(&mut two, 1);
    let file = |training: &Training| training.export(&[]).expect("an actor");
    assert_ne!(file(&one), file(&two));
    checkpoint::save(&mut one, &path).expect("a checkpoint");
    let refusal = checkpoint::load(&mut two, &path).expect_err("other settings").to_string();
    assert!(refusal.contains("other settings"), "{refusal}");
}

#[cfg(unix)]
#[test]
fn a_link_beside_a_checkpoint_redirects_nothing() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (path, other) = (folder.path().join("checkpoint.safetensors"), folder.path().join("other"));
    std::fs::write(&other, "own").expect("written");
    std::os::unix::fs::symlink(&other, path.with_extension("part")).expect("a link");
    let mut run = training(short(Settings::tuned(1, ChannelMode::Specular)));
    assert!(!checkpoint(&mut run, &path).is_empty());
    assert_eq!(std::fs::read_to_string(&other).expect("the file"), "own");
}

#[test]
fn a_damaged_checkpoint_is_refused() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("checkpoint.safetensors");
    let mut run = training(short(Settings::tuned(1, ChannelMode::Specular)));
    let bytes = checkpoint(&mut run, &path);
    std::fs::write(&path, &bytes[..bytes.len() / 2]).expect("the file");
    assert!(checkpoint::load(&mut run, &path).is_err());
}

#[test]
fn a_run_that_diverged_writes_nothing() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("checkpoint.safetensors");
    let diverging = Settings { critic_rate: f64::INFINITY, ..Settings::tuned(1, ChannelMode::Specular) };
    let mut diverged = training(short(diverging));
    run(&mut diverged, EPISODES);
    let refusal = checkpoint::save(&mut diverged, &path).expect_err("no value is finite").to_string();
    assert!(refusal.contains("not finite") && refusal.contains("after 6 episodes"), "{refusal}");
    assert!(!path.exists());
}
