//! The configured actions in degraded modes, and the detection of silence.

use heliostat_proto::Nanos;
use heliostat_scenario::{DegradedAction, Scenario};
use serde::{Deserialize, Serialize};

/// The scenario's actions in degraded modes, and when silence begins.
#[derive(Clone, Copy, Debug)]
pub(super) struct DegradedActions {
    pub late: DegradedAction,
    pub stale: DegradedAction,
    pub channel_missing: DegradedAction,
    pub silent: DegradedAction,
    pub silent_after_ns: Nanos,
}

impl DegradedActions {
    pub fn new(scenario: &Scenario) -> Self {
        let control = &scenario.control;
        Self {
            late: control.when_late,
            stale: control.when_stale,
            channel_missing: control.when_channel_missing,
            silent: control.when_silent,
            silent_after_ns: (control.report_age_max_ms * 1e6) as Nanos,
        }
    }
}

/// When the last position report was accepted, and whether its absence since then was handled.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct LastReport {
    pub accepted_ns: Nanos,
    pub silence_handled: bool,
}
