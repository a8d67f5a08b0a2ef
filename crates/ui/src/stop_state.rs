//! The emergency stop as the page shows it: only telemetry of the array confirms a stop or a release.

use std::time::{Duration, Instant};

use heliostat_proto::{ArrayState, SafetyReport};
use heliostat_service::printable::printable;
use serde::Serialize;

use crate::view::Dated;

/// After this time without a confirmation, the page warns.
const CONFIRM_LIMIT: Duration = Duration::from_secs(1);
/// A release is shown this long.
const RELEASED_SHOWN: Duration = Duration::from_secs(8);

/// How far a stop has come.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum StopPhase {
    /// No stop.
    #[default]
    None,
    /// Ordered less than a second ago, and not confirmed.
    Requested,
    /// Ordered more than a second ago, and not confirmed.
    Unconfirmed,
    /// The last telemetry of the array reports a stop.
    Confirmed,
    /// The array reported the end of a stop some seconds ago.
    Released,
}

/// The emergency stop.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct StopFigures {
    /// How far it has come.
    pub phase: StopPhase,
    /// Time in this phase in s; for an unconfirmed stop, the time since the order.
    pub since_s: f64,
    /// Age in s of the report that confirms the stop; absent without one.
    pub report_age_s: Option<f64>,
    /// Name of the operator who ordered the stop, as the array reports it.
    pub operator: String,
    /// The operator's reason.
    pub reason: String,
}

/// Follows the orders of the page and the reports of an array.
#[derive(Debug, Default)]
pub(crate) struct StopState {
    /// When the page ordered the last stop, unless the array answered a re-arm after it.
    ordered: Option<Instant>,
    /// When the page published a re-arm after that stop.
    rearmed: Option<Instant>,
    stopped: Option<Instant>,
    released: Option<Instant>,
}

impl StopState {
    /// Notes that the page orders a stop.
    pub fn order_stop(&mut self, at: Instant) {
        (self.ordered, self.rearmed) = (Some(at), None);
    }

    /// Notes that a re-arm was published. It ends the warning of an unconfirmed stop only together
    /// with telemetry from after it: an array that is silent may still obey the stop, or ignore it.
    pub fn order_rearm(&mut self, at: Instant) {
        self.rearmed = Some(at);
    }

    /// The stop at this instant, from the last telemetry and the last safety report.
    pub fn update(&mut self, array: Dated<ArrayState>, safety: Dated<SafetyReport>) -> StopFigures {
        let now = Instant::now();
        let since = |at: Instant| now.saturating_duration_since(at);
        let is_stopped = array.is_some_and(|(_, state)| state == ArrayState::Stopped);
        let is_answered = |rearmed| array.is_some_and(|(at, _)| at > rearmed && !is_stopped);
        if self.rearmed.is_some_and(is_answered) {
            (self.ordered, self.rearmed) = (None, None);
        }
        let ordered = self.ordered;
        match (is_stopped, self.stopped) {
            (true, None) => (self.stopped, self.released) = (Some(now), None),
            (false, Some(_)) => (self.stopped, self.released) = (None, Some(now)),
            _ => {}
        }
        // A report from before the order does not show its effect.
        let open = ordered.filter(|ordered| array.is_none_or(|(at, _)| at <= *ordered) || !is_stopped);
        // The array confirmed the order, and a re-arm of another operator released it.
        let open = open.filter(|ordered| self.released.is_none_or(|released| released < *ordered));
        let (phase, begun) = match (self.stopped, open, self.released) {
            (Some(stopped), ..) => (StopPhase::Confirmed, stopped),
            (_, Some(ordered), _) if since(ordered) < CONFIRM_LIMIT => (StopPhase::Requested, ordered),
            (_, Some(ordered), _) => (StopPhase::Unconfirmed, ordered),
            (.., Some(released)) if since(released) < RELEASED_SHOWN => (StopPhase::Released, released),
            _ => return StopFigures::default(),
        };
        let report = safety.filter(|(_, report)| phase == StopPhase::Confirmed && report.stopped);
        let text = |text: &dyn Fn(&SafetyReport) -> &str| {
            report.as_ref().map(|(_, report)| printable(text(report)).into_owned()).unwrap_or_default()
        };
        StopFigures {
            phase,
            since_s: since(begun).as_secs_f64(),
            report_age_s: array.filter(|_| phase == StopPhase::Confirmed).map(|(at, _)| since(at).as_secs_f64()),
            operator: text(&|report| &report.operator),
            reason: text(&|report| &report.reason),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ago(ms: u64) -> Instant {
        Instant::now() - Duration::from_millis(ms)
    }

    /// The state after a stop that was ordered so long ago.
    fn ordered(ms: u64) -> StopState {
        let mut state = StopState::default();
        state.order_stop(ago(ms));
        state
    }

    fn phase(state: &mut StopState, array: Dated<ArrayState>) -> StopPhase {
        state.update(array, None).phase
    }

    #[test]
    fn an_order_is_requested_then_unconfirmed_until_telemetry_confirms_it() {
        let moving = Some((ago(0), ArrayState::Following));
        assert_eq!(phase(&mut StopState::default(), moving), StopPhase::None);
        assert_eq!(phase(&mut ordered(100), moving), StopPhase::Requested);
        let mut state = ordered(1500);
        assert_eq!(phase(&mut state, moving), StopPhase::Unconfirmed);
        assert_eq!(phase(&mut state, None), StopPhase::Unconfirmed);
        assert_eq!(phase(&mut state, Some((ago(10), ArrayState::Stopped))), StopPhase::Confirmed);
    }

    #[test]
    fn the_end_of_a_stop_is_reported_by_the_array_only() {
        let mut state = ordered(50);
        assert_eq!(phase(&mut state, Some((ago(0), ArrayState::Stopped))), StopPhase::Confirmed);
        state.order_rearm(ago(0));
        assert_eq!(phase(&mut state, Some((ago(0), ArrayState::Stopped))), StopPhase::Confirmed);
        assert_eq!(phase(&mut state, Some((ago(0), ArrayState::Following))), StopPhase::Released);
    }

    #[test]
    fn a_rearm_that_no_telemetry_answers_leaves_the_warning_of_an_unconfirmed_stop() {
        let mut state = ordered(3000);
        let before = Some((ago(2000), ArrayState::Following));
        assert_eq!(phase(&mut state, before), StopPhase::Unconfirmed);
        state.order_rearm(ago(1000));
        assert_eq!(phase(&mut state, before), StopPhase::Unconfirmed);
        assert_eq!(phase(&mut state, None), StopPhase::Unconfirmed);
        assert_eq!(phase(&mut state, Some((ago(500), ArrayState::Following))), StopPhase::None);
        // A stop after the re-arm is open again.
        state.order_stop(ago(0));
        assert_eq!(phase(&mut state, Some((ago(500), ArrayState::Following))), StopPhase::Requested);
    }

    #[test]
    fn a_release_by_another_operator_does_not_reopen_the_order() {
        let mut state = ordered(3000);
        assert_eq!(phase(&mut state, Some((ago(0), ArrayState::Stopped))), StopPhase::Confirmed);
        assert_eq!(phase(&mut state, Some((ago(0), ArrayState::Following))), StopPhase::Released);
    }

    #[test]
    fn the_age_of_the_confirmation_is_known() {
        let figures = StopState::default().update(Some((ago(2000), ArrayState::Stopped)), None);
        assert_eq!(figures.phase, StopPhase::Confirmed);
        assert!(figures.report_age_s.is_some_and(|age| age >= 2.0), "{figures:?}");
    }
}
