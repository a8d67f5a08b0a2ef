//! The effect of a fault on the array, from telemetry.

use heliostat_proto::{ArrayState, MirrorTelemetry, Nanos};

/// Clocks of witness and array that differ by more than this are those of a test that shifts them.
const CLOCKS_DIFFER_NS: u64 = 500_000_000;

/// One telemetry message, as the witness received it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sample {
    /// When the witness received it, in UTC.
    pub seen_ns: Nanos,
    /// Source of the array.
    pub source: u64,
    /// State of the array.
    pub state: ArrayState,
    /// Commands accepted since the start of the array.
    pub accepted: u64,
    /// When the last of them arrived; 0 before the first.
    pub accepted_ns: Nanos,
}

impl Sample {
    /// The sample of a message that arrives now.
    pub fn new(seen_ns: Nanos, telemetry: &MirrorTelemetry) -> Self {
        let MirrorTelemetry { stamp, state, counters, received_ns, .. } = telemetry;
        let shifted = seen_ns.abs_diff(stamp.time_ns) > CLOCKS_DIFFER_NS && *received_ns > 0;
        let age_ns = stamp.time_ns.saturating_sub(*received_ns);
        let accepted_ns = if shifted { seen_ns.saturating_sub(age_ns) } else { *received_ns };
        Self { seen_ns, source: stamp.source, state: *state, accepted: counters.accepted, accepted_ns }
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
    /// commands between two messages, all but the first count as `period_ns` apart.
    ///
    /// # Panics
    /// When no command was accepted before the fault or after it.
    pub fn between(samples: &[Sample], begin_ns: Nanos, end_ns: Nanos, period_ns: Nanos) -> Self {
        let first = samples.iter().rposition(|sample| sample.seen_ns <= begin_ns).expect("telemetry before the fault");
        let mut last = samples[first];
        assert!(last.accepted_ns > 0, "no command was accepted before the fault");
        let (start_ns, mut accepted, mut gap_ns, mut recovered_ns) = (last.accepted_ns, 0, 0, None);
        let mut states = vec![last.state];
        for sample in &samples[first + 1..] {
            if states.last() != Some(&sample.state) {
                states.push(sample.state);
            }
            let before = if sample.source == last.source { last.accepted } else { 0 };
            let new = sample.accepted.saturating_sub(before);
            if new == 0 {
                continue;
            }
            let between_ns = sample.accepted_ns.saturating_sub(last.accepted_ns);
            let others_ns = (new - 1) * period_ns;
            gap_ns = gap_ns.max(between_ns.saturating_sub(others_ns)).max(between_ns / new);
            if sample.accepted_ns > end_ns {
                let next_ns = sample.accepted_ns.saturating_sub(others_ns).max(end_ns);
                recovered_ns.get_or_insert(next_ns);
            }
            accepted += new;
            last = *sample;
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
        Sample { seen_ns: seen_ms * MS, source, state, accepted, accepted_ns: accepted_ms * MS }
    }

    #[test]
    fn a_gap_is_the_time_without_commands_and_not_the_time_without_telemetry() {
        // One command each 10 ms, telemetry each 50 ms, no command from 100 ms to 300 ms.
        let samples = [sample(60, 1, 5, 50), sample(110, 1, 10, 100), sample(320, 1, 12, 310), sample(370, 1, 17, 360)];
        let effect = Effect::between(&samples, 105 * MS, 290 * MS, 10 * MS);
        assert_eq!((effect.gap_ms, effect.lost, effect.recovery_ms), (250.0 - 50.0, 19, 10.0), "{effect:?}");
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
