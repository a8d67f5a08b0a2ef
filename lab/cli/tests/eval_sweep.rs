//! `heliostat-lab eval --sweep` where the points have different policies.

use std::process::Command;

/// Evaluates two sizes of the array, of which the second one has an actor of `ddpg-raw`; returns the text and
/// the cells of the CSV file.
fn evaluated(policies: &str) -> (String, Vec<Vec<String>>) {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("figures.csv");
    let mut command = Command::new(env!("CARGO_BIN_EXE_heliostat-lab"));
    command.args(["eval", "--scenario", "specular", "--states", "3", "--seeds", "1", "--fitting"]);
    command.args(["--policies", policies, "--sweep", "mirrors.rows=2,10", "--set", "mirrors.columns=10"]);
    let output = command.arg("--csv").arg(&file).output().expect("the program starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = std::fs::read_to_string(&file).expect("readable");
    let cells = text.lines().map(|line| line.split(',').map(String::from).collect()).collect();
    (String::from_utf8(output.stdout).expect("text"), cells)
}

/// The difference of the sum rate in the line that begins with these cells.
fn difference<'a>(lines: &'a [Vec<String>], rows: &str, policy: &str) -> &'a str {
    let column = lines[0].iter().position(|name| name == "difference_mbps_mean").expect("differences");
    let line = lines.iter().find(|line| line[..2] == [rows, policy]).expect("a line");
    &line[column]
}

/// The cells of a point in the table of the differences of the sum rate.
fn row<'a>(text: &'a str, rows: &str) -> Vec<&'a str> {
    let table = text.split("paired: sum rate in Mbit/s").nth(1).expect("a table");
    let cells = |line: &'a str| line.split_whitespace().filter(|cell| !cell.starts_with('±')).collect::<Vec<_>>();
    table.lines().map(cells).find(|cells| cells.first() == Some(&rows)).expect("a row")
}

#[test]
fn a_sweep_whose_first_point_has_one_policy_has_all_columns() {
    let (text, lines) = evaluated("ddpg-raw,flat");
    assert!(lines.iter().all(|line| line.len() == lines[0].len()), "{lines:?}");
    assert_eq!(lines.len(), 1 + 2 + 3);
    assert_eq!((difference(&lines, "2", "flat"), difference(&lines, "10", "ddpg-raw")), ("", ""));
    assert!(difference(&lines, "10", "flat").parse::<f64>().is_ok(), "{lines:?}");
    assert!(text.contains("difference to ddpg-raw, paired: sum rate"), "{text}");
    let second = row(&text, "10");
    assert_eq!((row(&text, "2"), second.len()), (vec!["2", "-", "-", "-"], 4), "{text}");
}

#[test]
fn a_point_that_subtracts_another_policy_has_no_difference_in_a_sweep() {
    let (text, lines) = evaluated("ddpg-raw,greedy,flat");
    assert!(difference(&lines, "2", "flat").parse::<f64>().is_ok(), "{lines:?}");
    assert_eq!(difference(&lines, "10", "flat"), "");
    assert!(text.contains("difference to greedy, paired: sum rate"), "{text}");
    assert_eq!(row(&text, "10"), ["10", "-", "-", "-", "-"], "{text}");
}
