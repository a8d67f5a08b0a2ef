//! The histogram of decision times over the last 30 s.
//!
//! A controller publishes a cumulative histogram since its start, as counters named [`BUCKET`] and
//! an upper edge in us. The difference of two statuses is the histogram between them.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use heliostat_proto::NodeStatus;
use serde::Serialize;

/// Prefix of the counters of the histogram; the upper edge in us follows.
const BUCKET: &str = "decision_us_le:";
/// Time limit of a decision in us.
pub(crate) const BUDGET_US: u64 = 500;
/// Span of the histogram.
const WINDOW: Duration = Duration::from_secs(30);

/// A histogram of decision times.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Histogram {
    /// Upper edge of each bucket in us, ascending; one more bucket above the last has no upper
    /// edge.
    pub edges_us: Vec<u64>,
    /// Decisions in each bucket, one entry more than edges.
    pub counts: Vec<u64>,
}

/// The counters of the statuses of the last 30 s.
#[derive(Debug, Default)]
pub(crate) struct Window {
    seen: VecDeque<Counted>,
}

#[derive(Debug)]
struct Counted {
    at: Instant,
    source: u64,
    total: u64,
    /// Upper edge in us and the number of decisions up to it, ascending.
    within: Vec<(u64, u64)>,
}

impl Window {
    /// Adds the counters of a controller's status.
    pub fn take(&mut self, status: &NodeStatus) {
        let now = Instant::now();
        let source = status.stamp.source;
        let edge = |(name, count): &(String, u64)| Some((name.strip_prefix(BUCKET)?.parse().ok()?, *count));
        let mut within: Vec<(u64, u64)> = status.counters.iter().filter_map(edge).collect();
        if within.is_empty() {
            return;
        }
        within.sort_unstable();
        let decision = status.timings.iter().find(|(name, _)| name == "decision");
        let total = decision.map_or(0, |(_, quantiles)| quantiles.count);
        // The counters of another controller start at 0.
        if self.seen.back().is_some_and(|last| last.source != source) {
            self.seen.clear();
        }
        self.seen.push_back(Counted { at: now, source, total, within });
        while self.seen.front().is_some_and(|first| now - first.at > WINDOW) {
            self.seen.pop_front();
        }
    }

    /// The histogram of the window; empty without a controller.
    pub fn histogram(&self) -> Histogram {
        let Some(last) = self.seen.back() else { return Histogram::default() };
        // Without an earlier status, all decisions since the controller's start count.
        let first = self.seen.front().filter(|first| first.within.len() == last.within.len() && self.seen.len() > 1);
        let before = |index: usize| first.map_or(0, |first| first.within[index].1);
        let mut counts = Vec::with_capacity(last.within.len() + 1);
        let mut below = 0;
        for (index, (_, count)) in last.within.iter().enumerate() {
            let cumulative = count.saturating_sub(before(index));
            counts.push(cumulative.saturating_sub(below));
            below = cumulative;
        }
        let total = last.total.saturating_sub(first.map_or(0, |first| first.total));
        counts.push(total.saturating_sub(below));
        Histogram { edges_us: last.within.iter().map(|(edge, _)| *edge).collect(), counts }
    }
}

#[cfg(test)]
mod tests {
    use heliostat_proto::{NodeKind, Quantiles, Stamp};

    use super::*;

    fn status(source: u64, within: [u64; 2], total: u64) -> NodeStatus {
        NodeStatus {
            stamp: Stamp { source, ..Stamp::default() },
            node: NodeKind::Controller,
            counters: vec![(format!("{BUCKET}500"), within[1]), (format!("{BUCKET}100"), within[0]), ("x".into(), 7)],
            timings: vec![("decision".into(), Quantiles { count: total, ..Quantiles::default() })],
            ..NodeStatus::default()
        }
    }

    #[test]
    fn the_histogram_is_the_difference_of_two_statuses() {
        let mut window = Window::default();
        assert_eq!(window.histogram(), Histogram::default());
        window.take(&status(1, [10, 15], 16));
        assert_eq!(window.histogram(), Histogram { edges_us: vec![100, 500], counts: vec![10, 5, 1] });
        window.take(&status(1, [30, 40], 45));
        assert_eq!(window.histogram().counts, [20, 5, 4]);
    }

    #[test]
    fn the_histogram_restarts_with_another_controller() {
        let mut window = Window::default();
        window.take(&status(1, [1000, 2000], 3000));
        window.take(&status(2, [3, 5], 9));
        assert_eq!(window.histogram().counts, [3, 2, 4]);
    }
}
