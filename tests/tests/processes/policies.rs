//! Every policy by its name, in a short demo.

use heliostat_tests::Process;
use serde_json::Value;

/// Policies that run in the default room; the oracle takes too long for each tick.
const QUICK: [&str; 9] = ["fixed-point", "greedy", "sine-cosine", "pso", "nearest", "random", "flat", "no-irs", "hold"];

/// Learned policies, built in or not.
const LEARNED: [&str; 6] = ["ddpg", "ddpg-raw", "analytic", "dql", "q-learning", "sarsa"];

/// A room small enough for the exhaustive search.
const SMALL: [&str; 6] = ["--set", "mirrors.rows=3", "--set", "mirrors.columns=3", "--set", "users.count=3"];

fn demo(policy: &str, more: &[&str]) -> Process {
    let first = ["demo", "--scenario", "specular", "--policy", policy, "--seconds", "2", "--json"];
    // A slow machine answers each report before the next one, and no decision is late.
    let slow = [
        "--set",
        "streams.positions.rate_hz=20",
        "--set",
        "streams.channel.rate_hz=20",
        "--set",
        "control.deadline_ms=1000",
    ];
    Process::heliostat(&[&first[..], &slow, more].concat())
}

fn assert_ran(summary: &Value, policy: &str) {
    assert_eq!(summary["policy"], policy, "{summary}");
    assert!(summary["commands"].as_u64().is_some_and(|commands| commands > 0), "{policy}: {summary}");
    // A stalled machine, and a first tick before the first channel report, cause single fallbacks.
    let decisions = summary["decisions"].as_u64().expect("a number");
    let others: u64 = summary["fallbacks"].as_object().expect("an object").values().filter_map(Value::as_u64).sum();
    assert!(2 * others < decisions, "{policy}: {summary}");
}

#[test]
fn every_policy_that_needs_no_file_runs_by_its_name() {
    for policy in QUICK {
        assert_ran(&demo(policy, &[]).wait().json(), policy);
    }
    assert_ran(&demo("exhaustive", &SMALL).wait().json(), "exhaustive");
}

#[test]
fn every_learned_policy_runs_or_names_the_training_command() {
    for policy in LEARNED {
        let finished = demo(policy, &[]).wait();
        if finished.status.success() {
            assert_ran(&finished.json(), policy);
        } else {
            assert!(policy != "ddpg", "{}", finished.errors);
            let train = format!("heliostat-lab train {policy}");
            assert!(finished.errors.contains(&train), "{policy}: {}", finished.errors);
        }
    }
}

#[test]
fn the_exhaustive_search_refuses_a_large_room_at_the_start() {
    let finished = demo("exhaustive", &[]).wait();
    assert!(finished.refusal().contains("use the policy oracle"), "{}", finished.errors);
}
