//! How old telemetry is when it arrives, by the clocks of its driver and of this viewer.
//!
//! The least age of some seconds decides. One message that waits, as on a busy machine, is no problem; a clock that
//! differs and a queue that lasts delay every message. The delays of a scenario concern other reports.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use heliostat_proto::array_keys::array_name;
use heliostat_proto::{Capabilities, Nanos, SIMULATED_UNTIL_NS, Stamp, ValidityClock};

use crate::expiry::EXPIRY;

/// Telemetry that is older than this when it arrives, or as far ahead, is a problem.
const LIMIT_NS: u64 = 50_000_000;

/// Age at which the problem ends: an age near the limit would fill the log of events.
const OVER_NS: u64 = LIMIT_NS / 2;

/// Length of a period. The least age is that of the present one and of the one before, which is complete.
const PERIOD: Duration = Duration::from_secs(1);

/// The ages of the telemetry of each array.
#[derive(Debug, Default)]
pub(crate) struct TelemetryAges {
    /// The driver of each array that has a synchronised clock.
    synchronised: BTreeMap<usize, u64>,
    least: BTreeMap<usize, LeastAge>,
}

/// The least age in ns of the messages of one source.
#[derive(Clone, Copy, Debug)]
struct LeastAge {
    source: u64,
    /// When the present period began.
    began: Instant,
    /// When the last message arrived.
    last: Instant,
    present_ns: i64,
    /// In the period before; `None` in the first one.
    before_ns: Option<i64>,
    is_problem: bool,
}

impl TelemetryAges {
    /// The driver of an array announces whether it has a synchronised clock.
    pub fn handle_capabilities(&mut self, array: usize, Capabilities { stamp, validity_clock, .. }: &Capabilities) {
        match validity_clock {
            ValidityClock::SourceTime => self.synchronised.insert(array, stamp.source),
            ValidityClock::Arrival => self.synchronised.remove(&array),
        };
    }

    /// Telemetry with this stamp arrives, at this time by the clocks of this viewer.
    pub fn handle_telemetry(&mut self, array: usize, stamp: Stamp, (now, utc_ns): (Instant, Nanos)) {
        if stamp.time_ns < SIMULATED_UNTIL_NS {
            return;
        }
        let age_ns = utc_ns.wrapping_sub(stamp.time_ns) as i64;
        let source = stamp.source;
        let first = LeastAge { source, began: now, last: now, present_ns: age_ns, before_ns: None, is_problem: false };
        let least = self.least.entry(array).or_insert(first);
        if least.source != source || now.saturating_duration_since(least.last) > EXPIRY {
            *least = first;
        } else if now.saturating_duration_since(least.began) > PERIOD {
            *least = LeastAge { before_ns: Some(least.present_ns), is_problem: least.is_problem, ..first };
        }
        (least.present_ns, least.last) = (least.present_ns.min(age_ns), now);
        let limit_ns = if least.is_problem { OVER_NS } else { LIMIT_NS };
        least.is_problem = least.age_ns().is_some_and(|age_ns| age_ns.unsigned_abs() > limit_ns);
    }

    /// What the ages at `now` show, array by array.
    pub fn problems(&self, now: Instant) -> Vec<String> {
        let of_array = |(array, least): (&usize, &LeastAge)| {
            let has_clock = self.synchronised.get(array) == Some(&least.source);
            let is_recent = now.saturating_duration_since(least.last) < EXPIRY;
            let age_ns = least.age_ns().filter(|_| has_clock && is_recent && least.is_problem)?;
            Some(problem(*array, age_ns))
        };
        self.least.iter().filter_map(of_array).collect()
    }
}

impl LeastAge {
    /// The least age in ns; `None` before the first period is complete.
    fn age_ns(&self) -> Option<i64> {
        Some(self.before_ns?.min(self.present_ns))
    }
}

/// What an age of telemetry shows that is a problem.
fn problem(array: usize, age_ns: i64) -> String {
    let (name, seconds) = (array_name(array), age_ns.unsigned_abs() as f64 * 1e-9);
    if age_ns > 0 {
        return format!(
            "telemetry of {name} is {seconds:.2} s old when it arrives: it waits on its way, or the clock of its driver \
             is behind that of this viewer; look at the link and the load of both hosts, and synchronise their clocks"
        );
    }
    format!(
        "the clock of the driver of {name} is {seconds:.2} s ahead of that of this viewer: synchronise the clocks of \
         both hosts"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOON_NS: Nanos = 1_767_000_000_000_000_000;

    /// The problems after telemetry every 100 ms of these ages in ms.
    fn problems(validity_clock: ValidityClock, ages_ms: impl Iterator<Item = i64>) -> Vec<String> {
        let (mut ages, mut now) = (TelemetryAges::default(), Instant::now());
        let source = 7;
        let capabilities =
            Capabilities { stamp: Stamp { source, ..Stamp::default() }, validity_clock, ..Capabilities::default() };
        ages.handle_capabilities(1, &capabilities);
        let mut utc_ns = NOON_NS;
        for (sequence, age_ms) in (1..).zip(ages_ms) {
            now += Duration::from_millis(100);
            utc_ns += 100_000_000;
            let time_ns = utc_ns.saturating_add_signed(-age_ms * 1_000_000);
            ages.handle_telemetry(1, Stamp { source, sequence, time_ns }, (now, utc_ns));
        }
        assert!(ages.problems(now + EXPIRY).is_empty(), "an array that does not report is another problem");
        ages.problems(now)
    }

    fn lasting(age_ms: i64) -> Vec<String> {
        problems(ValidityClock::SourceTime, std::iter::repeat_n(age_ms, 23))
    }

    #[test]
    fn telemetry_that_is_old_at_each_arrival_is_a_problem_and_a_clock_ahead_is_named_as_such() {
        let old = lasting(60);
        assert!(
            old.len() == 1 && old[0].starts_with("telemetry of mirrors-1 is 0.06 s old when it arrives: "),
            "{old:?}"
        );
        let ahead = lasting(-350);
        let start = "the clock of the driver of mirrors-1 is 0.35 s ahead of that of this viewer: ";
        assert!(ahead.len() == 1 && ahead[0].starts_with(start), "{ahead:?}");
        assert_eq!([lasting(40), lasting(-40)], [[""; 0], [""; 0]]);
    }

    #[test]
    fn an_age_near_the_limit_does_not_begin_and_end_a_problem_in_turn() {
        let changing = |ages_ms: &[i64]| {
            let ages = ages_ms.iter().flat_map(|age_ms| std::iter::repeat_n(*age_ms, 23));
            problems(ValidityClock::SourceTime, ages).len()
        };
        assert_eq!(
            [changing(&[40]), changing(&[60, 40]), changing(&[60, 40, 20]), changing(&[60, 20, 40])],
            [0, 1, 0, 0]
        );
    }

    #[test]
    fn telemetry_of_which_one_message_in_two_periods_is_on_time_is_no_problem() {
        let ages = |on_time: usize| (0..23).map(move |index| if index == on_time { 5 } else { 400 });
        let found = |on_time| problems(ValidityClock::SourceTime, ages(on_time)).len();
        assert_eq!([0, 20].map(found), [1, 0], "one of long ago does not count");
        let begun = problems(ValidityClock::SourceTime, std::iter::repeat_n(400, 10));
        assert_eq!(begun, [""; 0], "no period is complete");
    }

    #[test]
    fn a_driver_without_a_synchronised_clock_and_simulated_time_are_not_judged() {
        let old = || std::iter::repeat_n(400, 23);
        assert_eq!(problems(ValidityClock::Arrival, old()), [""; 0]);
        let mut ages = TelemetryAges::default();
        let start = Instant::now();
        ages.handle_capabilities(0, &Capabilities::default());
        for step in 0..30 {
            let stamp = Stamp { source: 0, sequence: step, time_ns: 1_000_000_000 * step };
            ages.handle_telemetry(0, stamp, (start + Duration::from_millis(100 * step), NOON_NS));
        }
        assert_eq!(ages.problems(start + Duration::from_secs(3)), [""; 0]);
    }
}
