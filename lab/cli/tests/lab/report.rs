//! `heliostat-lab report`: a page is written section by section, and an interrupted run continues.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

const REPORT: &str = r#"
name = "small"
title = "A small report"
about = "Two rooms."
[default]
full = "--states 3 --seeds 2"
quick = "--states 2 --seeds 1"
tables = [{ rows = "/policies", columns = "policy" }]
[words]
policies = "nearest,flat"
[columns]
policy = ["ratio | /ratio_to_oracle | ±3"]
[[section]]
name = "exact"
title = "Exact states"
about = "A room."
command = "heliostat-lab eval --policies {policies}"
bound = [{ what = "flat below the oracle", row = "flat", at = "/ratio_to_oracle/mean", at_most = 0.999 }]
[[section]]
name = "blocked"
title = "Blocked users"
about = "The same room."
command = "heliostat-lab eval --policies {policies} --blocked 2"
"#;

fn report(folder: &Path, arguments: &[&str]) -> Output {
    report_of(REPORT, folder, arguments)
}

fn report_of(text: &str, folder: &Path, arguments: &[&str]) -> Output {
    fs::write(folder.join("small.toml"), text).expect("written");
    let mut command = Command::new(env!("CARGO_BIN_EXE_heliostat-lab"));
    command.args(["report", "small.toml"]).args(arguments).current_dir(folder).output().expect("the program starts")
}

fn errors(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn a_page_is_written_from_its_commands_and_a_second_run_continues() {
    let folder = tempfile::tempdir().expect("a folder");
    let page = || fs::read_to_string(folder.path().join("small.md")).expect("the page is there");

    let first = report(folder.path(), &["--quick", "--only", "exact"]);
    assert!(first.status.success(), "{}", errors(&first));
    let text = page();
    let command = "heliostat-lab eval --policies nearest,flat --states 2 --seeds 1\n";
    for expected in [
        "# A small report",
        command,
        "States per seed: 2. Seeds: 1, from 1",
        "| met, open within the interval |",
        "## Not finished\n\nblocked",
    ] {
        assert!(text.contains(expected), "{expected} is missing in:\n{text}");
    }

    let second = report(folder.path(), &["--quick", "--resume"]);
    assert!(second.status.success() && errors(&second).contains("exact: finished before"), "{}", errors(&second));
    assert!(!page().contains("Not finished") && page().contains("| nearest | "), "{}", page());

    let other_words = report(folder.path(), &["--quick", "--resume", "--word", "policies=random,flat"]);
    assert!(!errors(&other_words).contains("finished before") && page().contains("| random "), "{}", page());
}

#[test]
fn a_column_that_no_row_has_is_an_error_and_its_correction_needs_no_second_run() {
    let folder = tempfile::tempdir().expect("a folder");
    let wrong = REPORT.replace("/ratio_to_oracle | ±3", "/ratio_to_orakel | ±3");
    let expected = "in section exact: column \"ratio\": no row has such a figure at /ratio_to_orakel: a row has ";
    // Without a finished section, the check has nothing to compare the columns with.
    assert!(report_of(&wrong, folder.path(), &["--check", "--quick"]).status.success());
    for arguments in [["--quick", "--only", "exact"], ["--quick", "--check", "--only=exact"]] {
        let refused = report_of(&wrong, folder.path(), &arguments);
        let message = errors(&refused);
        assert!(!refused.status.success() && message.contains(expected), "{arguments:?}: {message}");
        assert!(message.contains("ratio_to_oracle"), "{arguments:?}: {message}");
    }
    let continued = report(folder.path(), &["--quick", "--only", "exact", "--resume"]);
    let message = errors(&continued);
    assert!(continued.status.success() && message.contains("exact: finished before"), "{message}");
}

#[test]
fn check_lists_the_commands_and_runs_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let checked = report(folder.path(), &["--check"]);
    let text = String::from_utf8_lossy(&checked.stdout).into_owned();
    assert!(checked.status.success() && text.lines().count() == 2, "{}", errors(&checked));
    assert!(text.contains("--policies nearest,flat --blocked 2 --states 3 --seeds 2"), "{text}");
    assert_eq!(fs::read_dir(folder.path()).expect("the folder").count(), 1, "only the report is there");
}

#[test]
fn what_cannot_be_run_or_written_is_refused_before_the_first_section() {
    let folder = tempfile::tempdir().expect("a folder");
    fs::create_dir(folder.path().join("taken")).expect("a folder");
    for (arguments, expected) in [
        (&["--only", "exakt"][..], "--only exakt: expected one of exact, blocked"),
        (&["--word", "rooms=hall"], "--word rooms: the report has no such word"),
        (&["--word", "policies"], "expected NAME=VALUE"),
        (&["--word", "policies=flat --sweeep x"], "--sweeep"),
        (&["--out", "no/folder.md"], "expected a file in a folder that exists"),
        (&["--out", "taken"], "cannot write taken"),
        (&["--out", "page.json"], "--out page.json: finished sections go to the JSON file of this name"),
    ] {
        let refused = report(folder.path(), &[&["--quick"], arguments].concat());
        let message = errors(&refused);
        assert!(!refused.status.success() && message.contains(expected), "{arguments:?}: {message}");
        assert!(!message.contains("1 of 2"), "a section ran: {message}");
    }
    for (name, changed, expected) in [
        ("typo.toml", REPORT.replace("row = \"flat\"", "rwo = \"flat\""), "rwo"),
        (
            "sweep.toml",
            REPORT.replace("--blocked 2", "--sweep users.count=1,2"),
            "rows = \"/policies\": expected /reports",
        ),
    ] {
        fs::write(folder.path().join(name), changed).expect("written");
        let mut command = Command::new(env!("CARGO_BIN_EXE_heliostat-lab"));
        let refused = command.args(["report", name, "--check"]).current_dir(folder.path()).output().expect("it starts");
        assert!(!refused.status.success() && errors(&refused).contains(expected), "{}", errors(&refused));
    }
}
