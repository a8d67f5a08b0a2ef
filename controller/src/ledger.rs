//! How long each stage of a decision took: stamps on the monotonic clock, collected while deciding, recorded after the publish.
//!
//! Histograms are allocated once. A reader takes them by exchanging them for empty ones, so that nobody computes a quantile
//! while a decision waits.

use std::time::{Duration, Instant};

use hdrhistogram::Histogram;
use heliostat_proto::{Nanos, Quantiles};

use heliostat_decide::core::Stage;

/// A decision should take no longer, from the entry of the callback to the return of the put.
pub const BUDGET: Duration = Duration::from_micros(500);

/// Longest time told apart from longer ones: a minute, in ns.
const LONGEST_NS: u64 = 60_000_000_000;
/// Significant decimal digits of a recorded time.
const DIGITS: u8 = 3;

/// Upper edges of the buckets into which a status sorts decisions, in us.
const EDGES_US: [u64; 14] = [25, 50, 75, 100, 150, 200, 250, 300, 400, 500, 700, 1000, 2000, 5000];

/// The stamps of one decision.
#[derive(Clone, Copy, Debug)]
pub struct Laps {
    entered: Instant,
    last: Instant,
    stage_ns: [u64; Stage::ALL.len()],
}

impl Laps {
    /// Starts at the entry of the callback.
    pub fn start(entered: Instant) -> Self {
        Self { entered, last: entered, stage_ns: [0; Stage::ALL.len()] }
    }

    /// A stage ends now, and the next one begins.
    pub fn mark(&mut self, stage: Stage) {
        let now = Instant::now();
        self.stage_ns[stage as usize] = nanoseconds(now - self.last);
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
pub struct Ledger {
    decision: Histogram<u64>,
    stages: [Histogram<u64>; Stage::ALL.len()],
    age: Histogram<u64>,
    over_budget: u64,
    over_budget_by: [u64; Stage::ALL.len()],
}

impl Default for Ledger {
    fn default() -> Self {
        Self::new()
    }
}

impl Ledger {
    /// An empty ledger with all the memory it will need.
    pub fn new() -> Self {
        let empty = Histogram::new_with_bounds(1, LONGEST_NS, DIGITS)
            .expect("the bounds are in order and the digits at most 5");
        Self {
            stages: std::array::from_fn(|_| empty.clone()),
            age: empty.clone(),
            decision: empty,
            over_budget: 0,
            over_budget_by: [0; Stage::ALL.len()],
        }
    }

    /// Records one published decision and the age of the positions it acted on. Does not allocate.
    pub fn record(&mut self, laps: &Laps, age_ns: Nanos) {
        self.decision.saturating_record(nanoseconds(laps.total()).max(1));
        for stage in Stage::ALL {
            self.stages[stage as usize].saturating_record(laps.stage_ns(stage).max(1));
        }
        self.age.saturating_record(age_ns.max(1));
        if laps.total() > BUDGET {
            self.over_budget += 1;
            self.over_budget_by[laps.longest() as usize] += 1;
        }
    }

    /// Moves everything from `other` here, and leaves it empty.
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

    /// Times from the entry of the callback to the return of the put, in ns.
    pub fn decision(&self) -> &Histogram<u64> {
        &self.decision
    }

    /// Times of one stage in ns.
    pub fn stage(&self, stage: Stage) -> &Histogram<u64> {
        &self.stages[stage as usize]
    }

    /// Ages of the positions acted on, in ns.
    pub fn age(&self) -> &Histogram<u64> {
        &self.age
    }

    /// How many decisions took no longer than each edge, in us; what took longer than the last is in the count of all.
    pub fn decisions_within(&self) -> impl Iterator<Item = (u64, u64)> {
        EDGES_US.map(|edge_us| (edge_us, self.decision.count_between(0, edge_us * 1000))).into_iter()
    }

    /// Times from the entry of the callback to the return of the put, in us.
    pub fn decision_us(&self) -> Quantiles {
        quantiles_us(&self.decision)
    }

    /// Times of one stage in us.
    pub fn stage_us(&self, stage: Stage) -> Quantiles {
        quantiles_us(&self.stages[stage as usize])
    }

    /// Ages of the positions acted on, in us.
    pub fn age_us(&self) -> Quantiles {
        quantiles_us(&self.age)
    }
}

fn nanoseconds(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}

fn quantiles_us(histogram: &Histogram<u64>) -> Quantiles {
    let at = |quantile: f64| histogram.value_at_quantile(quantile) as f64 / 1e3;
    let (p50, p90, p99, p999) = (at(0.5), at(0.9), at(0.99), at(0.999));
    Quantiles { count: histogram.len(), p50, p90, p99, p999, max: histogram.max() as f64 / 1e3 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn laps(stage_us: [u64; 6]) -> Laps {
        let entered = Instant::now();
        let total = Duration::from_micros(stage_us.iter().sum());
        Laps { entered, last: entered + total, stage_ns: stage_us.map(|us| us * 1000) }
    }

    #[test]
    fn quantiles_are_those_of_what_was_recorded() {
        let mut ledger = Ledger::new();
        for us in 1..=100 {
            ledger.record(&laps([0, 0, us, 0, 0, 0]), 7_000_000);
        }
        let decision = ledger.decision_us();
        assert_eq!(decision.count, 100);
        assert!((decision.p50 - 50.0).abs() < 0.1 && (decision.p99 - 99.0).abs() < 0.1);
        assert!((decision.max - 100.0).abs() < 0.1);
        assert!((ledger.age_us().p50 - 7000.0).abs() < 7.1);
        assert!((ledger.stage_us(Stage::Observed).p90 - 90.0).abs() < 0.1);
    }

    #[test]
    fn decisions_are_sorted_by_how_long_they_took() {
        let mut ledger = Ledger::new();
        for us in [20, 60, 60, 450, 9000] {
            ledger.record(&laps([0, 0, us, 0, 0, 0]), 0);
        }
        let within: Vec<_> = ledger.decisions_within().collect();
        let counts =
            [25, 50, 75, 500, 5000].map(|edge| within.iter().find(|(of, _)| *of == edge).map(|(_, count)| *count));
        assert_eq!(counts, [1, 1, 3, 4, 4].map(Some));
    }

    #[test]
    fn what_is_over_budget_is_laid_on_the_longest_stage() {
        let mut ledger = Ledger::new();
        ledger.record(&laps([0, 10, 10, 400, 10, 60]), 0);
        assert_eq!(ledger.over_budget(), 0);
        ledger.record(&laps([0, 10, 10, 400, 10, 90]), 0);
        assert_eq!((ledger.over_budget(), ledger.over_budget_by(Stage::Inferred)), (1, 1));
    }

    #[test]
    fn absorbing_moves_everything() {
        let (mut total, mut fresh) = (Ledger::new(), Ledger::new());
        fresh.record(&laps([600, 0, 0, 0, 0, 0]), 5);
        total.absorb(&mut fresh);
        assert_eq!((total.decision_us().count, fresh.decision_us().count), (1, 0));
        assert_eq!((total.over_budget(), fresh.over_budget()), (1, 0));
        assert_eq!(total.over_budget_by(Stage::Waited), 1);
    }
}
