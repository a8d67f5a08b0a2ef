//! `heliostat eval --suite` on the command line.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn heliostat(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_heliostat"));
    command.args(arguments).current_dir(folder).output().expect("the program starts")
}

fn errors(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn a_leaderboard_is_written_task_by_task_and_a_second_run_continues() {
    let folder = tempfile::tempdir().expect("a folder");
    let suite = |policies: &str, tasks: &str, more: &[&str]| {
        let flags = ["eval", "--suite", "--quick", "--policies", policies, "--tasks", tasks, "--out", "board.md"];
        let output = heliostat(folder.path(), &[&flags[..], more].concat());
        assert!(output.status.success(), "{}", errors(&output));
        output
    };
    let page = || fs::read_to_string(folder.path().join("board.md")).expect("the page is there");

    suite("flat", "lab", &[]);
    let first = page();
    assert!(first.contains("## Not finished") && first.contains("hall-later"), "{first}");
    // The built-in actor is for another array than that of the lab.
    let command = "heliostat eval --scenario lab --closed-loop --states 2 --seeds 2 --policies greedy,flat\n";
    assert!(first.contains(command), "{first}");

    let second = suite("flat,ddpg-raw", "lab,hall", &["--resume", "--json"]);
    assert!(errors(&second).contains("lab: finished before"), "{}", errors(&second));
    let board: Value = serde_json::from_slice(&second.stdout).expect("one JSON object");
    let standings = board["standings"].as_array().expect("an array");
    let tasks: Vec<_> = standings.iter().map(|row| (row["policy"].as_str(), row["tasks"].as_u64())).collect();
    let expected = [("(oracle)", 2), ("greedy", 2), ("flat", 2), ("ddpg-raw", 1)];
    assert_eq!(tasks, expected.map(|(policy, tasks)| (Some(policy), Some(tasks))));
    let flat = &standings[2];
    assert!(flat["difference_ratio"]["mean"].as_f64() < Some(0.0), "{flat}");
    assert!(flat["outage_time"]["mean"].as_f64() > Some(0.0) && flat["decision_p99_us"].is_f64(), "{flat}");
    for row in ["| greedy | 2 | ", "| ddpg-raw | 1 | "] {
        assert!(page().contains(row), "{row} is missing in:\n{}", page());
    }
    // Each task is the command that the page prints.
    let task = &board["tasks"][0];
    let command = task["command"].as_str().expect("a command").split(' ').skip(1).chain(["--json"]);
    let repeated = heliostat(folder.path(), &command.collect::<Vec<_>>());
    let repeated: Value = serde_json::from_slice(&repeated.stdout).expect("one JSON object");
    let ratio = |report: &Value| report["policies"]["flat"]["ratio_to_oracle"].clone();
    assert_eq!(
        (ratio(&repeated), &repeated["configuration"]),
        (ratio(&task["report"]), &task["report"]["configuration"])
    );
}

#[test]
fn unknown_tasks_and_flags_of_a_single_comparison_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let refusal = |arguments: &[&str]| {
        let output = heliostat(folder.path(), &[&["eval", "--suite"], arguments].concat());
        assert!(!output.status.success() && output.stdout.is_empty(), "{arguments:?}");
        errors(&output)
    };
    assert!(refusal(&["--tasks", "hal"]).contains("hall-later"));
    assert!(refusal(&["--scenario", "hall"]).contains("cannot be used with"));
    assert!(refusal(&["--resume"]).contains("--out"));
    assert!(refusal(&["--out", "no/board.md"]).contains("expected a file in a folder that exists"));
    let unfit = refusal(&["--tasks", "lab", "--policies", "ddpg-raw"]);
    assert!(unfit.contains("fits none") && unfit.contains("not that of lab: no actor is built in"), "{unfit}");
    let missing = refusal(&["--tasks", "lab", "--policies", "missing.onnx"]);
    assert!(missing.contains("no actor at missing.onnx") && !missing.contains("fits none"), "{missing}");
    fs::write(folder.path().join("cut.onnx"), [8]).expect("a file");
    let cut = refusal(&["--tasks", "lab", "--policies", "cut.onnx"]);
    assert!(cut.contains("cut.onnx is not an ONNX model"), "{cut}");
    // The JSON file beside the page is checked before the first task, too.
    let with_json = refusal(&["--out", "board.json"]);
    assert!(with_json.contains("expected another ending") && !folder.path().join("board.json").exists(), "{with_json}");
    fs::create_dir(folder.path().join("taken.json")).expect("a folder");
    let taken = refusal(&["--tasks", "lab", "--policies", "flat", "--out", "taken.md"]);
    assert!(taken.contains("cannot write taken.json") && !taken.contains("1 of 1"), "{taken}");
    fs::write(folder.path().join("cut.json"), "{\"page\": \"sui").expect("a file");
    let cut = refusal(&["--tasks", "lab", "--policies", "flat", "--out", "cut.md", "--resume"]);
    assert!(cut.contains("cut.json holds no finished sections") && cut.contains("leave out --resume"), "{cut}");
}

#[test]
fn a_folder_does_not_hide_a_built_in_scenario() {
    let folder = tempfile::tempdir().expect("a folder");
    fs::create_dir(folder.path().join("hall")).expect("a folder");
    let shown = heliostat(folder.path(), &["scenario", "show", "--scenario", "hall"]);
    assert!(shown.status.success(), "{}", errors(&shown));
    assert!(String::from_utf8_lossy(&shown.stdout).contains("name = \"hall\""));
    let named = heliostat(folder.path(), &["scenario", "show", "--scenario", "./hall"]);
    assert!(errors(&named).contains("./hall"), "{}", errors(&named));
}
