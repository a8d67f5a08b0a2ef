//! Drivers across processes: the simulated array keeps the contract, and one written in Python does so and is led by the controller.

use heliostat_bus::free_loopback_endpoint;
use heliostat_tests::Process;
use serde_json::Value;

/// A Python interpreter that has the package `eclipse-zenoh`; none where it is missing and not required.
fn python() -> Option<String> {
    let python = std::env::var("HELIOSTAT_PYTHON").unwrap_or_else(|_| "python3".into());
    let found = std::process::Command::new(&python).args(["-c", "import zenoh; zenoh.Config"]).output();
    if found.is_ok_and(|output| output.status.success()) {
        return Some(python);
    }
    assert!(
        std::env::var_os("HELIOSTAT_REQUIRE_PYTHON").is_none(),
        "{python} has no package eclipse-zenoh, which is required where HELIOSTAT_REQUIRE_PYTHON is set"
    );
    println!(
        "skipped: {python} has no package eclipse-zenoh (pip install eclipse-zenoh; HELIOSTAT_PYTHON names another)"
    );
    None
}

/// Verdicts by rule.
fn check(arguments: &[&str]) -> Vec<(String, String)> {
    let all: Vec<&str> = ["driver", "check", "--json"].iter().chain(arguments).copied().collect();
    let ended = Process::heliostat(&all).wait();
    assert!(ended.status.success(), "{} {}", ended.output, ended.errors);
    let report: Value = serde_json::from_str(&ended.output).expect("the report is JSON");
    let text = |finding: &Value, name: &str| finding[name].as_str().expect("a text").to_owned();
    let findings = report["findings"].as_array().expect("a list").iter();
    findings.map(|finding| (text(finding, "rule"), text(finding, "verdict"))).collect()
}

#[test]
fn the_simulated_array_keeps_every_rule() {
    let endpoint = free_loopback_endpoint().unwrap();
    let _room = Process::heliostat(&["sim-node", "--room", "sim", "--listen", &endpoint, "--exit-with-parent"]);
    let verdicts = check(&["--connect", &endpoint, "heliostat/v1/sim/mirrors/command"]);
    assert!(verdicts.len() > 15 && verdicts.iter().all(|(_, verdict)| verdict == "kept"), "{verdicts:?}");
}

#[test]
fn an_empty_room_has_nobody_to_check() {
    let endpoint = free_loopback_endpoint().unwrap();
    let ended = Process::heliostat(&["driver", "check", "--room", "empty", "--listen", &endpoint]).wait();
    assert!(ended.refusal().contains("nobody in room \"empty\""), "{}", ended.errors);
}

#[test]
fn a_driver_in_python_keeps_every_rule() {
    let Some(python) = python() else { return };
    let endpoint = free_loopback_endpoint().unwrap();
    let mut driver = std::process::Command::new(python)
        .args(["examples/driver.py", "python", &endpoint, "2", "3", "60"])
        .current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
        .spawn()
        .unwrap();
    let verdicts = check(&["--listen", &endpoint, "--room", "python"]);
    driver.kill().unwrap();
    driver.wait().unwrap();
    assert!(verdicts.iter().all(|(_, verdict)| verdict == "kept"), "{verdicts:?}");
}
