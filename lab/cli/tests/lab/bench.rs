//! The benchmarks of the laboratory: their output and their counts. No time is asserted.

use std::fs;
use std::process::{Command, Output};

use serde_json::Value;

fn rows(arguments: &[&str]) -> Vec<Value> {
    let output = Command::new(env!("CARGO_BIN_EXE_heliostat-lab")).arg("bench").args(arguments).arg("--json").output();
    rows_of(&output.expect("the program starts"))
}

fn rows_of(output: &Output) -> Vec<Value> {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let json: Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
    json["rows"].as_array().expect("rows").clone()
}

fn number(row: &Value, path: &str) -> f64 {
    row.pointer(path).and_then(Value::as_f64).unwrap_or_else(|| panic!("no number at {path} in {row}"))
}

#[test]
fn rooms_are_served_by_one_process_beside_an_echo() {
    let rows = rows(&["rooms", "--policy", "nearest", "--rooms", "1,3", "--hz", "50", "--seconds", "5"]);
    assert_eq!(rows.len(), 2);
    for (row, rooms) in rows.iter().zip([1.0, 3.0]) {
        assert_eq!(number(row, "/rooms"), rooms);
        // At least one block of half a second was measured, and nearly all of it was answered.
        assert!(number(row, "/count") + number(row, "/lost") >= 25.0 * rooms, "{row}");
        assert!(number(row, "/lost") <= 0.2 * number(row, "/count"), "{row}");
        assert!(number(row, "/decision_us/p50") < number(row, "/measured_us/p50") * 1.5, "{row}");
    }
}

/// Number of running processes of this program with these words in their command line.
#[cfg(target_os = "linux")]
fn running(words: &[&str]) -> usize {
    let words = words.join("\0");
    let processes = fs::read_dir("/proc").expect("Linux has /proc").flatten();
    let lines = processes.filter_map(|process| fs::read(process.path().join("cmdline")).ok());
    lines.filter(|line| String::from_utf8_lossy(line).contains(&words)).count()
}

#[cfg(target_os = "linux")]
#[test]
fn late_decisions_of_the_demo_are_counted_beside_busy_processes_which_end_with_it() {
    use std::process::Stdio;
    use std::time::{Duration, Instant};

    // No other test has busy processes that measure each row for 24.25 s.
    let busy = || running(&["bench", "env", "--seconds", "24.25"]);
    let mut command = Command::new(env!("CARGO_BIN_EXE_heliostat-lab"));
    command.args(["bench", "demo", "--policies", "nearest,hold", "--busy", "0,2", "--seconds", "4.25", "--json"]);
    let mut bench = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the program starts");
    let (start, mut most) = (Instant::now(), 0);
    while bench.try_wait().expect("a process").is_none() && start.elapsed() < Duration::from_secs(600) {
        most = most.max(busy());
        std::thread::sleep(Duration::from_millis(20));
    }
    let rows = rows_of(&bench.wait_with_output().expect("a process"));
    assert_eq!((most, busy()), (2, 0));
    let named = rows.iter().map(|row| (row["policy"].as_str().expect("a name"), number(row, "/busy")));
    assert_eq!(named.collect::<Vec<_>>(), [("hold", 0.0), ("nearest", 0.0), ("hold", 2.0), ("nearest", 2.0)]);
    for pair in rows.chunks(2) {
        for row in pair {
            // Ten reports a second.
            assert!(number(row, "/count") >= 5.0, "{row}");
            let blamed = row["over_budget_by"].as_object().unwrap().values().filter_map(Value::as_f64).sum::<f64>();
            assert_eq!(blamed, number(row, "/over_budget"), "{row}");
            let share = number(row, "/over_budget") / number(row, "/count");
            assert!((number(row, "/share") - share).abs() < 1e-12, "{row}");
            let above = number(row, "/share") - number(&pair[0], "/share");
            assert!((number(row, "/above_hold") - above).abs() < 1e-12, "{row}");
        }
    }
}

#[test]
fn a_growing_number_of_users_is_measured_for_several_arrays_and_a_wall_is_divided_for_one_only() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("two.toml");
    let arrays = "[[mirrors]]\nrows = 2\ncolumns = 3\n[[mirrors]]\nrows = 2\ncolumns = 4\nwall = \"-x\"\n";
    fs::write(&file, arrays).expect("written");
    let scenario = ["--scenario", file.to_str().expect("a plain path")];
    let quick = ["--policy", "nearest", "--hz", "0", "--decisions", "100"];
    let rows = rows(&[&["users"], &scenario[..], &quick].concat());
    assert!(!rows.is_empty() && rows.iter().all(|row| number(row, "/mirrors") == 14.0), "{rows:?}");
    for (arguments, advice) in [
        (&["bench", "mirrors"][..], "divides the wall of one array"),
        (&["calibrate", "--array", "2", "--seeds", "1", "--episodes", "1"], "expected an index from 0 to 1"),
    ] {
        let output = Command::new(env!("CARGO_BIN_EXE_heliostat-lab")).args(arguments).args(scenario).output();
        let output = output.expect("the program starts");
        let message = String::from_utf8(output.stderr).expect("text");
        assert!(!output.status.success() && message.contains(advice), "{message}");
    }
}
