//! Cache warm-up: when to warm up the caches between reports; a state machine without thread or
//! clock.
//!
//! # Theory of operation
//!
//! Between two reports the processor's caches lose the code and data of a decision, and an idle
//! thread has to be woken. For a slow policy both cost more than a second run of the policy. So the
//! room's thread repeats the last decision `WARM_UPS` times shortly before the next report is
//! expected. It then spins until the report arrives or is overdue. The section "Cache warm-up" of
//! docs/experiments/latency.md has the measurements from which the constants were chosen.
//!
//! ```text
//!             on_decision, report expected        start time reached
//!     Idle ─────────────────────────────▶ Armed ─────────────────────▶ WarmingUp
//!      ▲                                                                   │
//!      └───────────────────────────────────────────────────────────────────┘
//!                    all warm-ups done (then Spin), or on_arrival
//! ```
//!
//! On a machine without an idle processor the report waits for the room's thread: that thread yields
//! while it spins, and runs again after the others. The callback is woken at once there. So after a
//! report that waited longer than `WAIT_MAX`, the callbacks decide for the next `PAUSE_REPORTS`
//! reports.
//!
//! The caller reports events by `on_*` and executes what [`CacheWarmer::next_action`] returns. Time
//! is an argument.

mod estimators;

use std::{
    ops::RangeInclusive,
    time::{Duration, Instant},
};

use estimators::{ArrivalEstimator, MeanDuration};

/// Cache warm-ups before an expected report: the first loads code and data, the second finds them
/// in the caches.
const WARM_UPS: u32 = 2;

/// Decision times for which cache warm-ups pay. Below, waking the thread costs more than the caches
/// give; above, the gain is small and warm-ups would delay reports. Measured:
/// docs/experiments/latency.md.
const WORTH_STARTING: RangeInclusive<Duration> = Duration::from_micros(250)..=Duration::from_millis(5);

/// The same for decisions after cache warm-ups, which are therefore faster: half of the lower
/// bound. Measured: docs/experiments/latency.md.
const WORTH_CONTINUING: RangeInclusive<Duration> = Duration::from_micros(125)..=Duration::from_millis(5);

/// Cache warm-ups end at least this long before the expected arrival of a report. Measured:
/// docs/experiments/latency.md.
const MARGIN_BEFORE_REPORT: Duration = Duration::from_micros(50);

/// Time for a report that arrives at the latest expected time to reach the room's thread. Measured:
/// docs/experiments/latency.md.
const MARGIN_AFTER_REPORT: Duration = Duration::from_micros(100);

/// Longest spin: a twentieth of the interval between reports at 100 Hz, which bounds the processor
/// time it takes.
const SPIN_MAX: Duration = Duration::from_micros(500);

/// A report that waits longer than this for the room's thread loses more than warm caches give: the
/// shortest decision for which warm-ups pay.
const WAIT_MAX: Duration = *WORTH_STARTING.start();

/// Reports without cache warm-ups after one that waited too long. At most one of so many reports then
/// waits on a machine that stays busy.
const PAUSE_REPORTS: u32 = 128;

/// What the room's thread does next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Wait for an arrival; with a duration, at most so long, and ask again.
    Wait(Option<Duration>),
    /// Warm up the caches once, unless something has arrived.
    WarmUp,
    /// Wait for an arrival without idling, at most until this time.
    Spin(Instant),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// No cache warm-up is planned.
    Idle,
    /// Cache warm-ups begin at a planned time.
    Armed { start: Instant },
    /// Cache warm-ups are under way.
    WarmingUp { left: u32 },
}

/// Decides when to warm up the caches of one room.
#[derive(Clone, Debug)]
pub struct CacheWarmer {
    enabled: bool,
    arrivals: ArrivalEstimator,
    decision: MeanDuration,
    warm_up: MeanDuration,
    warm_ups: u64,
    /// Reports until cache warm-ups are tried again.
    paused: u32,
    phase: Phase,
}

impl CacheWarmer {
    /// A warmer without any estimate; it never warms up unless `enabled`.
    pub fn new(enabled: bool) -> Self {
        Self {
            enabled,
            arrivals: ArrivalEstimator::default(),
            decision: MeanDuration::default(),
            warm_up: MeanDuration::default(),
            warm_ups: 0,
            paused: 0,
            phase: Phase::Idle,
        }
    }

    /// A position report arrived.
    pub fn on_report(&mut self, at: Instant) {
        self.arrivals.on_report(at);
        self.paused = self.paused.saturating_sub(1);
    }

    /// A position report waited so long for the room's thread.
    pub fn on_wait(&mut self, waited: Duration) {
        if waited > WAIT_MAX {
            self.paused = PAUSE_REPORTS;
        }
    }

    /// Something arrived for the room's thread: cache warm-ups that are under way end.
    pub fn on_arrival(&mut self) {
        if let Phase::WarmingUp { .. } = self.phase {
            self.phase = Phase::Idle;
        }
    }

    /// A decision ended at `at`, after `took`.
    pub fn on_decision(&mut self, took: Duration, at: Instant) {
        self.decision.add(took);
        self.arm(at);
    }

    /// A decision without the policy ended at `at`; its duration does not predict the next one.
    pub fn on_late_decision(&mut self, at: Instant) {
        self.arm(at);
    }

    /// A cache warm-up ended after `took`.
    pub fn on_warm_up(&mut self, took: Duration) {
        self.warm_up.add(took);
        self.warm_ups += 1;
    }

    /// What the room's thread does at `now`.
    pub fn next_action(&mut self, now: Instant) -> Action {
        match self.phase {
            Phase::Idle => Action::Wait(None),
            Phase::Armed { start } if now < start => Action::Wait(Some(start - now)),
            Phase::Armed { .. } => {
                self.phase = Phase::WarmingUp { left: WARM_UPS - 1 };
                Action::WarmUp
            }
            Phase::WarmingUp { left: 0 } => {
                self.phase = Phase::Idle;
                Action::Spin(self.spin_until(now))
            }
            Phase::WarmingUp { left } => {
                self.phase = Phase::WarmingUp { left: left - 1 };
                Action::WarmUp
            }
        }
    }

    /// Whether decisions take so long that they belong on the thread that is kept warm.
    pub fn is_worthwhile(&self) -> bool {
        let worth = if self.warm_up.is_known() { WORTH_CONTINUING } else { WORTH_STARTING };
        self.enabled && self.paused == 0 && worth.contains(&self.decision.mean())
    }

    /// Expected duration of the next decision; zero before the first.
    pub fn expected_decision(&self) -> Duration {
        self.decision.mean()
    }

    /// Cache warm-ups so far.
    pub fn warm_ups(&self) -> u64 {
        self.warm_ups
    }

    /// Plans cache warm-ups for the next report, unless they would start before `now`.
    fn arm(&mut self, now: Instant) {
        let start = self.start().filter(|start| self.is_worthwhile() && *start >= now);
        self.phase = start.map_or(Phase::Idle, |start| Phase::Armed { start });
    }

    /// When cache warm-ups have to begin so as to end before the next report; none where no report
    /// is expected.
    fn start(&self) -> Option<Instant> {
        let one = if self.warm_up.is_known() { self.warm_up.mean() } else { self.decision.mean() };
        self.arrivals.earliest()?.checked_sub(WARM_UPS * one + MARGIN_BEFORE_REPORT)
    }

    fn spin_until(&self, now: Instant) -> Instant {
        self.arrivals.latest().map_or(now, |latest| (latest + MARGIN_AFTER_REPORT).min(now + SPIN_MAX))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TICK: Duration = Duration::from_millis(10);
    const US: Duration = Duration::from_micros(1);

    /// A warmer after regular reports and decisions of this length, each right after its report,
    /// and the time of the last decision.
    fn warmer_after(decision: Duration) -> (CacheWarmer, Instant) {
        let (mut warmer, start) = (CacheWarmer::new(true), Instant::now());
        let mut end = start;
        for tick in 0..10 {
            let report = start + tick * TICK;
            end = report + decision;
            warmer.on_report(report);
            warmer.on_decision(decision, end);
        }
        (warmer, end)
    }

    #[test]
    fn a_slow_decision_is_warmed_up_twice_before_the_next_report_and_then_the_thread_spins() {
        let (mut warmer, decided) = warmer_after(400 * US);
        let Action::Wait(Some(pause)) = warmer.next_action(decided) else { panic!("not armed: {warmer:?}") };
        // The next report is due 9.6 ms after the decision; two warm-ups of 0.4 ms and the margin
        // precede it.
        assert!(pause.abs_diff(8750 * US) < US, "{pause:?}");
        let mut now = decided + pause;
        for _ in 0..WARM_UPS {
            assert_eq!(warmer.next_action(now), Action::WarmUp);
            now += 300 * US;
            warmer.on_warm_up(300 * US);
        }
        let Action::Spin(until) = warmer.next_action(now) else { panic!("no spin: {warmer:?}") };
        assert!(until > now && until <= now + SPIN_MAX);
        assert_eq!(warmer.next_action(until), Action::Wait(None));
        assert_eq!(warmer.warm_ups(), 2);
    }

    #[test]
    fn an_arrival_ends_warm_ups_that_are_under_way_and_leaves_planned_ones() {
        let (mut warmer, decided) = warmer_after(400 * US);
        warmer.on_arrival();
        let Action::Wait(Some(pause)) = warmer.next_action(decided) else { panic!("not armed: {warmer:?}") };
        assert_eq!(warmer.next_action(decided + pause), Action::WarmUp);
        warmer.on_arrival();
        assert_eq!(warmer.next_action(decided + pause), Action::Wait(None));
    }

    #[test]
    fn after_a_report_that_waited_for_the_thread_the_callbacks_decide_for_a_while() {
        let (mut warmer, decided) = warmer_after(400 * US);
        warmer.on_wait(WAIT_MAX);
        assert!(warmer.is_worthwhile(), "a short wait");
        warmer.on_wait(WAIT_MAX + US);
        let mut report = decided;
        for _ in 0..PAUSE_REPORTS {
            assert!(!warmer.is_worthwhile());
            report += TICK;
            warmer.on_report(report);
            warmer.on_decision(400 * US, report + 400 * US);
        }
        assert!(warmer.is_worthwhile(), "tried again");
        assert!(matches!(warmer.next_action(report + 400 * US), Action::Wait(Some(_))), "{warmer:?}");
    }

    #[test]
    fn without_an_expected_report_nothing_is_warmed_up() {
        let (mut warmer, now) = (CacheWarmer::new(true), Instant::now());
        warmer.on_report(now);
        warmer.on_decision(400 * US, now);
        assert_eq!(warmer.next_action(now), Action::Wait(None));
    }

    #[test]
    fn a_decision_that_ends_too_late_for_warm_ups_is_followed_by_none() {
        let (mut warmer, _) = warmer_after(400 * US);
        let report = Instant::now() + 10 * TICK;
        warmer.on_report(report);
        warmer.on_late_decision(report + TICK);
        assert_eq!(warmer.next_action(report + TICK), Action::Wait(None));
    }

    #[test]
    fn a_warmer_that_is_off_never_acts_and_still_estimates_decisions() {
        let (mut warmer, now) = (CacheWarmer::new(false), Instant::now());
        for tick in 0..10 {
            warmer.on_report(now + tick * TICK);
            warmer.on_decision(400 * US, now + tick * TICK);
        }
        assert!(!warmer.is_worthwhile());
        assert_eq!(warmer.next_action(now), Action::Wait(None));
        assert_eq!(warmer.expected_decision(), 400 * US);
    }

    #[test]
    fn warm_ups_continue_for_decisions_that_they_have_made_fast() {
        let worthwhile = |decision: Duration, warmed_up: bool| {
            let mut warmer = warmer_after(decision).0;
            if warmed_up {
                warmer.on_warm_up(100 * US);
            }
            warmer.is_worthwhile()
        };
        assert_eq!([200, 300, 6000].map(|us| worthwhile(us * US, false)), [false, true, false]);
        assert_eq!([100, 200, 6000].map(|us| worthwhile(us * US, true)), [false, true, false]);
    }
}
