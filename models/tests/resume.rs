//! A run that was stopped and resumed is the run that was not.

use std::path::Path;

use heliostat_models::checkpoint;
use heliostat_models::ddpg::{Settings, Trainer};
use heliostat_models::learner::{Learner, RunSettings};
use heliostat_scenario::{ChannelMode, Scenario};

const EPISODES: usize = 6;

fn trainer(settings: Settings) -> Trainer {
    let overrides = ["mirrors.rows=3", "mirrors.columns=3"].map(String::from);
    let scenario = Scenario::builtin("specular").and_then(|scenario| scenario.with_overrides(&overrides));
    Trainer::new(scenario.expect("a valid scenario"), settings).expect("a valid run")
}

fn short(preset: Settings) -> Settings {
    let run = RunSettings { episodes: EPISODES, steps: 12, ..preset.run };
    Settings { run, warm_up: 20, batch: 8, replay: 50, ..preset }
}

fn run(trainer: &mut Trainer, until: usize) {
    while trainer.episodes_done() < until {
        trainer.run_episode().expect("an episode");
    }
}

fn checkpoint(trainer: &Trainer, path: &Path) -> Vec<u8> {
    checkpoint::save(trainer, path).expect("a checkpoint");
    std::fs::read(path).expect("the file")
}

fn check(settings: Settings) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("checkpoint.safetensors");
    let mut whole = trainer(settings.clone());
    run(&mut whole, EPISODES);
    let wanted = checkpoint(&whole, &path);

    let mut first = trainer(settings.clone());
    run(&mut first, EPISODES / 2);
    let half = checkpoint(&first, &path);
    assert_ne!(half, wanted, "the second half of the run must change something");
    let mut second = trainer(settings);
    checkpoint::load(&mut second, &path).expect("the checkpoint fits");
    run(&mut second, EPISODES);
    assert!(checkpoint(&second, &path) == wanted, "the resumed run differs from the one that was not stopped");
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
    let mut one = trainer(short(Settings::tuned(1, ChannelMode::Specular)));
    run(&mut one, 1);
    let mut two = trainer(short(Settings::tuned(2, ChannelMode::Specular)));
    run(&mut two, 1);
    let parameters = |run: &Trainer| run.actor().network.layers()[0].bias.to_vec1::<f32>().expect("a vector");
    assert_ne!(parameters(&one), parameters(&two));
    checkpoint::save(&one, &path).expect("a checkpoint");
    let refusal = checkpoint::load(&mut two, &path).expect_err("other settings").to_string();
    assert!(refusal.contains("other settings"), "{refusal}");
}

#[test]
fn a_damaged_checkpoint_is_refused() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("checkpoint.safetensors");
    let mut run = trainer(short(Settings::tuned(1, ChannelMode::Specular)));
    let bytes = checkpoint(&run, &path);
    std::fs::write(&path, &bytes[..bytes.len() / 2]).expect("the file");
    assert!(checkpoint::load(&mut run, &path).is_err());
}

#[test]
fn a_run_that_diverged_writes_nothing() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("checkpoint.safetensors");
    let mut lost = trainer(short(Settings { critic_rate: f64::INFINITY, ..Settings::tuned(1, ChannelMode::Specular) }));
    run(&mut lost, EPISODES);
    let refusal = checkpoint::save(&lost, &path).expect_err("there is no number left").to_string();
    assert!(refusal.contains("not finite") && refusal.contains("after 6 episodes"), "{refusal}");
    assert!(!path.exists());
}
