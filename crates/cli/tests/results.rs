//! `heliostat results`: a page is written section by section, and a run that was interrupted continues.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

fn results(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_heliostat"));
    command.arg("results").args(arguments).current_dir(folder);
    command.output().expect("the program starts")
}

fn errors(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn a_page_is_written_from_its_commands_and_a_second_run_continues() {
    let folder = tempfile::tempdir().expect("a folder");
    let page = || fs::read_to_string(folder.path().join("actuators.md")).expect("the page is there");

    let first = results(folder.path(), &["actuators", "--quick", "--only", "offset"]);
    assert!(first.status.success(), "{}", errors(&first));
    let text = page();
    let command = "--sweep actuator.offset_deg=0,0.5,1,2 --states 2 --seeds 1\n";
    for expected in ["# Results: mirrors", command, "Seeds: 1, from 1"] {
        assert!(text.contains(expected), "{expected} is missing in:\n{text}");
    }
    assert!(text.contains("## Not finished") && text.contains("calibration-mems"), "{text}");

    let only = "offset,calibration-mems";
    let second = results(folder.path(), &["actuators", "--quick", "--resume", "--only", only]);
    assert!(second.status.success(), "{}", errors(&second));
    assert!(errors(&second).contains("offset: finished before"), "{}", errors(&second));
    let lines = |text: &str| text.lines().filter(|line| line.starts_with("| ")).count();
    assert!(lines(&page()) > lines(&text) && page().contains("| mounting (degrees) |"), "{}", page());

    let mixed = results(folder.path(), &["actuators", "--resume", "--only", "offset"]);
    assert!(!mixed.status.success(), "a full run must not continue a quick one");
}

#[test]
fn an_unknown_section_is_refused_with_the_known_ones() {
    let folder = tempfile::tempdir().expect("a folder");
    let refused = results(folder.path(), &["latency", "--only", "lop"]);
    assert!(!refused.status.success() && errors(&refused).contains("loop-nearest"), "{}", errors(&refused));
}

#[test]
fn a_page_that_cannot_be_written_is_refused_before_the_first_section() {
    let folder = tempfile::tempdir().expect("a folder");
    fs::create_dir(folder.path().join("taken")).expect("a folder");
    for (out, expected) in [
        ("missing/page.md", "missing/page.md: expected a file in a folder that exists"),
        ("taken", "cannot write taken"),
        ("page.json", "--out page.json: what is finished goes to the JSON file of this name"),
    ] {
        let refused = results(folder.path(), &["actuators", "--quick", "--only", "offset", "--out", out]);
        let message = errors(&refused);
        assert!(!refused.status.success() && message.contains(expected), "{message}");
        assert!(!message.contains("--sweep"), "a section ran: {message}");
    }
    assert_eq!(fs::read_dir(folder.path()).expect("the folder").count(), 1, "only the folder is there");
}
