//! Position reports that a controller refuses, by its status.

use heliostat_proto::NodeStatus;
use heliostat_service::printable::printable;

/// The counter of decisions on position reports.
pub(super) const DECISIONS: &str = NodeStatus::DECISIONS;
/// The counter of those on reports that are refused because they are too old.
pub(super) const STALE_DECISIONS: &str = "fallback:stale-report";
/// Beginning of the counters of refused position reports; the reason follows.
const REFUSED_REPORTS: &str = "refused:users:";

/// How many position reports a controller has accepted and refused since its start.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ReportCounts {
    accepted: u64,
    refused: u64,
}

impl ReportCounts {
    pub fn of(status: &NodeStatus) -> Self {
        let count = |name| status.counter(name).unwrap_or_default();
        Self {
            accepted: count(DECISIONS).saturating_sub(count(STALE_DECISIONS)),
            refused: refusals(status).map(|(_, count)| count).sum(),
        }
    }

    /// Whether reports came since these counts, and each was refused.
    pub fn are_refused_since(self, before: Self) -> bool {
        self.refused > before.refused && self.accepted <= before.accepted
    }
}

/// The reasons of refused position reports, with their counts.
fn refusals(status: &NodeStatus) -> impl Iterator<Item = (&str, u64)> {
    status.counters.iter().filter_map(|(name, count)| Some((name.strip_prefix(REFUSED_REPORTS)?, *count)))
}

/// The reason in a problem of a controller that refuses position reports. Telemetry that is refused for its time shows
/// the same difference of clocks.
pub(crate) fn refusal_of(problem: &str) -> Option<&str> {
    let (what, reason) = problem.split_once(" refused: ")?;
    let is_of_time = what.starts_with("telemetry of ") && reason.starts_with("a report is ");
    (what == "users" || is_of_time).then_some(reason)
}

/// Why a controller refuses position reports: its own words, unless its problem is another one.
pub(super) fn refusal_in_words(status: &NodeStatus) -> String {
    let own = refusal_of(&status.last_problem);
    let most = || refusals(status).max_by_key(|(_, count)| *count).map_or("", |(reason, _)| reason);
    printable(own.unwrap_or_else(most)).into_owned()
}
