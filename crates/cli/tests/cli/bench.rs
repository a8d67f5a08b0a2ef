//! The latency benchmarks: their output and their counts. No time is asserted.

use std::fs;
use std::process::{Command, Output};

use serde_json::Value;

fn rows(arguments: &[&str]) -> Vec<Value> {
    let output = Command::new(env!("CARGO_BIN_EXE_heliostat")).arg("bench").args(arguments).arg("--json").output();
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

fn assert_complete(row: &Value) {
    for part in ["measured_us", "reference_us"] {
        let times = ["p50", "p90", "p99", "p999", "max"].map(|name| number(row, &format!("/{part}/{name}")));
        assert!(times[0] > 0.0 && times.is_sorted(), "{part}: {row}");
    }
    for quantile in ["p50", "p99"] {
        let quotient =
            number(row, &format!("/measured_us/{quantile}")) / number(row, &format!("/reference_us/{quantile}"));
        assert!((quotient / number(row, &format!("/ratio_{quantile}")) - 1.0).abs() < 1e-9, "{row}");
    }
    for name in ["mirrors", "users", "rooms", "count", "over_budget"] {
        number(row, &format!("/{name}"));
    }
    assert!(row["policy"].is_string() && row.get("hz").is_some(), "{row}");
}

#[test]
fn decisions_are_counted_and_each_miss_has_its_stage() {
    let rows = rows(&["decide", "--policy", "nearest", "--hz", "1000,0", "--decisions", "600"]);
    assert_eq!(rows.len(), 2);
    for row in &rows {
        assert_complete(row);
        assert_eq!(number(row, "/count"), 600.0, "{row}");
        let blamed = row["over_budget_by"].as_object().unwrap().values().filter_map(Value::as_f64).sum::<f64>();
        assert_eq!(blamed, number(row, "/over_budget"), "{row}");
    }
    assert_eq!((number(&rows[0], "/hz"), &rows[1]["hz"]), (1000.0, &Value::Null));
}

#[test]
fn a_room_is_served_by_one_process_beside_an_echo() {
    let rows = rows(&["loop", "--policy", "nearest", "--hz", "50", "--seconds", "5"]);
    assert_eq!(rows.len(), 1);
    for row in &rows {
        assert_complete(row);
        assert!(number(row, "/count") + number(row, "/lost") >= 25.0, "{row}");
        assert!(number(row, "/decision_us/p50") < number(row, "/measured_us/p50") * 1.5, "{row}");
    }
}

#[test]
fn decisions_for_several_arrays_are_measured() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("two.toml");
    let arrays = "[[mirrors]]\nrows = 2\ncolumns = 3\n[[mirrors]]\nrows = 2\ncolumns = 4\nwall = \"-x\"\n";
    fs::write(&file, arrays).expect("written");
    let scenario = ["--scenario", file.to_str().expect("a plain path")];
    let quick = ["--policy", "nearest", "--hz", "0", "--decisions", "100"];
    let rows = rows(&[&["decide"], &scenario[..], &quick].concat());
    assert!(!rows.is_empty() && rows.iter().all(|row| number(row, "/mirrors") == 14.0), "{rows:?}");
    rows.iter().for_each(assert_complete);
    let refused = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_heliostat")).args(arguments).args(scenario).output();
        let output = output.expect("the program starts");
        assert!(!output.status.success(), "{arguments:?}");
        String::from_utf8(output.stderr).expect("text")
    };
    let message = refused(&["bench", "loop", "--policy", "nearest"]);
    assert!(message.contains("2 mirror arrays") && message.contains("bench decide takes several"), "{message}");

    // The requirements of an actor, for all mirrors of the room.
    let mut command = Command::new(env!("CARGO_BIN_EXE_heliostat"));
    let ports = command.args(["config", "--as-json", "actor"]).args(scenario).output().expect("the program starts");
    let ports: Value = serde_json::from_slice(&ports.stdout).expect("one JSON object");
    assert_eq!(ports.pointer("/output/shape"), Some(&serde_json::json!([1, 28])), "{ports}");
}
