//! Two lockstep runs with the same seed are equal bit for bit across processes.

use heliostat_bus::private_endpoint;
use heliostat_tests::Process;

fn hash(policy: &str, seed: &str) -> String {
    let endpoint = private_endpoint().expect("an endpoint");
    let room = Process::heliostat(&["sim-node", "--lockstep", "300", "--seed", seed, "--listen", &endpoint, "--json"]);
    let controller = Process::heliostat(&[
        "controller",
        "--lockstep",
        "--seed",
        seed,
        "--policy",
        policy,
        "--connect",
        &endpoint,
        "--exit-with-parent",
        "--json",
    ]);
    let summary = room.wait().json();
    controller.end().json();
    assert_eq!(summary["commands"].as_u64(), Some(300), "{summary}");
    summary["hash"].as_str().expect("a lockstep run has a hash").to_string()
}

#[test]
fn equal_seeds_give_equal_runs_and_other_seeds_other_runs() {
    for policy in ["actor", "fixed-point"] {
        let first = hash(policy, "7");
        assert_eq!(first, hash(policy, "7"), "{policy}");
        assert_ne!(first, hash(policy, "8"), "{policy}");
    }
}
