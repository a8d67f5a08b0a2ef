//! The effect of a fault on the array, from telemetry.

use heliostat_proto::{ArrayState, MirrorTelemetry, Nanos};

/// Clocks of witness and array that differ by more than this are those of a test that shifts them.
const CLOCKS_DIFFER_NS: u64 = 500_000_000;

/// Longer than any time between two telemetry messages of a process that runs.
const TELEMETRY_PAUSE_NS: u64 = 500_000_000;

/// One telemetry message, as the witness received it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sample {
    /// When the witness received it, in UTC.
    pub seen_ns: Nanos,
    /// Source of the array.
    pub source: u64,
    /// State of the array.
    pub state: ArrayState,
    /// Epoch of the command applied last.
    pub epoch: u64,
    /// Commands accepted since the start of the array.
    pub accepted: u64,
    /// When the last of them arrived; 0 before the first.
    pub accepted_ns: Nanos,
}

impl Sample {
    /// The sample of a message that arrives now.
    pub fn new(seen_ns: Nanos, telemetry: &MirrorTelemetry) -> Self {
        let MirrorTelemetry { stamp, state, epoch, counters, received_ns, .. } = telemetry;
        let shifted = seen_ns.abs_diff(stamp.time_ns) > CLOCKS_DIFFER_NS && *received_ns > 0;
        let age_ns = stamp.time_ns.saturating_sub(*received_ns);
        let accepted_ns = if shifted { seen_ns.saturating_sub(age_ns) } else { *received_ns };
        Self { seen_ns, source: stamp.source, state: *state, epoch: *epoch, accepted: counters.accepted, accepted_ns }
    }
}

/// What a fault did to the array.
#[derive(Clone, Debug, PartialEq)]
pub struct Effect {
    /// Longest time between two accepted commands, in ms.
    pub gap_ms: f64,
    /// Commands that the array would have accepted without an interruption, less those accepted.
    pub lost: u64,
    /// From the end of the fault to the next accepted command, in ms.
    pub recovery_ms: f64,
    /// States of the array in the order in which telemetry reported them.
    pub states: Vec<ArrayState>,
    /// Counters of refusals and degraded modes that rose, by process.
    pub counted: Vec<String>,
}

impl Effect {
    /// The effect of a fault from `begin_ns` to `end_ns`, while reports arrive every `period_ns`.
    ///
    /// Telemetry gives the number of accepted commands and the arrival of the last one. Of several
    /// commands between two messages, all but the first count as `period_ns` apart, and none before
    /// the first message. If telemetry paused, the process was frozen: they arrived at one time.
    ///
    /// # Panics
    /// When no command was accepted before the fault or after it.
    pub fn between(samples: &[Sample], begin_ns: Nanos, end_ns: Nanos, period_ns: Nanos) -> Self {
        let first = samples.iter().rposition(|sample| sample.seen_ns <= begin_ns).expect("telemetry before the fault");
        let mut last = samples[first];
        assert!(last.accepted_ns > 0, "no command was accepted before the fault");
        let (start_ns, mut accepted, mut gap_ns, mut recovered_ns) = (last.accepted_ns, 0, 0, None);
        let mut states = vec![last.state];
        for (previous, sample) in samples[first..].iter().zip(&samples[first + 1..]) {
            if states.last() != Some(&sample.state) {
                states.push(sample.state);
            }
            let before = if sample.source == last.source { last.accepted } else { 0 };
            let new = sample.accepted.saturating_sub(before);
            if new == 0 {
                continue;
            }
            // A clock of the array that steps makes the age of one command wrong.
            let is_wrong = sample.accepted_ns < last.accepted_ns;
            let accepted_ns = if is_wrong { sample.seen_ns } else { sample.accepted_ns };
            let between_ns = accepted_ns - last.accepted_ns;
            let is_same = sample.source == last.source;
            let paused = is_same && sample.seen_ns.saturating_sub(previous.seen_ns) > TELEMETRY_PAUSE_NS;
            let others_ns = if paused { 0 } else { (new - 1) * period_ns };
            // An array that has just started published no telemetry before its first command.
            let silent_until_ns = if is_same { previous.seen_ns.min(accepted_ns) } else { 0 };
            let first_ns = accepted_ns.saturating_sub(others_ns).max(silent_until_ns).max(last.accepted_ns);
            gap_ns = gap_ns.max(first_ns - last.accepted_ns).max(between_ns / new);
            if accepted_ns > end_ns {
                recovered_ns.get_or_insert(first_ns.max(end_ns));
            }
            accepted += new;
            last = Sample { accepted_ns, ..*sample };
        }
        let expected = last.accepted_ns.saturating_sub(start_ns) as f64 / period_ns as f64;
        Self {
            gap_ms: gap_ns as f64 * 1e-6,
            lost: (expected - accepted as f64).max(0.0).round() as u64,
            recovery_ms: (recovered_ns.expect("a command after the fault") - end_ns) as f64 * 1e-6,
            states,
            counted: Vec::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn sample(seen_ms: u64, source: u64, accepted: u64, accepted_ms: u64) -> Sample {
        let state = if accepted == 0 { ArrayState::Parked } else { ArrayState::Following };
        Sample { seen_ns: seen_ms * MS, source, state, epoch: 1, accepted, accepted_ns: accepted_ms * MS }
    }

    #[test]
    fn a_gap_is_the_time_without_commands_and_not_the_time_without_telemetry() {
        // One command each 10 ms, telemetry each 50 ms, no command from 100 ms to 300 ms.
        let samples = [sample(60, 1, 5, 50), sample(110, 1, 10, 100), sample(320, 1, 12, 310), sample(370, 1, 17, 360)];
        let effect = Effect::between(&samples, 105 * MS, 290 * MS, 10 * MS);
        assert_eq!((effect.gap_ms, effect.lost, effect.recovery_ms), (200.0, 19, 10.0), "{effect:?}");
    }

    #[test]
    fn commands_that_waited_arrive_at_one_time() {
        // Telemetry without commands until 1100 ms, then 20 commands that waited.
        let waited = [sample(100, 1, 5, 95), sample(600, 1, 5, 95), sample(1090, 1, 5, 95), sample(1100, 1, 25, 1095)];
        assert_eq!(Effect::between(&waited, 100 * MS, 1090 * MS, 10 * MS).gap_ms, 995.0);
        // A frozen array publishes no telemetry, and accepts what waited when it continues.
        let frozen = [sample(100, 1, 5, 95), sample(3105, 1, 25, 3100)];
        assert_eq!(Effect::between(&frozen, 100 * MS, 3095 * MS, 10 * MS).gap_ms, 3005.0);
    }

    #[test]
    fn a_step_of_the_clock_of_the_array_makes_no_gap() {
        let stepped = [
            sample(7_200_100, 1, 5, 7_200_095),
            sample(7_200_110, 1, 6, 3_600_105),
            sample(7_200_120, 1, 7, 7_200_115),
        ];
        assert_eq!(Effect::between(&stepped, 7_200_100 * MS, 7_200_101 * MS, 10 * MS).gap_ms, 15.0);
    }

    #[test]
    fn an_array_that_restarts_counts_from_zero() {
        let samples =
            [sample(100, 1, 500, 95), sample(900, 2, 0, 0), sample(1000, 2, 3, 995), sample(1010, 2, 4, 1005)];
        let effect = Effect::between(&samples, 100 * MS, 600 * MS, 10 * MS);
        assert_eq!((effect.gap_ms, effect.recovery_ms), (880.0, 375.0), "{effect:?}");
        assert_eq!(effect.lost, 91 - 4);
        assert_eq!(effect.states, [ArrayState::Following, ArrayState::Parked, ArrayState::Following]);
    }

    #[test]
    fn a_shifted_clock_of_the_array_does_not_change_the_time_of_a_command() {
        let mut telemetry = MirrorTelemetry::default();
        telemetry.stamp.time_ns = 3_600_000 * MS;
        telemetry.received_ns = telemetry.stamp.time_ns - 4 * MS;
        assert_eq!(Sample::new(1000 * MS, &telemetry).accepted_ns, 996 * MS);
        telemetry.stamp.time_ns = 1001 * MS;
        telemetry.received_ns = 990 * MS;
        assert_eq!(Sample::new(1000 * MS, &telemetry).accepted_ns, 990 * MS);
    }
}
