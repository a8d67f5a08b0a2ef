//! Every command in the README and in the tutorials runs.
//!
//! A fenced block marked `sh` is run by bash, block after block in one folder for each file, with the built `heliostat` first on the path and the
//! repository's folders beside it. `sh until-stopped` marks commands that run until Ctrl-C: they run side by side for two seconds. `sh no-run` marks what
//! cannot run here; the text beside it says why. Any other block that holds a command of ours fails the test.

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::Command;

use heliostat_tests::programs;
use tempfile::TempDir;

/// Longest that one file's commands may take, in s; they take a fraction of that on an idle machine.
const PATIENCE_S: u32 = 240;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize().expect("the workspace is there")
}

#[derive(Debug)]
struct Block {
    line: usize,
    info: String,
    text: String,
}

/// The fenced blocks of a Markdown file.
fn blocks(text: &str) -> Vec<Block> {
    let mut blocks: Vec<Block> = Vec::new();
    let mut open = false;
    for (index, line) in text.lines().enumerate() {
        match (line.strip_prefix("```"), open) {
            (Some(info), false) => {
                blocks.push(Block { line: index + 1, info: info.trim().to_owned(), text: String::new() });
                open = true;
            }
            (Some(_), true) => open = false,
            (None, true) => {
                let block = blocks.last_mut().expect("a block is open");
                block.text.push_str(line);
                block.text.push('\n');
            }
            (None, false) => {}
        }
    }
    blocks
}

fn is_command(line: &str) -> bool {
    line.trim_start().starts_with("heliostat ")
}

/// The command without its comment, for two seconds in the background.
fn stopped_soon(line: &str) -> String {
    let command = line.split(" #").next().unwrap_or(line).trim();
    format!("{command} --seconds 2 > /dev/null &\n")
}

/// A folder in which the repository's own folders stand, so that a command can name them.
fn stage(folder: &TempDir) {
    for name in ["deploy", "docs", "models", "tests"] {
        symlink(root().join(name), folder.path().join(name)).expect("a fresh folder takes a link");
    }
}

/// Runs a file's blocks; gives the number of commands.
fn run(file: &str) -> usize {
    let text = fs::read_to_string(root().join(file)).unwrap_or_else(|error| panic!("{file}: {error}"));
    let folder = TempDir::new().expect("a folder");
    stage(&folder);
    let path = format!("{}:{}", programs().display(), std::env::var("PATH").unwrap_or_default());
    let mut commands = 0;
    for block in blocks(&text) {
        let count = block.text.lines().filter(|line| is_command(line)).count();
        let script = match block.info.as_str() {
            "sh" => block.text.clone(),
            "sh until-stopped" => block.text.lines().filter(|line| is_command(line)).map(stopped_soon).collect(),
            info => {
                let marked = info.starts_with("sh no-run");
                assert!(marked || count == 0, "{file}, line {}: commands in a block that is not marked", block.line);
                continue;
            }
        };
        commands += count;
        // A command in the background must end well too.
        let script = format!("set -eu\n{script}\nfor job in $(jobs -p); do wait $job; done\n");
        let output = Command::new("timeout")
            .args([&PATIENCE_S.to_string(), "bash", "-c", &script])
            .env("PATH", &path)
            .current_dir(folder.path())
            .output()
            .expect("bash runs");
        let (out, errors) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
        assert!(output.status.success(), "{file}, line {}: {}\n{script}\n{out}\n{errors}", block.line, output.status);
    }
    commands
}

#[test]
fn the_readme_runs() {
    assert!(run("README.md") >= 4);
}

#[test]
fn first_run_runs() {
    assert!(run("docs/tutorials/first-run.md") >= 7);
}

#[test]
fn own_scenario_runs() {
    assert!(run("docs/tutorials/own-scenario.md") >= 6);
}

#[test]
fn own_policy_runs() {
    assert!(run("docs/tutorials/own-policy.md") >= 4);
}

#[test]
fn own_driver_runs() {
    assert!(run("docs/tutorials/own-driver.md") >= 5);
}

#[test]
fn latency_report_runs() {
    assert!(run("docs/tutorials/latency-report.md") >= 6);
}

#[test]
fn actuators_run() {
    assert!(run("docs/actuators.md") >= 3);
}

#[test]
fn recording_runs() {
    assert!(run("docs/recording.md") >= 8);
}

#[test]
fn every_tutorial_is_run() {
    let tests = fs::read_to_string(root().join("tests/tests/documentation.rs")).expect("this file is there");
    for entry in fs::read_dir(root().join("docs/tutorials")).expect("there are tutorials") {
        let name = entry.expect("a folder can be read").file_name().to_string_lossy().into_owned();
        assert!(tests.contains(&format!("run(\"docs/tutorials/{name}\")")), "{name} is not run by any test here");
    }
}

#[test]
fn units_and_rooms_of_the_deployment_agree_with_the_programs() {
    let deploy = root().join("deploy");
    for room in ["lab", "atrium"] {
        let toml = fs::read_to_string(deploy.join(format!("rooms/{room}.toml"))).expect("a room has a scenario");
        heliostat_scenario::Scenario::from_toml(&toml).unwrap_or_else(|error| panic!("{room}: {error}"));
        let environment =
            fs::read_to_string(deploy.join(format!("rooms/{room}.env"))).expect("a room has an environment");
        let variables: BTreeMap<&str, &str> =
            environment.lines().filter(|line| !line.starts_with('#')).filter_map(|line| line.split_once('=')).collect();
        for unit in ["controller", "sim-node"] {
            let text = fs::read_to_string(deploy.join(format!("systemd/heliostat-{unit}@.service"))).expect("a unit");
            let start = text.lines().find(|line| line.starts_with("ExecStart=")).expect("a unit starts something");
            let command = start.split_whitespace().skip(1).flat_map(|word| {
                let name = word.trim_start_matches('$').trim_start_matches('{').trim_end_matches('}');
                match word.strip_prefix('$') {
                    Some(_) => {
                        let value = variables.get(name).unwrap_or_else(|| panic!("{room}.env lacks {name}"));
                        value.split(' ').map(str::to_owned).collect()
                    }
                    None => vec![word.replace("%i", room)],
                }
            });
            // The flags of the unit are those that the program has.
            let scenario = format!("/etc/heliostat/{room}.toml");
            let here = deploy.join(format!("rooms/{room}.toml")).display().to_string();
            let arguments: Vec<String> =
                command.map(|word| if word == scenario { here.clone() } else { word }).collect();
            let output = Command::new(programs().join("heliostat")).args(["config", unit]).args(&arguments).output();
            let output = output.expect("heliostat runs");
            assert!(output.status.success(), "{room}, {unit}: {}", String::from_utf8_lossy(&output.stderr));
        }
    }
}

#[test]
fn the_containers_start_what_the_programs_understand() {
    let deploy = root().join("deploy");
    let read = |file: &str| fs::read_to_string(deploy.join(file)).unwrap_or_else(|error| panic!("{file}: {error}"));
    let (compose, image) = (read("container/compose.yaml"), read("container/Containerfile"));
    for service in ["controller", "sim-node"] {
        let part = compose.split_once(&format!("\n  {service}:\n")).expect("a service").1;
        assert!(
            part.contains(&format!("target: {service}")) && image.contains(&format!(" AS {service}\n")),
            "{service}"
        );
        assert!(image.contains(&format!("ENTRYPOINT [\"heliostat-{service}\"]")), "{service}");
        // The words of a command are a list in YAML as in JSON.
        let words = part.lines().find(|line| line.trim_start().starts_with("[\"--room\"")).expect("a command");
        let words: Vec<String> = serde_json::from_str(words.trim()).expect("a list of words");
        let rooms = deploy.join("rooms").display().to_string();
        let words = words.iter().map(|word| word.replace("/etc/heliostat", &rooms));
        let output = Command::new(programs().join("heliostat")).args(["config", service]).args(words).output();
        let output = output.expect("heliostat runs");
        assert!(output.status.success(), "{service}: {}", String::from_utf8_lossy(&output.stderr));
    }
    let lock = fs::read_to_string(root().join("Cargo.lock")).expect("a lock file");
    let zenoh = lock.split_once("name = \"zenoh\"\nversion = \"").expect("zenoh is there").1;
    let version = zenoh.split('"').next().expect("a version");
    assert!(compose.contains(&format!("image: eclipse/zenoh:{version}\n")), "the router is not zenoh {version}");
}
