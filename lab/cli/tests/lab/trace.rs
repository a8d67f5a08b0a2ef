//! `heliostat-lab trace`: a data set becomes a recorded walk that a room plays.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use tempfile::TempDir;

fn heliostat(folder: &TempDir, arguments: &str) -> Output {
    let program = Command::new(env!("CARGO_BIN_EXE_heliostat-lab"))
        .args(arguments.split_whitespace())
        .current_dir(folder.path())
        .output();
    program.expect("the program starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("text")
}

/// Two pedestrians of an ETH/UCY file who walk 8 m along x, the second one 2 s later, and two bad rows.
fn folder() -> TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    let mut rows = String::new();
    for step in 0..21 {
        let x = 0.4 * f64::from(step);
        rows += &format!("{:.7e} 1.0 {x:.7e} 0.0 0.0 1.0 0.0 0.0\n", 780.0 + 10.0 * f64::from(step));
    }
    rows += "bad 1.0 0.0 0.0 0.0 0.0 0.0 0.0\n";
    for step in 0..21 {
        let x = 8.0 - 0.4 * f64::from(step);
        rows += &format!("{:.7e} 2.0 {x:.7e} 0.0 2.0 1.0 0.0 0.0\n", 830.0 + 10.0 * f64::from(step));
    }
    rows += "780 2.0 0.0 0.0 0.0 0.0 0.0 0.0\n";
    fs::write(folder.path().join("obsmat.txt"), rows).expect("written");
    folder
}

const IMPORT: &str = "trace import obsmat.txt --format eth-ucy --users 2 --out walk.csv";

#[test]
fn the_report_names_what_was_read_refused_chosen_and_how_to_use_the_file() {
    let folder = folder();
    let imported = heliostat(&folder, IMPORT);
    assert!(imported.status.success(), "{}", text(&imported.stderr));
    let report = text(&imported.stdout);
    for part in [
        "42 used",
        "2 rows refused",
        "line 22: invalid frame `bad`",
        "line 44: time 31.2 s of the pedestrian 2 is not",
        "2 in 2 tracks",
        "2.50 positions a second",
        "x 0.00 to 8.00 m, y 0.00 to 2.00 m",
        "together from 2.00 s after the first row",
        "median 1.00 m/s",
        "  room        hall (default, --scenario names another one)",
        "heliostat demo --scenario hall --set users.count=2 --set users.trace=walk.csv",
    ] {
        assert!(report.contains(part), "{part} is missing in:\n{report}");
    }
    let json = heliostat(&folder, &format!("{} --json", IMPORT.replace("walk.csv", "again.csv")));
    let report: serde_json::Value = serde_json::from_slice(&json.stdout).expect("one JSON object");
    assert_eq!((&report["read"]["refused_rows"], &report["selected"]["duration_s"]), (&2.into(), &6.0.into()));
    assert_eq!((&report["selected"]["room"], &report["selected"]["is_default_room"]), (&"hall".into(), &true.into()));
    // The walk is as long as the part in which both are present.
    let walk = fs::read_to_string(folder.path().join("walk.csv")).expect("the walk");
    assert_eq!(walk.lines().last().map(|row| row.starts_with("6,")), Some(true), "{walk}");
}

#[test]
fn the_command_that_plays_a_walk_is_quoted_for_a_shell() {
    let folder = folder();
    let imported = heliostat(&folder, &IMPORT.replace("walk.csv", "a&b.csv"));
    let report = text(&imported.stdout);
    assert!(report.contains("--set users.count=2 --set 'users.trace=a&b.csv'"), "{report}");
}

#[test]
fn a_room_plays_an_imported_walk() {
    let folder = folder();
    let imported = heliostat(&folder, &format!("{IMPORT} --rate-hz 10 --scenario hall"));
    let report = text(&imported.stdout);
    assert!(imported.status.success() && report.contains("  room        hall\n"), "{report}");
    let room = "[users]\ncount = 2\ntrace = \"walk.csv\"\n";
    fs::write(folder.path().join("room.toml"), room).expect("written");
    let played = heliostat(&folder, "map --scenario room.toml --array flat --at-seconds 1 --step-cm 50");
    assert!(played.status.success(), "{}", text(&played.stderr));
}

#[test]
fn a_walk_that_is_imported_again_in_the_room_frame_is_the_same_file() {
    let folder = folder();
    assert!(heliostat(&folder, IMPORT).status.success());
    let again = heliostat(&folder, "trace import walk.csv --format csv --fit none --users 2 --out again.csv");
    assert!(again.status.success(), "{}", text(&again.stderr));
    let read = |name: &str| fs::read_to_string(folder.path().join(name)).expect("a walk");
    assert_eq!(read("walk.csv"), read("again.csv"));
}

#[test]
fn a_file_that_cannot_be_used_is_refused_with_the_reason_and_nothing_is_written() {
    let folder = folder();
    for (arguments, expected) in [
        ("obsmat.txt --format csv", "missing column time: expected the header time,user,x,y"),
        ("obsmat.txt --format atc", "refused rows: 44, the first in line 1: number of columns 1: expected 8"),
        ("obsmat.txt --format eth-ucy --users 3", "at most 2; expected 3: choose fewer --users"),
        ("obsmat.txt --format eth-ucy --users 2 --duration-s 9", "last 6.00 s; expected 9 s"),
        ("obsmat.txt --format eth-ucy --users 2 --fit none", "expected points within 5 m x 5 m"),
        ("obsmat.txt --format eth-ucy --from-s 1000", "no position is left: 42 outside"),
        ("obsmat.txt --format eth-ucy --crop 1,1,0,0", "expected four numbers X_MIN,Y_MIN,X_MAX,Y_MAX"),
        ("absent.txt --format eth-ucy", "absent.txt cannot be imported: No such file"),
    ] {
        let refused = heliostat(&folder, &format!("trace import {arguments} --out none.csv"));
        let message = text(&refused.stderr);
        assert_eq!(refused.status.code(), Some(2), "{arguments}: {message}");
        assert!(message.contains(expected), "{expected} is missing in: {message}");
    }
    let export = heliostat(&folder, "trace export obsmat.txt --out none.csv");
    let message = text(&export.stderr);
    assert!(export.status.code() == Some(2) && message.contains("obsmat.txt cannot be exported"), "{message}");
    assert!(!Path::new(&folder.path().join("none.csv")).exists());
}

#[test]
fn a_walk_that_exists_is_not_overwritten() {
    let folder = folder();
    fs::write(folder.path().join("walk.csv"), "mine").expect("written");
    for command in [IMPORT, "trace export room.mcap --out walk.csv"] {
        let refused = heliostat(&folder, command);
        let message = text(&refused.stderr);
        assert!(refused.status.code() == Some(2) && message.contains("walk.csv exists already: expected a new file"));
    }
    assert_eq!(fs::read(folder.path().join("walk.csv")).expect("the file"), b"mine");
}

#[test]
fn an_output_that_is_the_input_is_refused_and_stays() {
    let folder = folder();
    assert!(heliostat(&folder, IMPORT).status.success());
    let before = fs::read(folder.path().join("walk.csv")).expect("the walk");
    for command in ["import walk.csv --format csv --users 2", "export walk.csv"] {
        let refused = heliostat(&folder, &format!("trace {command} --out ./walk.csv"));
        let message = text(&refused.stderr);
        assert!(refused.status.code() == Some(2) && message.contains("and --out name one file"), "{message}");
    }
    assert_eq!(fs::read(folder.path().join("walk.csv")).expect("the walk"), before);
}

#[test]
fn a_recording_with_old_names_in_its_scenario_is_exported() {
    let folder = folder();
    let golden = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/golden.mcap");
    let exported = heliostat(&folder, &format!("trace export {golden} --out golden.csv"));
    assert!(exported.status.success(), "{}", text(&exported.stderr));
}

/// A walk at 1.2 m/s of each of three pedestrians, as rows by a format of the test.
fn walk(row: impl Fn(u32, u32, f64, f64) -> String) -> String {
    let rows = (0..31).flat_map(|step| (1..=3).map(move |pedestrian| (step, pedestrian)));
    rows.map(|(step, pedestrian)| row(step, pedestrian, 0.48 * f64::from(step) - 7.0, f64::from(pedestrian)) + "\n")
        .collect()
}

#[test]
fn what_is_unusual_about_a_file_is_named() {
    let folder = folder();
    let write = |name: &str, text: String| fs::write(folder.path().join(name), text).expect("written");
    write("frames.txt", walk(|step, who, x, y| format!("{} {who} {x:.3} {y}", 6 * step)));
    write("swapped.txt", walk(|step, who, x, y| format!("{who} {} {x:.3} {y}", 10 * step)));
    write("ms.csv", format!("time,user,x,y\n{}", walk(|step, who, x, y| format!("{},{who},{x:.3},{y}", 400 * step))));
    let import = |arguments: &str| {
        drop(fs::remove_file(folder.path().join("walk.csv")));
        heliostat(&folder, &format!("trace import {arguments} --users 3 --out walk.csv"))
    };
    for (arguments, warning) in [
        ("frames.txt --format eth-ucy", None),
        ("frames.txt --format eth-ucy --frame-rate-hz 25", Some("median speed 2.00 m/s")),
        ("swapped.txt --format experiment --frame-rate-hz 25 --scale 100", None),
        ("ms.csv --format csv --time-unit ms", None),
    ] {
        let imported = import(arguments);
        let report = text(&imported.stdout);
        assert!(imported.status.success(), "{arguments}: {}", text(&imported.stderr));
        let found = report.lines().find(|line| line.trim_start().starts_with("warning"));
        assert_eq!(found.is_some(), warning.is_some(), "{arguments}: {report}");
        assert!(warning.is_none_or(|warning| report.contains(warning)), "{arguments}: {report}");
    }
    let refused = import("ms.csv --format csv");
    let message = text(&refused.stderr);
    assert!(refused.status.code() == Some(2) && message.contains("are the times in ms?"), "{message}");
    assert!(message.contains("--time-unit"), "{message}");
}

#[test]
fn columns_with_other_names_are_shown_and_can_be_named() {
    let folder = folder();
    let rows = walk(|step, who, x, y| format!("{:.1},{who},{x:.3},{y}", 0.4 * f64::from(step)));
    fs::write(folder.path().join("log.csv"), format!("Seconds,Person,X [m],Y [m]\n{rows}")).expect("written");
    let refused = heliostat(&folder, "trace import log.csv --format csv --users 3 --out walk.csv");
    let message = text(&refused.stderr);
    assert!(message.contains("`X [m]`") && message.contains("--columns time=NAME"), "{message}");
    let program = Command::new(env!("CARGO_BIN_EXE_heliostat-lab"))
        .args(["trace", "import", "log.csv", "--format", "csv", "--users", "3", "--out", "walk.csv"])
        .args(["--columns", "time=Seconds,user=Person,x=X [m],y=Y [m]"])
        .current_dir(folder.path())
        .output()
        .expect("the program starts");
    assert!(program.status.success(), "{}", text(&program.stderr));
}

#[test]
fn a_file_of_another_kind_is_named_with_what_to_do() {
    let folder = folder();
    for (bytes, words) in [
        (&b"\xff\xfet\0i\0m\0e\0"[..], "the file is text in UTF-16, expected a text in UTF-8: save it in UTF-8"),
        (b"version https://git-lfs.github.com/spec/v1\n", "is a pointer of git-lfs"),
        (b"\x89MCAP0\r\n", "the file is a recording, expected a text in UTF-8: `heliostat-lab trace export`"),
        (b"", "is empty"),
    ] {
        fs::write(folder.path().join("walks.csv"), bytes).expect("written");
        let refused = heliostat(&folder, "trace import walks.csv --format csv --out walk.csv");
        let message = text(&refused.stderr);
        assert!(refused.status.code() == Some(2) && message.contains(words), "{message}");
    }
}
