//! Duration of each stage of a decision: stamps of the monotonic clock, taken while deciding and
//! recorded after publication.
//!
//! Histograms are allocated once. A reader exchanges them for empty ones, so that no decision waits
//! for a quantile.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use hdrhistogram::Histogram;
use heliostat_proto::{Nanos, Quantiles};

use heliostat_core::core::Stage;
use heliostat_service::clock::as_ns;

/// Budget of a decision, from the entry of the callback to the end of the publication.
pub const BUDGET: Duration = Duration::from_micros(500);

/// Longest time that the histograms distinguish from longer ones: a minute, in ns.
const LONGEST_NS: u64 = 60_000_000_000;
/// Significant decimal digits of a recorded time.
const DIGITS: u8 = 3;

/// Upper edges of the buckets into which a status sorts decisions, in us.
const EDGES_US: [u64; 14] = [25, 50, 75, 100, 150, 200, 250, 300, 400, 500, 700, 1000, 2000, 5000];

/// The stamps of one decision.
#[derive(Clone, Copy, Debug)]
pub struct StageStamps {
    entered: Instant,
    last: Instant,
    stage_ns: [u64; Stage::ALL.len()],
}

impl StageStamps {
    /// Starts at the entry of the callback.
    pub fn start(entered: Instant) -> Self {
        Self { entered, last: entered, stage_ns: [0; Stage::ALL.len()] }
    }

    /// A stage ends now, and the next one begins.
    pub fn mark(&mut self, stage: Stage) {
        let now = Instant::now();
        self.stage_ns[stage as usize] = as_ns(now - self.last);
        self.last = now;
    }

    /// Time from the entry to `now`.
    pub fn waited(&self, now: Instant) -> Duration {
        now.saturating_duration_since(self.entered)
    }

    /// How long the stage took, in ns.
    pub fn stage_ns(&self, stage: Stage) -> u64 {
        self.stage_ns[stage as usize]
    }

    /// Time from the entry to the last mark.
    pub fn total(&self) -> Duration {
        self.last - self.entered
    }

    /// The stage that took longest.
    pub fn longest(&self) -> Stage {
        Stage::ALL.into_iter().max_by_key(|stage| self.stage_ns(*stage)).unwrap_or(Stage::Published)
    }
}

/// Distributions over decisions.
#[derive(Clone, Debug)]
pub struct StageTimes {
    decision: Histogram<u64>,
    stages: [Histogram<u64>; Stage::ALL.len()],
    age: Histogram<u64>,
    over_budget: u64,
    over_budget_by: [u64; Stage::ALL.len()],
}

impl Default for StageTimes {
    /// Empty distributions, with all memory allocated.
    fn default() -> Self {
        let empty = empty_ns();
        Self {
            stages: std::array::from_fn(|_| empty.clone()),
            age: empty.clone(),
            decision: empty,
            over_budget: 0,
            over_budget_by: [0; Stage::ALL.len()],
        }
    }
}

impl StageTimes {
    /// Records one published decision and the age of its positions. Does not allocate.
    pub fn record(&mut self, stamps: &StageStamps, age_ns: Nanos) {
        self.decision.saturating_record(as_ns(stamps.total()).max(1));
        for stage in Stage::ALL {
            self.stages[stage as usize].saturating_record(stamps.stage_ns(stage).max(1));
        }
        self.age.saturating_record(age_ns.max(1));
        if stamps.total() > BUDGET {
            self.over_budget += 1;
            self.over_budget_by[stamps.longest() as usize] += 1;
        }
    }

    /// Moves all counts from `other` here, and leaves it empty.
    pub fn absorb(&mut self, other: &mut Self) {
        let pairs = self.stages.iter_mut().zip(&mut other.stages);
        let single = [(&mut self.decision, &mut other.decision), (&mut self.age, &mut other.age)];
        for (here, there) in pairs.chain(single) {
            here.add(&*there).expect("both were made with the same bounds");
            there.reset();
        }
        self.over_budget += std::mem::take(&mut other.over_budget);
        for (here, there) in self.over_budget_by.iter_mut().zip(&mut other.over_budget_by) {
            *here += std::mem::take(there);
        }
    }

    /// How many decisions took longer than [`BUDGET`].
    pub fn over_budget(&self) -> u64 {
        self.over_budget
    }

    /// How many of them spent most of their time in this stage.
    pub fn over_budget_by(&self, stage: Stage) -> u64 {
        self.over_budget_by[stage as usize]
    }

    /// Times from the entry of the callback to the end of the publication, in ns.
    pub fn decision(&self) -> &Histogram<u64> {
        &self.decision
    }

    /// Times of one stage in ns.
    pub fn stage(&self, stage: Stage) -> &Histogram<u64> {
        &self.stages[stage as usize]
    }

    /// Ages of the positions on which decisions are based, in ns.
    pub fn age(&self) -> &Histogram<u64> {
        &self.age
    }

    /// Number of decisions that took no longer than each edge, in us. Longer ones appear only in
    /// the total.
    pub fn decisions_within(&self) -> impl Iterator<Item = (u64, u64)> {
        EDGES_US.map(|edge_us| (edge_us, self.decision.count_between(0, edge_us * 1000))).into_iter()
    }
}

/// Distributions of the decision times of each policy since the start.
#[derive(Clone, Debug, Default)]
pub struct PolicyTimes(BTreeMap<String, Histogram<u64>>);

impl PolicyTimes {
    /// Adds the decisions of one policy.
    pub fn add(&mut self, policy: &str, times: &StageTimes) {
        self.add_decisions(policy, &times.decision);
    }

    /// Adds the decisions of all policies of another room.
    pub fn add_all(&mut self, other: &Self) {
        other.0.iter().for_each(|(policy, decisions)| self.add_decisions(policy, decisions));
    }

    /// The times of one policy in us.
    pub fn decision_us(&self, policy: &str) -> Quantiles {
        self.0.get(policy).map(quantiles_us).unwrap_or_default()
    }

    fn add_decisions(&mut self, policy: &str, decisions: &Histogram<u64>) {
        match self.0.get_mut(policy) {
            Some(all) => all.add(decisions).expect("both were made with the same bounds"),
            None => drop(self.0.insert(policy.to_owned(), decisions.clone())),
        }
    }
}

/// A histogram of times in ns up to a minute, without entries and with all memory allocated.
pub fn empty_ns() -> Histogram<u64> {
    Histogram::new_with_bounds(1, LONGEST_NS, DIGITS).expect("the bounds are in order and the digits at most 5")
}

/// The quantiles in us of times in ns.
pub fn quantiles_us(histogram: &Histogram<u64>) -> Quantiles {
    let at = |quantile: f64| histogram.value_at_quantile(quantile) as f64 / 1e3;
    let (p50, p90, p99, p999) = (at(0.5), at(0.9), at(0.99), at(0.999));
    Quantiles { count: histogram.len(), p50, p90, p99, p999, max: histogram.max() as f64 / 1e3 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stamps(stage_us: [u64; 6]) -> StageStamps {
        let entered = Instant::now();
        let total = Duration::from_micros(stage_us.iter().sum());
        StageStamps { entered, last: entered + total, stage_ns: stage_us.map(|us| us * 1000) }
    }

    #[test]
    fn quantiles_match_the_recorded_times() {
        let mut times = StageTimes::default();
        for us in 1..=100 {
            times.record(&stamps([0, 0, us, 0, 0, 0]), 7_000_000);
        }
        let decision = quantiles_us(times.decision());
        assert_eq!(decision.count, 100);
        assert!((decision.p50 - 50.0).abs() < 0.1 && (decision.p99 - 99.0).abs() < 0.1);
        assert!((decision.max - 100.0).abs() < 0.1);
        assert!((quantiles_us(times.age()).p50 - 7000.0).abs() < 7.1);
        assert!((quantiles_us(times.stage(Stage::Observed)).p90 - 90.0).abs() < 0.1);
    }

    #[test]
    fn decisions_are_counted_by_duration() {
        let mut times = StageTimes::default();
        for us in [20, 60, 60, 450, 9000] {
            times.record(&stamps([0, 0, us, 0, 0, 0]), 0);
        }
        let within: Vec<_> = times.decisions_within().collect();
        let counts =
            [25, 50, 75, 500, 5000].map(|edge| within.iter().find(|(of, _)| *of == edge).map(|(_, count)| *count));
        assert_eq!(counts, [1, 1, 3, 4, 4].map(Some));
    }

    #[test]
    fn a_decision_over_budget_is_attributed_to_its_longest_stage() {
        let mut times = StageTimes::default();
        times.record(&stamps([0, 10, 10, 400, 10, 60]), 0);
        assert_eq!(times.over_budget(), 0);
        times.record(&stamps([0, 10, 10, 400, 10, 90]), 0);
        assert_eq!((times.over_budget(), times.over_budget_by(Stage::Inferred)), (1, 1));
    }

    #[test]
    fn absorbing_moves_all_counts() {
        let (mut total, mut fresh) = (StageTimes::default(), StageTimes::default());
        fresh.record(&stamps([600, 0, 0, 0, 0, 0]), 5);
        total.absorb(&mut fresh);
        assert_eq!((total.decision().len(), fresh.decision().len()), (1, 0));
        assert_eq!((total.over_budget(), fresh.over_budget()), (1, 0));
        assert_eq!(total.over_budget_by(Stage::Waited), 1);
    }
}
