//! The result of a run, as JSON and as a short table.

use std::collections::BTreeMap;
use std::fmt;

use heliostat_array::refusal_counts;
use heliostat_proto::Quantiles;
use heliostat_room::baselines::RateCounters;
use heliostat_room::world::arrivals::Turnover;
use heliostat_service::printable::printable;
use serde::{Deserialize, Serialize};

use crate::coverage::Covered;

/// Mean sum rates in Mbit/s over the same instants.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SumRatesMbps {
    /// With the angles of the policy.
    pub policy: f64,
    /// Without the array.
    pub no_irs: f64,
    /// With all mirrors flat.
    pub flat: f64,
    /// With the angles of the oracle.
    pub oracle: f64,
}

/// How often the controller's belief held the true place of a user.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct BeliefSummary {
    /// Believed places that were compared.
    pub places: u64,
    /// Those whose ellipse of 50 % held the true place.
    pub inside_50: u64,
    /// Those whose ellipse of 95 % held the true place.
    pub inside_95: u64,
}

impl BeliefSummary {
    /// `None` where no belief was compared.
    pub(crate) fn of(covered: Covered) -> Option<Self> {
        let Covered { places, inside: [inside_50, inside_95] } = covered;
        (places > 0).then_some(Self { places, inside_50, inside_95 })
    }
}

/// The result of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Summary {
    /// Name of the scenario.
    pub scenario: String,
    /// Hash of the effective scenario.
    pub scenario_hash: String,
    /// Seed of the run.
    pub seed: u64,
    /// Position reports published.
    pub ticks: u64,
    /// Ticks before the first answer: no controller was in the room yet. Also those without one during a stop of all
    /// arrays. Ticks after the last controller ended are lost.
    pub unattended_ticks: u64,
    /// Ticks that no accepted command answered in time, without those during a stop of all arrays.
    pub lost_ticks: u64,
    /// Ticks whose answer was awaited when a signal ended the run.
    pub waiting_ticks: u64,
    /// Delayed ticks: published after their due time, or skipped because the next one was already
    /// due.
    pub late_ticks: u64,
    /// Commands accepted.
    pub commands: u64,
    /// Accepted commands with an angle beyond the range.
    pub clipped_commands: u64,
    /// Payloads and commands refused, by name.
    pub refused: BTreeMap<String, u64>,
    /// Time from the publication of a tick to the arrival of the command that answers it.
    pub loop_us: Quantiles,
    /// Instants at which rates were computed, from the first command on.
    pub truth_samples: u64,
    /// Instants and statuses that were not published to viewers, because earlier ones were still computed.
    pub skipped_instants: u64,
    /// Mean time to compute such an instant, with the oracle, in us.
    pub truth_us_mean: f64,
    /// Mean sum rates over those instants; absent before the first command.
    pub sum_rate_mbps: Option<SumRatesMbps>,
    /// Sum rate of the policy over that of the oracle; absent before the first command.
    pub ratio_to_oracle: Option<f64>,
    /// Share of users and instants with the minimum rate met.
    pub qos_met: Option<f64>,
    /// The same with the oracle's angles.
    pub qos_met_oracle: Option<f64>,
    /// Mean number of users whose direct path is blocked.
    pub blocked_users_mean: f64,
    /// The users who entered and left; absent where the users stay.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub turnover: Option<Turnover>,
    /// The controller's belief against the truth; absent where the controller publishes none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub belief: Option<BeliefSummary>,
    /// Lockstep: hash of all commands and of all computed instants; the same seed gives the same
    /// hash.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hash: Option<String>,
    /// The last problem; empty if there was none.
    pub last_problem: String,
}

impl Summary {
    /// Sets the mean rates and shares from the computed instants.
    pub fn set_rates(&mut self, counters: &RateCounters) {
        let mean = counters.mean_sum_rates_bps();
        self.truth_samples = counters.samples;
        self.sum_rate_mbps = (counters.samples > 0).then_some(SumRatesMbps {
            policy: mean.policy * 1e-6,
            no_irs: mean.no_irs * 1e-6,
            flat: mean.flat * 1e-6,
            oracle: mean.oracle * 1e-6,
        });
        self.blocked_users_mean = counters.blocked_users_mean();
        if counters.samples > 0 {
            self.ratio_to_oracle = (mean.oracle > 0.0).then(|| mean.policy / mean.oracle);
            let (met, met_oracle) = counters.qos_met();
            self.qos_met = Some(met);
            self.qos_met_oracle = Some(met_oracle);
        }
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let share = |value: Option<f64>| value.map_or("-".into(), |value| format!("{value:.3}"));
        writeln!(f, "scenario        {} ({}), seed {}", self.scenario, self.scenario_hash, self.seed)?;
        writeln!(
            f,
            "ticks           {} ({} lost, {} late, {} unattended, {} waiting at the end)",
            self.ticks, self.lost_ticks, self.late_ticks, self.unattended_ticks, self.waiting_ticks
        )?;
        writeln!(f, "commands        {} ({} clipped)", self.commands, self.clipped_commands)?;
        let us = &self.loop_us;
        match us.count {
            0 => writeln!(f, "loop, us        -")?,
            _ => {
                writeln!(
                    f,
                    "loop, us        p50 {:.0}  p90 {:.0}  p99 {:.0}  max {:.0}",
                    us.p50, us.p90, us.p99, us.max
                )?;
            }
        }
        match &self.sum_rate_mbps {
            None => writeln!(f, "sum rate        unknown: no command was accepted")?,
            Some(rates) => writeln!(
                f,
                "sum rate Mbit/s policy {:.1}  no IRS {:.1}  flat {:.1}  oracle {:.1}",
                rates.policy, rates.no_irs, rates.flat, rates.oracle
            )?,
        }
        writeln!(f, "ratio to oracle {}", share(self.ratio_to_oracle))?;
        writeln!(f, "minimum rates   met {} (oracle {})", share(self.qos_met), share(self.qos_met_oracle))?;
        match self.truth_samples {
            0 => writeln!(f, "blocked users   -")?,
            _ => writeln!(f, "blocked users   {:.2} on average", self.blocked_users_mean)?,
        }
        if let Some(Turnover { entered, left, turned_away }) = self.turnover {
            writeln!(f, "users           {entered} entered, {left} left, {turned_away} found the room full")?;
        }
        if let Some(BeliefSummary { places, inside_50, inside_95 }) = self.belief {
            let percent = |inside: u64| 100.0 * inside as f64 / places as f64;
            let (half, most) = (percent(inside_50), percent(inside_95));
            writeln!(f, "belief          {half:.0} % within the ellipse of 50 %, {most:.0} % within that of 95 %")?;
        }
        if self.skipped_instants > 0 {
            writeln!(f, "not published   {} states for viewers: the processors were busy", self.skipped_instants)?;
        }
        for (name, count) in &self.refused {
            writeln!(f, "{}", refusal_counts::line(name, *count))?;
        }
        if let Some(hash) = &self.hash {
            writeln!(f, "hash            {hash}")?;
        }
        if !self.last_problem.is_empty() {
            writeln!(f, "last problem    {}", printable(&self.last_problem))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_run_has_a_sample_of_the_summary() {
        let guide = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/tutorials/first-run.md");
        let guide = std::fs::read_to_string(guide).expect("the guide");
        let words = [("COUNT on", "0.00 on"), ("COUNT", "0"), ("TIME", "0")];
        let words = words.into_iter().chain([("RATE", "0.0"), ("RATIO", "0.000"), ("SHARE", "0.000")]);
        let guide = words.fold(guide, |guide, (word, figure)| guide.replace(word, figure));
        let text = Summary {
            scenario: "hall".to_owned(),
            scenario_hash: "HASH".to_owned(),
            seed: 1,
            loop_us: Quantiles { count: 1, ..Quantiles::default() },
            truth_samples: 1,
            sum_rate_mbps: Some(SumRatesMbps::default()),
            ratio_to_oracle: Some(0.0),
            qos_met: Some(0.0),
            qos_met_oracle: Some(0.0),
            ..Summary::default()
        }
        .to_string();
        assert!(guide.contains(&text), "{text}");
    }

    #[test]
    fn what_was_not_counted_is_a_dash() {
        let text = Summary::default().to_string();
        for line in ["loop, us        -", "ratio to oracle -", "blocked users   -"] {
            assert!(text.lines().any(|found| found == line), "{text}");
        }
        let loop_us = Quantiles { count: 1, p50: 3.0, ..Quantiles::default() };
        let text = Summary { loop_us, truth_samples: 1, blocked_users_mean: 2.0, ..Summary::default() }.to_string();
        assert!(text.contains("loop, us        p50 3") && text.contains("blocked users   2.00 on average"), "{text}");
    }
}
