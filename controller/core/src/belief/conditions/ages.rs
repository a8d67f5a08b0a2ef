//! Reports and commands that become too old, by the rates, latencies and losses of the streams.

use heliostat_scenario::{Belief, DegradedAction, OrientationStream, Scenario};

/// Share of reports or commands from which those that become too old change a result.
const SHARE_MAX: f64 = 0.01;

/// A time that is a multiple of an interval, but for rounding, contains the last interval.
const ROUNDING: f64 = 1e-9;

/// The stream of orientation reports; `None` where there is none, or where the controller refuses each report because
/// it is too old at its arrival.
pub(super) fn accepted_orientations(scenario: &Scenario) -> Option<&OrientationStream> {
    scenario.streams.orientation.as_ref().filter(|_| refused_orientations(scenario).is_none())
}

/// The keys by which each orientation report is too old at its arrival.
pub(super) fn refused_orientations(scenario: &Scenario) -> Option<String> {
    refused(scenario, "orientation", scenario.streams.orientation.as_ref()?.latency_ms)
}

/// The keys by which each position report is too old at its arrival.
pub(super) fn refused_positions(scenario: &Scenario) -> Option<String> {
    refused(scenario, "positions", scenario.streams.positions.latency_ms)
}

fn refused(scenario: &Scenario, stream: &str, latency_ms: f64) -> Option<String> {
    let age_max_ms = scenario.control.report_age_max_ms;
    let keys = || format!("streams.{stream}.latency_ms = {latency_ms}, above control.report_age_max_ms = {age_max_ms}");
    (latency_ms > age_max_ms).then(keys)
}

/// The keys by which an accepted orientation report is too old before the next one arrives. The filter keeps what it
/// has shown.
pub(super) fn gap_between_orientations(scenario: &Scenario) -> Option<String> {
    let stream = accepted_orientations(scenario).filter(|_| scenario.control.belief != Belief::Filter)?;
    let (oldest_ms, age_max_ms) = (stream.latency_ms + 1e3 / stream.rate_hz, scenario.control.report_age_max_ms);
    (oldest_ms > age_max_ms).then(|| {
        format!(
            "streams.orientation: reports become {oldest_ms:.0} ms old, above control.report_age_max_ms = {age_max_ms}"
        )
    })
}

/// The keys by which measured gains become too old before the next ones arrive.
pub(super) fn gap_between_readings(scenario: &Scenario) -> Option<String> {
    let (channel, age_max_ms) = (&scenario.streams.channel, scenario.control.report_age_max_ms);
    let interval_ms = 1e3 / channel.rate_hz;
    let oldest_ms = channel.latency_ms + interval_ms;
    if oldest_ms > age_max_ms {
        return Some(format!(
            "streams.channel: readings become {oldest_ms:.0} ms old, above control.report_age_max_ms = {age_max_ms}"
        ));
    }
    let losses = (channel.loss, channel.loss_burst_reports);
    let share = share_before_losses(losses, intervals_within(age_max_ms - channel.latency_ms, interval_ms));
    (share > SHARE_MAX).then(|| {
        format!(
            "streams.channel.loss = {} lets {:.0} % of the readings become older than control.report_age_max_ms = {age_max_ms}",
            channel.loss,
            100.0 * share
        )
    })
}

/// The keys by which a command expires before the next position report causes another one.
pub(super) fn gap_between_commands(scenario: &Scenario) -> Option<String> {
    let (control, positions) = (&scenario.control, &scenario.streams.positions);
    let interval_ms = 1e3 / positions.rate_hz;
    // In silence a controller can repeat the last command.
    let is_repeated = control.when_silent == DegradedAction::LastGood;
    let next_ms = if is_repeated { interval_ms.min(control.report_age_max_ms) } else { interval_ms };
    if control.validity_ms < next_ms {
        return Some(format!(
            "control.validity_ms = {}, and streams.positions.rate_hz = {} causes a command each {interval_ms:.1} ms",
            control.validity_ms, positions.rate_hz
        ));
    }
    if is_repeated && control.report_age_max_ms <= control.validity_ms {
        return None;
    }
    let losses = (positions.loss, positions.loss_burst_reports);
    let share = share_before_losses(losses, intervals_within(control.validity_ms, interval_ms));
    (share > SHARE_MAX).then(|| {
        format!(
            "control.validity_ms = {}, and streams.positions.loss = {} lets {:.0} % of the commands expire",
            control.validity_ms,
            positions.loss,
            100.0 * share
        )
    })
}

/// Number of complete intervals within a time, at least 1.
fn intervals_within(time_ms: f64, interval_ms: f64) -> f64 {
    (time_ms / interval_ms + ROUNDING).floor().max(1.0)
}

/// Share of the received reports that at least this number of lost ones follow, by the probability of a loss and the
/// mean number of reports lost in a row (0: losses are independent).
///
/// Of n independent losses it is p^n. Of bursts with the mean length l it is p / ((1 - p) l) (1 - 1 / l)^(n - 1)
/// (Gilbert, 1960).
fn share_before_losses((loss, burst_reports): (f64, f64), reports: f64) -> f64 {
    let (begins, lasts) = if burst_reports == 0.0 {
        (loss, loss)
    } else {
        (loss / ((1.0 - loss) * burst_reports), 1.0 - 1.0 / burst_reports)
    };
    begins * lasts.powf(reports - 1.0)
}

#[cfg(test)]
mod tests {
    use heliostat_scenario::BUILTIN_NAMES;

    use super::*;

    #[test]
    fn no_command_of_a_builtin_room_expires_before_the_next_one() {
        for name in BUILTIN_NAMES {
            assert_eq!(gap_between_commands(&Scenario::builtin(name).unwrap()), None, "{name}");
        }
    }

    #[test]
    fn losses_in_a_row_let_commands_expire_and_readings_become_old() {
        let hall = |overrides: &[&str]| Scenario::builtin("hall").unwrap().with_overrides(overrides).unwrap();
        // A command is valid for 4 reports, and a reading is accepted over 4.
        let found = gap_between_commands(&hall(&["streams.positions.loss=0.5"])).unwrap();
        assert!(found.ends_with("streams.positions.loss = 0.5 lets 6 % of the commands expire"), "{found}");
        let found = gap_between_readings(&hall(&["streams.channel.loss=0.9"])).unwrap();
        assert!(found.starts_with("streams.channel.loss = 0.9 lets 66 % of the readings become older"), "{found}");
        for loss in ["streams.positions.loss=0.2", "streams.channel.loss=0.2"] {
            let rare = hall(&[loss]);
            assert_eq!([gap_between_commands(&rare), gap_between_readings(&rare)], [None, None], "{loss}");
        }
        let bursts = hall(&["streams.positions.loss=0.2", "streams.positions.loss_burst_reports=10"]);
        assert!(gap_between_commands(&bursts).is_some(), "more in a row than of independent losses");
        let answers = ["control.validity_ms=2000", "control.when_silent=last-good"];
        assert_eq!(gap_between_commands(&hall(&["streams.positions.loss=0.5", answers[0]])), None);
        let repeated = ["streams.positions.loss=0.5", answers[1], "control.validity_ms=600"];
        assert_eq!(gap_between_commands(&hall(&repeated)), None);
    }

    #[test]
    fn the_share_of_reports_before_losses_is_that_of_both_models() {
        assert_eq!(share_before_losses((0.0, 0.0), 1.0), 0.0);
        assert!((share_before_losses((0.5, 0.0), 4.0) - 0.0625).abs() < 1e-12);
        // A tenth lost in bursts of 5: one report in 45 is the last one before a burst.
        assert!((share_before_losses((0.1, 5.0), 1.0) - 1.0 / 45.0).abs() < 1e-12);
        assert!((share_before_losses((0.1, 5.0), 2.0) - 0.8 / 45.0).abs() < 1e-12);
        // In bursts of one, no two are lost in a row.
        assert_eq!(share_before_losses((0.1, 1.0), 2.0), 0.0);
    }
}
