//! The histogram of decision times over the last 30 s, and what the stages show about the late ones.
//!
//! A controller publishes a cumulative histogram since its start, as counters named [`BUCKET`] and
//! an upper edge in us. The difference of two statuses is the histogram between them.

use std::collections::{BTreeMap, VecDeque};
use std::time::{Duration, Instant};

use heliostat_proto::NodeStatus;
use serde::Serialize;

use crate::expiry::EXPIRY;

/// Prefix of the counters of the histogram; the upper edge in us follows.
const BUCKET: &str = "decision_us_le:";
/// Prefix of the counters of decisions over the budget; the name of their longest stage follows.
const OVER: &str = "over_budget_by:";
/// The stages in which a decision waits for a thread or for the transport, and not for the policy.
const WAITING: [&str; 2] = ["wait", "publish"];
/// Fewer decisions over the budget are not explained, nor a smaller share of all.
const LATE_MIN: u64 = 10;
/// One decision in so many.
const LATE_SHARE: u64 = 100;
/// Time limit of a decision in us.
pub(crate) const BUDGET_US: u64 = 500;
/// Span of the histogram.
const WINDOW: Duration = Duration::from_secs(30);
/// Most statuses that are kept: a controller publishes two a second.
const SEEN_MAX: usize = 128;

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
    /// Decisions over the budget, by their longest stage.
    over: BTreeMap<String, u64>,
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
        let stage = |(name, count): &(String, u64)| Some((name.strip_prefix(OVER)?.to_owned(), *count));
        let over = status.counters.iter().filter_map(stage).collect();
        self.seen.push_back(Counted { at: now, source, total, within, over });
        while self.seen.len() > SEEN_MAX || self.seen.front().is_some_and(|first| now - first.at > WINDOW) {
            self.seen.pop_front();
        }
    }

    /// Where the late decisions of the window spent most of their time, and the likely cause; `None` if
    /// there are few of them, and without a recent status: a controller that has left is late no longer.
    ///
    /// Load is named where most of them waited for a thread or for the transport, while more than half of
    /// all decisions were within the budget: a policy that is too slow delays them all.
    pub fn late(&self) -> Option<String> {
        let last = self.seen.back().filter(|last| last.at.elapsed() < EXPIRY)?;
        let first = self.seen.front().filter(|_| self.seen.len() > 1);
        let since = |now: u64, of: fn(&Counted) -> u64| now.saturating_sub(first.map_or(0, of));
        let mut by: Vec<(&str, u64)> = last
            .over
            .iter()
            .map(|(stage, count)| {
                let before = first.and_then(|first| first.over.get(stage)).copied().unwrap_or(0);
                (stage.as_str(), count.saturating_sub(before))
            })
            .filter(|(_, count)| *count > 0)
            .collect();
        by.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
        let (late, all) = (by.iter().map(|(_, count)| count).sum::<u64>(), since(last.total, |first| first.total));
        if late < LATE_MIN || late * LATE_SHARE < all {
            return None;
        }
        let waiting: u64 = by.iter().filter(|(stage, _)| WAITING.contains(stage)).map(|(_, count)| count).sum();
        let stages: Vec<String> = by.iter().map(|(stage, count)| format!("{stage} {count}")).collect();
        let stages = format!("{late} of {all} decisions over 0.5 ms, by longest stage: {}.", stages.join(", "));
        Some(if 2 * waiting > late && 2 * late < all {
            format!("{stages} Likely cause: load. End other programs.")
        } else {
            stages
        })
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

    #[test]
    fn a_flood_of_statuses_is_bounded() {
        let mut window = Window::default();
        (0..1000).for_each(|total| window.take(&status(1, [0, total], total)));
        assert_eq!(window.seen.len(), SEEN_MAX);
    }

    fn late_status(total: u64, over: &[(&str, u64)]) -> NodeStatus {
        let mut status = status(1, [total / 2, total], total);
        status.counters.extend(over.iter().map(|(stage, count)| (format!("{OVER}{stage}"), *count)));
        status
    }

    #[test]
    fn late_decisions_of_a_controller_that_has_left_are_not_explained() {
        let mut window = Window::default();
        window.take(&late_status(1000, &[]));
        window.take(&late_status(1100, &[("infer", 34)]));
        assert!(window.late().is_some());
        window.seen.iter_mut().for_each(|one| one.at -= EXPIRY);
        assert_eq!(window.late(), None);
    }

    #[test]
    fn load_is_named_where_late_decisions_waited_and_the_policy_is_fast() {
        let late = |before: &[(&str, u64)], after: &[(&str, u64)]| {
            let mut window = Window::default();
            window.take(&late_status(1000, before));
            window.take(&late_status(1100, after));
            window.late()
        };
        let text = late(&[("publish", 500)], &[("infer", 4), ("publish", 520), ("wait", 10)]).expect("34 of 100");
        assert!(text.starts_with("34 of 100 decisions over 0.5 ms, by longest stage: publish 20, wait 10, infer 4."));
        assert!(text.contains("Likely cause: load."), "{text}");
        let slow = late(&[], &[("infer", 34)]).expect("34 of 100");
        assert!(slow.contains("by longest stage: infer 34") && !slow.contains("load"), "{slow}");
        let all = late(&[], &[("wait", 60), ("infer", 40)]).expect("100 of 100");
        assert!(!all.contains("load"), "the policy delays them all: {all}");
        assert_eq!(late(&[("wait", 500)], &[("wait", 509)]), None, "few are late");
    }
}
