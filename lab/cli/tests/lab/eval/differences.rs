//! Paired differences of `heliostat-lab eval`.

use super::{eval, mean, report};

#[test]
fn every_policy_and_belief_has_paired_differences_from_the_first_row() {
    let loop_flags = ["--closed-loop", "--scenario", "hall", "--states", "60", "--seeds", "1"];
    let flags = [&loop_flags[..], &["--policies", "greedy,flat", "--beliefs", "none,filter"]].concat();
    let compared = report(&flags);
    let first = "greedy+none";
    assert!(compared["policies"][first].get("difference_ratio").is_none());
    for name in ["greedy+filter", "flat"] {
        for (difference, figure) in [
            ("difference_ratio", "ratio_to_oracle"),
            ("difference_qos_met", "qos_met"),
            ("difference_mbps", "sum_rate_mbps"),
            ("difference_outage_time", "outage_time"),
        ] {
            let expected = mean(&compared, name, figure) - mean(&compared, first, figure);
            let found = &compared["policies"][name][difference];
            assert!((found["mean"].as_f64().expect("a mean") - expected).abs() < 1e-9, "{name} {difference}: {found}");
            assert!(found["ci95"].as_f64() > Some(0.0), "{name} {difference}: {found}");
        }
    }
    let of_oracle = |figure: &str| compared["oracle"][figure]["mean"].as_f64().expect("a figure of the oracle");
    for (difference, figure) in [("difference_mbps", "sum_rate_mbps"), ("difference_outage_time", "outage_time")] {
        let loss = of_oracle(figure) - mean(&compared, first, figure);
        assert!((of_oracle(difference) - loss).abs() < 1e-9, "the loss of the first policy, {difference}: {compared}");
    }
    let table = String::from_utf8(eval(&flags).stdout).expect("text");
    let [_, differences] = table.split("difference to greedy+none, paired").collect::<Vec<_>>()[..] else {
        panic!("no differences in {table}")
    };
    assert!(differences.contains("greedy+filter") && differences.contains(" +0."), "{table}");
    let of_oracle = differences.lines().nth(2).expect("the row of the oracle");
    assert!(of_oracle.starts_with("(oracle) ") && of_oracle.contains(" +"), "{table}");
    assert!(differences.lines().nth(1).is_some_and(|heads| heads.ends_with("QoS met          outage")), "{table}");
}
