//! `heliostat-lab train` on the command line: an interrupted run is saved and resumes to the same actor.
#![cfg(unix)]

use std::path::Path;
use std::process::{Command, Output, Stdio};

use heliostat_service::exit::FAILURE;
use heliostat_service::signals::restore_in_children;
use tempfile::TempDir;

const SETTINGS: [&str; 20] = [
    "train",
    "ddpg",
    "--set",
    "mirrors.rows=3",
    "--set",
    "mirrors.columns=3",
    "--seed",
    "7",
    // Many, so that the signal comes before the last one.
    "--episodes",
    "160",
    "--steps",
    "10",
    "--every",
    "1000",
    "--states",
    "2",
    // So that the run learns from the second episode.
    "--option",
    "batch=8",
    "--option",
    "warm_up=20",
];

fn train(out: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_heliostat-lab"));
    command.args(SETTINGS).arg("--out").arg(out).arg("--json").stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

/// Rows of the learning curve, the header included.
fn rows(out: &Path) -> usize {
    std::fs::read_to_string(out.join("curve.csv")).map_or(0, |text| text.lines().count())
}

fn actor(out: &Path) -> Vec<u8> {
    std::fs::read(out.join("ddpg-specular-seed7.onnx")).expect("an actor")
}

fn errors(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Interrupts a run after some episodes with a signal, and returns its messages.
fn interrupt(out: &Path, signal: &str) -> String {
    restore_in_children();
    let mut child = train(out).spawn().expect("the program starts");
    let started = std::time::Instant::now();
    while rows(out) < 3 {
        assert!(started.elapsed().as_secs() < 120, "no episode");
        assert!(child.try_wait().expect("a child").is_none(), "the run ended before the signal");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    let sent = Command::new("kill").args([signal, &child.id().to_string()]).status().expect("kill");
    assert!(sent.success());
    let output = child.wait_with_output().expect("it ends");
    assert_eq!(output.status.code(), Some(FAILURE.into()), "{}", errors(&output));
    assert!(!out.join("ddpg-specular-seed7.onnx").exists());
    errors(&output)
}

#[test]
fn an_interrupted_run_is_saved_and_the_printed_command_resumes_it_to_the_same_actor() {
    let folder = TempDir::new().expect("a folder");
    let whole = folder.path().join("whole");
    let output = train(&whole).output().expect("the program starts");
    assert!(output.status.success(), "{}", errors(&output));
    let card = std::fs::read_to_string(whole.join("ddpg-specular-seed7.md")).expect("a card");
    let flags = "--episodes 160 --steps 10 --every 1000 --states 2\n";
    assert!(card.contains(flags), "the command repeats the run: {card}");

    for signal in ["-INT", "-TERM"] {
        let parts = folder.path().join(format!("parts of{signal}"));
        let messages = interrupt(&parts, signal);
        let saved = parts.join("checkpoint.safetensors");
        assert!(saved.exists() && messages.contains(&format!("saved: {}", saved.display())), "{messages}");
        let resume = messages.lines().find_map(|line| line.strip_prefix("resume with: heliostat-lab "));
        let resume = resume.expect("a command");
        let resumed = Command::new("sh")
            .args(["-c", &format!("exec \"$0\" {resume}"), env!("CARGO_BIN_EXE_heliostat-lab")])
            .output()
            .expect("a shell");
        assert!(resumed.status.success(), "{resume}: {}", errors(&resumed));
        assert!(actor(&parts) == actor(&whole), "{signal}: the resumed run gave another actor");
        assert_eq!(rows(&parts), rows(&whole));
    }
}

#[test]
fn a_scenario_that_is_missing_is_named() {
    let folder = TempDir::new().expect("a folder");
    for (scenario, words) in [
        ("absent.toml", "scenario file absent.toml cannot be read"),
        ("absent", "no file and no built-in scenario \"absent\""),
    ] {
        let refused = train(folder.path()).args(["--scenario", scenario]).output().expect("the program starts");
        let message = String::from_utf8_lossy(&refused.stderr);
        assert!(!refused.status.success() && message.contains(words), "{message}");
    }
}

#[test]
fn faults_of_reports_and_mirrors_and_a_small_range_in_a_scenario_file_are_conditions_of_training() {
    let folder = TempDir::new().expect("a folder");
    let file = folder.path().join("room.toml");
    let room = "mirrors = { rows = 2, columns = 2 }\nactuator = { stuck_share = 0.5 }\n\
                control = { range_deg = 12.0 }\nstreams = { positions = { latency_ms = 100.0 } }\n";
    std::fs::write(&file, room).expect("written");
    let output = Command::new(env!("CARGO_BIN_EXE_heliostat-lab"))
        .args(["train", "ddpg", "--episodes", "1", "--steps", "2", "--states", "2", "--json"])
        .args(["--option", "batch=8", "--option", "warm_up=20", "--scenario"])
        .arg(&file)
        .arg("--out")
        .arg(folder.path().join("run"))
        .output()
        .expect("the program starts");
    let of_reports = "training, and streams.positions.latency_ms: policies know the true state";
    let of_mirrors = "training, and actuator.stuck_share: each mirror turns at once to the exact angle";
    assert!(output.status.success(), "{}", errors(&output));
    assert!([of_reports, of_mirrors].iter().all(|note| errors(&output).contains(note)), "{}", errors(&output));
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one object");
    assert_eq!(report["conditions"][0]["because"], "training, and streams.positions.latency_ms");
    assert_eq!(report["conditions"][1]["because"], "training, and actuator.stuck_share");
    let small = "control.range_deg = 12.0, within which mirrors reach ";
    assert!(report["conditions"][2]["because"].as_str().is_some_and(|because| because.starts_with(small)), "{report}");
}

#[test]
fn a_key_that_training_does_not_read_is_refused() {
    let folder = TempDir::new().expect("a folder");
    let refused = train(folder.path()).args(["--set", "actuator.stuck_share=1"]).output().expect("the program starts");
    let message = errors(&refused);
    assert_eq!(refused.status.code(), Some(2), "{message}");
    assert!(message.contains("actuator.stuck_share: no effect"), "{message}");
}

#[test]
fn an_option_that_is_unknown_or_has_no_value_is_wrong_usage() {
    let folder = TempDir::new().expect("a folder");
    for (option, words) in [("x=1", "--option x=1: no such key"), ("batch", "--option batch: expected KEY=VALUE")] {
        let refused = train(folder.path()).args(["--option", option]).output().expect("the program starts");
        assert_eq!(refused.status.code(), Some(2), "{}", errors(&refused));
        assert!(errors(&refused).contains(words), "{}", errors(&refused));
    }
}
