//! The metrics of running processes, and the dashboard that draws them.

use std::collections::BTreeSet;
use std::fs;
use std::net::SocketAddr;

use heliostat_bus::{free_loopback_port, private_endpoint};
use heliostat_tests::{Process, fetch_metrics, sample_value, wait_until, workspace};

fn free_address() -> SocketAddr {
    SocketAddr::from(([127, 0, 0, 1], free_loopback_port().expect("a free port")))
}

/// Whether a metric is one of the project, or a standard one of a process.
fn is_metric(name: &str) -> bool {
    name.starts_with("heliostat_") || name.starts_with("process_")
}

/// Names of all samples of a page, without labels.
fn names(page: &str) -> BTreeSet<String> {
    let samples = page.lines().filter(|line| is_metric(line));
    samples.filter_map(|line| line.split(['{', ' ']).next()).map(str::to_owned).collect()
}

/// Every name that the dashboard uses, in expressions and variables alike.
fn names_of_dashboard() -> BTreeSet<String> {
    let text = read("deploy/grafana/heliostat.json");
    serde_json::from_str::<serde_json::Value>(&text).expect("the dashboard is JSON");
    names_in(&text)
}

fn read(file: &str) -> String {
    let file = workspace().join(file);
    fs::read_to_string(&file).unwrap_or_else(|error| panic!("{}: {error}", file.display()))
}

/// Every name of a metric in a text.
fn names_in(text: &str) -> BTreeSet<String> {
    text.split(|c: char| !c.is_ascii_alphanumeric() && c != '_')
        .filter(|word| is_metric(word))
        .map(str::to_owned)
        .collect()
}

/// Every line of a log is a JSON object with level and time.
fn assert_json(log: &str) {
    for line in log.lines() {
        let entry: serde_json::Value = serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}"));
        assert!(entry["level"].is_string() && entry["timestamp"].is_string(), "{line}");
    }
}

/// The first line of a log names the program and its version.
fn assert_version(log: &str) {
    let first = log.lines().next().unwrap_or_default();
    assert!(first.contains(concat!("\"heliostat ", env!("CARGO_PKG_VERSION"), "\"")), "no version: {first}");
}

#[test]
fn the_dashboard_uses_metrics_that_a_running_room_serves() {
    let (room_at, controller_at, recorder_at) = (free_address(), free_address(), free_address());
    let endpoint = private_endpoint().expect("an endpoint");
    let (room_text, controller_text) = (room_at.to_string(), controller_at.to_string());
    let folder = tempfile::tempdir().expect("a folder");
    let state = folder.path().display().to_string();
    let flags = ["--metrics-listen", &room_text, "--exit-with-parent", "--start-armed", "--state", &state];
    let room = Process::heliostat(&[&["sim-node", "--listen", &endpoint], &flags[..]].concat());
    let controller = Process::heliostat(&[
        "controller",
        "--connect",
        &endpoint,
        "--policy",
        "fixed-point",
        "--metrics-listen",
        &controller_text,
        "--log-format",
        "json",
        "--exit-with-parent",
    ]);
    let (out, recorder_text) = (folder.path().join("room.mcap").display().to_string(), recorder_at.to_string());
    let flags = ["--out", &out, "--metrics-listen", &recorder_text, "--exit-with-parent"];
    let recorder = Process::heliostat(&[&["record", "--connect", &endpoint], &flags[..]].concat());
    wait_until("messages on the page of the recorder", || {
        sample_value(&fetch_metrics(recorder_at), "heliostat_recorder_messages_total") > 10.0
    });
    wait_until("rates, decisions and light on both pages", || {
        sample_value(&fetch_metrics(controller_at), "heliostat_decisions_total") > 10.0
            && sample_value(&fetch_metrics(room_at), "heliostat_sum_rate_bps{room=\"demo\",angles=\"oracle\"}") > 0.0
            && sample_value(&fetch_metrics(room_at), "heliostat_room_commands_total") > 10.0
            && sample_value(&fetch_metrics(controller_at), "heliostat_light_off") >= 0.0
    });
    let (room_page, controller_page) = (fetch_metrics(room_at), fetch_metrics(controller_at));
    let recorder_page = fetch_metrics(recorder_at);
    for (page, process) in [(&room_page, &room), (&controller_page, &controller)] {
        let resident = sample_value(page, "process_resident_memory_bytes");
        assert!((1e6..1e9).contains(&resident), "process {}: {resident} bytes", process.id());
    }
    let count = sample_value(&controller_page, "heliostat_decision_seconds_count");
    assert!(count > 0.0, "{controller_page}");
    assert_eq!(count, sample_value(&controller_page, "heliostat_decision_seconds_bucket{le=\"+Inf\",room=\"demo\"}"));
    assert!(controller_page.contains("heliostat_policy_info{room=\"demo\",policy=\"fixed-point\"} 1"));
    assert!(
        controller_page.contains("content-type: application/openmetrics-text")
            || controller_page.contains("Content-Type: application/openmetrics-text")
    );
    assert!(sample_value(&room_page, "heliostat_loop_seconds_count") > 0.0, "{room_page}");

    // Refusals of the array appear with the first one, and the end of a certificate with keys, so those names are known
    // from the sources.
    let by_cause = [
        "heliostat_room_refused_total",
        "heliostat_certificate_end_timestamp_seconds",
        "heliostat_router_certificate_end_timestamp_seconds",
    ];
    let pages = [room_page.as_str(), controller_page.as_str(), recorder_page.as_str()];
    let mut known: BTreeSet<String> = pages.into_iter().flat_map(names).collect();
    let files = ["crates/service/src/page.rs", "crates/service/src/exporter.rs", "crates/service/src/exporter.rs"];
    for (name, file) in by_cause.into_iter().zip(files) {
        assert!(
            read(file).contains(&format!("\"{}\"", name.trim_end_matches("_total"))),
            "{name} is not made in {file}"
        );
        known.insert(name.to_owned());
    }
    let drawn = names_of_dashboard();
    assert!(drawn.len() > 15, "{drawn:?}");
    let unknown: Vec<_> = drawn.difference(&known).collect();
    assert!(unknown.is_empty(), "the dashboard names unknown metrics: {unknown:?}");

    assert_eq!(sample_value(&room_page, "heliostat_stop_recorded"), 1.0);
    assert!(room_page.contains("heliostat_array_state_info{room=\"demo\",state=\""), "{room_page}");
    let alerts = names_in(&read("deploy/prometheus/alerts.yml"));
    assert!(alerts.len() > 8, "{alerts:?}");
    let unknown: Vec<_> = alerts.difference(&known).collect();
    assert!(unknown.is_empty(), "the alert rules name unknown metrics: {unknown:?}");

    let ended = controller.end();
    assert!(ended.status.success(), "{}", ended.errors);
    assert_json(&ended.errors);
    recorder.end();
    room.end();
}

#[test]
fn a_driver_serves_metrics_and_logs_as_json() {
    let (metrics_at, board_at) = (free_address(), free_address());
    let endpoint = private_endpoint().expect("an endpoint");
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("array.toml");
    // Nothing answers at the board's address, which the driver reports and tries again.
    let config = format!(
        "rows = 1\ncolumns = 1\n[[boards]]\nkind = \"servo-board\"\naddress = \"tcp:{board_at}\"\n\
         min_deg = -30.0\nmax_deg = 30.0\nmeasures = false\nmirrors = [0]\n"
    );
    fs::write(&file, config).expect("a file");
    let (file, metrics) = (file.display().to_string(), metrics_at.to_string());
    let state = folder.path().display().to_string();
    let flags = ["--metrics-listen", &metrics, "--log-format", "json", "--exit-with-parent", "--listen", &endpoint];
    let flags = [&flags[..], &["--state", &state]].concat();
    let driver = Process::heliostat(&[&["driver", "run", "--config", &file], &flags[..]].concat());
    wait_until("the driver's metrics", || {
        let page = fetch_metrics(metrics_at);
        page.contains("heliostat_device_connections_total{room=\"demo\"} 0")
            && page.contains("heliostat_array_state_info{room=\"demo\",state=\"")
            && page.contains("process=\"driver\"")
            && page.contains("heliostat_stop_recorded{room=\"demo\"} 1")
    });
    let ended = driver.end();
    assert!(ended.status.success(), "{}", ended.errors);
    assert!(ended.errors.lines().count() > 1, "{}", ended.errors);
    assert_version(&ended.errors);
    assert_json(&ended.errors);
}

#[test]
fn a_page_logs_as_json() {
    let endpoint = private_endpoint().expect("an endpoint");
    for flags in [&["--quiet"][..], &[]] {
        let given = ["ui", "--log-format", "json", "--ui-port", "0", "--connect", &endpoint];
        let page = Process::heliostat(&[&given[..], flags].concat());
        wait_until("the address of the page", || page.errors().contains("the page is at http://"));
        page.signal("TERM");
        let ended = page.wait();
        assert!(ended.status.success(), "{}", ended.errors);
        assert_version(&ended.errors);
        assert_json(&ended.errors);
    }
}
