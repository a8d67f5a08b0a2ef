//! The demo: two processes connected by the contract, mirrors that follow the users.

use std::process::Command;

use heliostat_bus::private_endpoint;
use heliostat_tests::{Process, RoomObserver, number, wait_until};
use serde_json::Value;

/// The summary of 8 s at 20 reports/s: a busy machine that stalls for less than the 50 ms between two
/// reports drops none of them, and a stall of some seconds lets no command expire.
fn demo(arguments: &[&str]) -> Value {
    let specular: &[&str] = if arguments.contains(&"--scenario") { &[] } else { &["--scenario", "specular"] };
    let rates = ["streams.positions.rate_hz=20", "streams.channel.rate_hz=20"];
    let patience = ["control.validity_ms=10000", "control.report_age_max_ms=10000"];
    let set: Vec<&str> = rates.into_iter().chain(patience).flat_map(|change| ["--set", change]).collect();
    let all = [&["demo", "--seconds", "8", "--json"], &set[..], specular, arguments].concat();
    Process::heliostat(&all).wait().json()
}

fn assert_complete(summary: &Value) {
    for time in ["decision_us", "loop_us"] {
        let quantiles = ["p50", "p90", "p99", "p999", "max"].map(|name| number(summary, &format!("/{time}/{name}")));
        assert!(quantiles[0] > 0.0 && quantiles.is_sorted(), "{time}: {quantiles:?}");
    }
    for name in ["ticks", "commands", "lost_ticks", "over_budget", "ratio_to_oracle", "qos_met"] {
        number(summary, &format!("/{name}"));
    }
    assert!(number(summary, "/commands") >= 10.0, "{summary}");
    assert!(number(summary, "/lost_ticks") < number(summary, "/ticks"), "{summary}");
    let refused = summary["refused_by_room"].as_object().expect("an object");
    assert!(!refused.keys().any(|name| name.starts_with("command:")), "{summary}");
    // The room ends first, and the notice of its end may arrive before its last reports.
    let refused = summary["refused_by_controller"].as_object().expect("an object");
    assert!(refused.keys().all(|name| name.ends_with(":source-gone")), "{summary}");
}

#[test]
fn the_built_in_actor_raises_the_rate_of_blocked_users() {
    let summary = demo(&["--policy", "ddpg", "--set", "blockage.forced_users=2"]);
    assert_complete(&summary);
    // A stalled machine delays a decision; the policy itself does not fail.
    let fallbacks = summary["fallbacks"].as_object().expect("an object");
    assert!(fallbacks.keys().all(|name| name == "late"), "{summary}");
    let (policy, no_irs) = (number(&summary, "/sum_rate_mbps/policy"), number(&summary, "/sum_rate_mbps/no_irs"));
    assert!(policy > 1.5 * no_irs, "{summary}");
    assert!(number(&summary, "/ratio_to_oracle") > 0.85, "{summary}");
    assert!(number(&summary, "/sum_rate_mbps/flat") <= number(&summary, "/sum_rate_mbps/oracle"), "{summary}");
}

#[test]
fn model_based_policies_need_no_actor() {
    for (policy, least) in [("fixed-point", 0.9), ("nearest", 0.5)] {
        let summary = demo(&["--policy", policy, "--set", "blockage.forced_users=2"]);
        assert_complete(&summary);
        assert_eq!(summary["policy"], policy);
        assert!(number(&summary, "/ratio_to_oracle") > least, "{summary}");
    }
}

#[test]
fn the_paper_scenario_runs_in_the_same_loop() {
    let summary = demo(&["--scenario", "deploy/scenarios/paper.toml"]);
    assert_complete(&summary);
    assert!(number(&summary, "/ratio_to_oracle") > 0.95, "{summary}");
}

#[test]
fn another_room_works_and_an_actor_of_another_shape_is_refused() {
    let other = [
        "--set",
        "mirrors.rows=7",
        "--set",
        "mirrors.columns=7",
        "--set",
        "users.count=3",
        "--set",
        "noise.variance_a2=2e-14",
    ];
    assert_complete(&demo(&other));

    let odd = ["--set", "mirrors.rows=6", "--set", "mirrors.columns=9"];
    let learned = ["demo", "--policy", "ddpg-raw", "--seconds", "3", "--json"];
    let arguments: Vec<&str> = learned.into_iter().chain(odd).collect();
    let ended = Process::heliostat(&arguments).wait();
    let refusal = ended.refusal();
    assert!(refusal.contains("nothing was started") && refusal.contains("heliostat-lab train ddpg"), "{refusal}");
    assert!(refusal.contains("fixed-point"), "it names a policy that needs no training: {refusal}");

    let with_model: Vec<&str> = odd.into_iter().chain(["--policy", "fixed-point"]).collect();
    assert_complete(&demo(&with_model));
}

#[test]
fn an_invalid_scenario_is_refused_before_any_process_starts() {
    let ended = Process::heliostat(&["demo", "--set", "mirrors.reflectivity=2"]).wait();
    assert!(ended.refusal().contains("mirrors.reflectivity = 2"), "{}", ended.errors);
    assert!(!ended.errors.contains("is process"), "{}", ended.errors);
}

/// Sends a signal to a process of a demo.
fn signal(demo: &Process, command: &str, name: &str) {
    let errors = demo.errors();
    let (_, rest) = errors.split_once(&format!("{command} is process ")).expect("the process is named");
    let process = rest.split_whitespace().next().expect("an id");
    assert!(Command::new("kill").arg(format!("-{name}")).arg(process).status().unwrap().success());
}

#[test]
fn a_demo_for_a_user_stays_without_a_process_and_has_the_command_that_starts_it_again() {
    // A process that ends in order is missing too.
    for (killed, name, status) in [("controller", "KILL", "signal: 9"), ("sim-node", "TERM", "exit status: 0")] {
        let mut demo = Process::heliostat(&["demo", "--plain", "--no-ui", "--policy", "fixed-point"]);
        wait_until("answered reports", || demo.errors().contains("the mirrors answer reports"));
        signal(&demo, killed, name);
        let before =
            format!("the {killed} process has ended; the demo goes on until Ctrl-C. To start it again: heliostat ");
        wait_until("the command", || demo.errors().split_once(&before).is_some_and(|(_, rest)| rest.contains('\n')));
        let errors = demo.errors();
        let command = errors.split_once(&before).and_then(|(_, rest)| rest.lines().next()).expect("a command");
        let words: Vec<&str> = command.split(' ').chain(["--exit-with-parent"]).collect();
        let _again = Process::heliostat(&words);
        let endpoints = errors.split("tcp/").skip(1).take(2).filter_map(|rest| rest.split([',', ';', ' ']).next());
        let endpoints: Vec<String> = endpoints.map(|address| format!("tcp/{address}")).collect();
        RoomObserver::connect("demo", &[&endpoints[0], &endpoints[1]]).wait_for_commands();
        assert!(demo.is_running(), "{}", demo.errors());
        demo.signal("INT");
        let ended = demo.wait_mut();
        assert_eq!(ended.status.code(), Some(1), "{}", ended.errors);
        assert!(ended.errors.contains(&format!("the {killed} process ended early ({status}")), "{}", ended.errors);
    }
}

#[test]
fn a_demo_whose_process_is_killed_names_it_prints_what_the_other_measured_and_fails() {
    for (killed, measured) in [("controller", "loop_us"), ("sim-node", "decision_us")] {
        let mut demo = Process::heliostat(&["demo", "--json", "--policy", "fixed-point"]);
        wait_until("answered reports", || demo.errors().contains("the mirrors answer reports"));
        signal(&demo, killed, "KILL");
        let ended = demo.wait_mut();
        assert_eq!(ended.status.code(), Some(1), "{}", ended.errors);
        assert!(ended.errors.contains(&format!("the {killed} process ended early (signal: 9")), "{}", ended.errors);
        assert!(!ended.errors.contains("heliostat_"), "no line names a module: {}", ended.errors);
        let summary: Value = serde_json::from_str(ended.output.trim()).expect("a summary");
        assert!(number(&summary, &format!("/{measured}/p50")) > 0.0, "{summary}");
    }
}

#[test]
fn the_status_of_a_room_is_healthy_while_its_mirrors_follow_and_names_a_stop_or_a_missing_process() {
    let [room_at, controller_at] = [private_endpoint().unwrap(), private_endpoint().unwrap()];
    let status = |arguments: &[&str]| {
        Process::heliostat(&[&["status", "--connect", &room_at, "--connect", &controller_at], arguments].concat())
            .wait()
    };
    let alone = status(&[]);
    assert!(alone.refusal().contains("Give --connect the endpoints of the room's process"), "{}", alone.errors);
    let slow = ["streams.positions.rate_hz=20", "control.validity_ms=10000", "control.report_age_max_ms=10000"];
    let slow = slow.map(|key| ["--set", key]).concat();
    let both = |arguments: &[&str]| Process::heliostat(&[arguments, &["--exit-with-parent"], &slow].concat());
    let _room = both(&["sim-node", "--listen", &room_at]);
    wait_until("a missing controller to be named", || {
        let ended = status(&[]);
        ended.output.contains("problem      no controller: ") && ended.status.code() == Some(1)
    });
    let _controller =
        both(&["controller", "--connect", &room_at, "--listen", &controller_at, "--policy", "fixed-point"]);
    // A busy machine delays reports, which is a problem for as long as a process reports it.
    let mut text = String::new();
    wait_until("a healthy room", || {
        let ended = status(&[]);
        text = ended.output;
        ended.status.success()
    });
    for part in [": healthy", " leads\n", "array        following, 100 mirrors", "stops        none"] {
        assert!(text.contains(part), "{part} in {text}");
    }
    // One process passes on what the other one says: the commands of these two are connected.
    for endpoint in [&room_at, &controller_at] {
        wait_until("the same through one process", || {
            text = Process::heliostat(&["status", "--connect", endpoint]).wait().output;
            text.contains(" leads\n") && text.contains("array        following, 100 mirrors")
        });
    }
    assert!(Process::heliostat(&["stop", "--connect", &controller_at]).wait().status.success());
    wait_until("the stop as the one problem", || {
        let stopped = status(&["--json"]);
        let found: Value = serde_json::from_str(stopped.output.trim()).expect("one JSON object");
        assert_eq!((stopped.status.code(), found["is_healthy"].as_bool()), (Some(1), Some(false)), "{found}");
        let problems = found["problems"].as_array().expect("a list");
        problems.len() == 1 && problems[0].as_str().is_some_and(|problem| problem.contains(" has stopped: stop "))
    });
}
