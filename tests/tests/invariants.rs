//! Rules of ARCHITECTURE.md that can be read off manifests and sources.

use std::fs;
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn dependencies(member: &str) -> Vec<String> {
    let text = fs::read_to_string(root().join(member).join("Cargo.toml")).expect("a member has a manifest");
    let manifest: toml::Table = toml::from_str(&text).expect("a manifest is TOML");
    manifest["dependencies"].as_table().expect("a table").keys().cloned().collect()
}

fn sources(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    entries
        .flat_map(|path| if path.is_dir() { sources(&path) } else { vec![path] })
        .filter(|path| path.extension().is_some_and(|extension| extension == "rs"))
        .collect()
}

/// The crates that are held to the invariants: all but these tests.
const MEMBERS: [&str; 13] = [
    "channel",
    "scenario",
    "proto",
    "bus",
    "driver",
    "service",
    "sim-node",
    "controller",
    "models",
    "record",
    "reproduce",
    "ui",
    "heliostat",
];

/// Files outside `allowed` whose code, comments aside, contains one of the words.
fn offenders(words: &[&str], allowed: &[&str]) -> Vec<String> {
    let files = MEMBERS.iter().flat_map(|member| sources(&root().join(member).join("src")));
    files
        .filter(|path| !allowed.iter().any(|place| path.starts_with(root().join(place))))
        .filter(|path| {
            let text = fs::read_to_string(path).expect("a source is readable");
            let code = text.lines().filter(|line| !line.trim_start().starts_with("//"));
            code.into_iter().any(|line| words.iter().any(|word| stands_alone(line, word)))
        })
        .map(|path| path.display().to_string())
        .collect()
}

/// Whether the word stands in the line and is not the end of a longer name.
fn stands_alone(line: &str, word: &str) -> bool {
    line.match_indices(word)
        .any(|(at, _)| !line[..at].ends_with(|before: char| before.is_alphanumeric() || before == '_'))
}

#[test]
fn controller_and_simulator_do_not_know_each_other() {
    assert!(!dependencies("controller").contains(&"heliostat-sim-node".to_string()));
    assert!(!dependencies("sim-node").contains(&"heliostat-controller".to_string()));
}

#[test]
fn the_page_knows_a_room_by_its_topics_alone() {
    for part in ["heliostat-controller", "heliostat-sim-node", "heliostat-models"] {
        assert!(!dependencies("ui").contains(&part.to_string()), "ui depends on {part}");
    }
}

#[test]
fn what_is_deployed_carries_no_training_and_no_plots() {
    for member in ["channel", "scenario", "proto", "bus", "driver", "service", "sim-node", "controller"] {
        for heavy in ["candle-core", "candle-nn", "plotters", "heliostat-models"] {
            assert!(!dependencies(member).contains(&heavy.to_string()), "{member} depends on {heavy}");
        }
    }
}

#[test]
fn each_foreign_library_has_one_door() {
    assert_eq!(offenders(&["zenoh::"], &["bus"]), Vec::<String>::new());
    assert_eq!(offenders(&["ort::", "ort_tract"], &["controller/src/policy/actor.rs"]), Vec::<String>::new());
    assert_eq!(offenders(&["postcard::"], &["proto/src/codec.rs"]), Vec::<String>::new());
    assert_eq!(offenders(&["mcap::"], &["record/src/file.rs"]), Vec::<String>::new());
    assert_eq!(offenders(&["foxglove::"], &["record/src/scene.rs"]), Vec::<String>::new());
    assert_eq!(offenders(&["ctrlc::"], &["service/src/signals.rs"]), Vec::<String>::new());
    assert_eq!(offenders(&["hyper::", "hyper_util::"], &["service/src/http.rs"]), Vec::<String>::new());
}

#[test]
fn what_processes_share_is_written_once() {
    let clocks = ["service/src/clock.rs", "heliostat/src/commands/doctor/machine.rs", "reproduce/src/machine.rs"];
    assert_eq!(offenders(&["SystemTime", "UNIX_EPOCH"], &clocks), Vec::<String>::new());
    assert_eq!(offenders(&["RandomState"], &["service/src/source_id.rs", "bus/src/config.rs"]), Vec::<String>::new());
    assert_eq!(offenders(&["process::exit", "ExitCode::FAILURE"], &["service"]), Vec::<String>::new());
    for pure in ["channel", "scenario", "proto"] {
        assert!(!dependencies(pure).contains(&"heliostat-service".to_string()), "{pure} depends on service");
    }
}

#[test]
fn the_channel_reads_no_clock_opens_nothing_and_draws_nothing() {
    let words = ["std::time", "std::fs", "std::net", "std::env", "println!", "rand::", "SystemTime", "Instant::"];
    let elsewhere: Vec<&str> = MEMBERS.into_iter().filter(|member| *member != "channel").collect();
    assert_eq!(offenders(&words, &elsewhere), Vec::<String>::new());
    assert!(!dependencies("channel").iter().any(|name| name.starts_with("rand")));
}

#[test]
fn the_readme_names_the_test_command_that_continuous_integration_runs() {
    let command = "cargo test --release --workspace";
    for file in ["README.md", ".ci/run", "CONTRIBUTING.md"] {
        assert!(fs::read_to_string(root().join(file)).expect("readable").contains(command), "{file}");
    }
}
