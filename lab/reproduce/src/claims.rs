//! The statements of the paper, the finding for each room, and a verdict.
//!
//! Each verdict follows from the figures by a rule in `claims/rules.rs`.

mod rules;

use crate::figure::Figure;
use crate::figures::{ber_snr, inference, sum_rate_iterations, sum_rate_power};
use crate::verdict::{Claim, Finding};
use rules::RuleResult;

/// A statement: its figure, its text, the value of the paper, and the rule of its verdict.
type Rule = (&'static str, &'static str, &'static str, fn(&Figure) -> Option<RuleResult>);

/// Every statement, in the order of the table.
const RULES: [Rule; 10] = [
    (sum_rate_power::ID, "sum rate of the proposed DRL at 2 W, two users blocked", "19.2 Mbit/s", rules::drl_rate),
    (
        sum_rate_power::ID,
        "sum rate of the benchmark (random, fixed) at 2 W, two users blocked",
        "10 Mbit/s",
        rules::benchmark_rate,
    ),
    (sum_rate_power::ID, "gain of DRL over the benchmark", "\"48 %\"; 19.2 against 10 is +92 %", rules::gain),
    (sum_rate_iterations::ID, "DRL outperforms DQL", "in words and Fig4", rules::beats_dql),
    (sum_rate_iterations::ID, "performance near the optimum", "\"near-optimal\"", rules::near_optimal),
    (
        sum_rate_iterations::ID,
        "the sum rate grows with the number of mirrors (7 x 7 to 10 x 10)",
        "in words and Fig4",
        rules::grows,
    ),
    (ber_snr::ID, "error rate at 15 dB as speed grows", "1e-4 to 1e-1", rules::error_rates),
    (ber_snr::ID, "error rate as the SNR grows", "below 1e-3", rules::error_floor),
    (inference::ID, "time for a decision", "0.5 ms", rules::decision_time),
    (inference::ID, "faster than traditional optimisation", "in words", rules::faster),
];

/// All claims for which there are figures.
pub fn claims(figures: &[Figure]) -> Vec<Claim> {
    let claim = |(id, statement, paper, rule): Rule| {
        let found = figures.iter().filter(|figure| figure.id == id);
        let findings: Vec<Finding> = found.filter_map(|figure| Some(rule(figure)?.finding(id, &figure.room))).collect();
        let (figure, statement, paper) = (id.to_owned(), statement.to_owned(), paper.to_owned());
        (!findings.is_empty()).then_some(Claim { figure, statement, paper, findings })
    };
    RULES.into_iter().filter_map(claim).collect()
}

impl RuleResult {
    fn finding(self, id: &str, room: &str) -> Finding {
        let Self(ours, verdict, why) = self;
        Finding { room: room.into(), ours, verdict, why, calibrated: calibrated(id, room).into() }
    }
}

/// The parameters that were calibrated to the paper in a room.
fn calibrated(id: &str, room: &str) -> &'static str {
    match (id, room) {
        (ber_snr::ID, _) => "delay picked among five; interval and latency are not in the paper",
        (inference::ID, _) => "nothing",
        (_, "specular") => "nothing; noise itemised from the literature",
        (_, "paper") => "noise (8.9e-14 A2), so that random gives 10 Mbit/s",
        (_, "paper-calibrated") => {
            "noise (2.9e-13 A2) and a factor of 85 on every mirror's gain, for 10 and 19.2 Mbit/s"
        }
        _ => "see its scenario file",
    }
}
