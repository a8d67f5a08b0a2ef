//! The statuses of the other controllers of a room.
//!
//! A router whose link is cut without an end of the connection keeps the liveliness tokens of the other side for
//! minutes. A status comes at least once a second, so its absence shows the cut.

use std::{
    collections::{BTreeMap, BTreeSet},
    mem::take,
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use heliostat_bus::{Bus, Subscription};
use heliostat_proto::gauges::CalibrationProgress;
use heliostat_proto::{NodeKind, NodeStatus, decode};
use heliostat_service::locks::lock;

use super::HAND_OVER;
use super::status::{Problem, Subject};

/// Time without a status after which a controller is silent.
const SILENCE: Duration = Duration::from_secs(5);

/// Time after the end of a token within which the last status of a controller that ends in order arrives: it hands over
/// before.
const LAST_STATUS_WITHIN: Duration = HAND_OVER.saturating_mul(2);

/// Most controllers of which it is remembered that they left while they were silent.
const LEFT_MAX: usize = 8;

/// What is known of the other controllers by their statuses.
#[derive(Clone, Default)]
pub struct PeerStatuses(Arc<Mutex<Seen>>);

#[derive(Default)]
struct Seen {
    /// When each controller that has a token gave its last sign: its token, or a status.
    signs: BTreeMap<u64, Instant>,
    /// Those of them that are no calibrations, by their statuses.
    controllers: BTreeSet<u64>,
    /// Those whose token has ended without the last status of a controller that ends in order, since one reported, with
    /// the time at which this was seen.
    gone: BTreeMap<u64, Instant>,
}

impl PeerStatuses {
    /// Notes the statuses of the room's controllers, until the subscription is dropped.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn subscribe(bus: &Bus) -> anyhow::Result<(Self, Subscription)> {
        let statuses = Self::default();
        let noted = statuses.clone();
        let receive = move |payload: &[u8]| {
            if let Ok(status) = decode::<NodeStatus>(payload) {
                noted.note(&status, Instant::now());
            }
        };
        Ok((statuses, bus.subscribe(&bus.room().status(NodeKind::Controller), receive)?))
    }

    /// A status of a controller has arrived. Without a token it is not kept: the last one of a controller that ends in
    /// order follows its token.
    fn note(&self, status: &NodeStatus, at: Instant) {
        let (mut seen, source) = (lock(&self.0), status.stamp.source);
        if status.counter(NodeStatus::ENDING).is_some_and(|ending| ending > 0) {
            seen.controllers.remove(&source);
            seen.gone.remove(&source);
            return;
        }
        let Some(last) = seen.signs.get_mut(&source) else { return };
        *last = at;
        if CalibrationProgress::of(status).is_none() {
            seen.controllers.insert(source);
            seen.gone.clear();
        }
    }

    /// Whether none of these processes is a controller that reports, although there was one that did not end in order, or
    /// one is silent.
    pub fn is_standby_missing(&self, peers: &[u64], silent: &[u64], now: Instant) -> bool {
        let seen = lock(&self.0);
        let has_gone = |since: &Instant| now.saturating_duration_since(*since) >= LAST_STATUS_WITHIN;
        let mut controllers = peers.iter().filter(|peer| seen.controllers.contains(*peer)).peekable();
        let was_there = seen.gone.values().any(has_gone) || controllers.peek().is_some();
        was_there && controllers.all(|peer| silent.contains(peer))
    }

    /// Those of these controllers from which no status has come for [`SILENCE`].
    pub fn silent(&self, peers: &[u64], now: Instant) -> Vec<u64> {
        let mut seen = lock(&self.0);
        seen.signs.retain(|source, _| peers.contains(source));
        let (present, gone): (BTreeSet<u64>, BTreeSet<u64>) =
            take(&mut seen.controllers).into_iter().partition(|source| peers.contains(source));
        seen.controllers = present;
        seen.gone.extend(gone.into_iter().map(|source| (source, now)));
        let mut is_silent = |source: &u64| {
            let sign = *seen.signs.entry(*source).or_insert(now);
            now.saturating_duration_since(sign) >= SILENCE
        };
        peers.iter().copied().filter(|source| is_silent(source)).collect()
    }
}

/// The controllers that were reported as silent, and those that left meanwhile.
#[derive(Default)]
pub struct ReportedPeers {
    silent: Vec<u64>,
    /// Oldest first.
    left: Vec<u64>,
}

impl ReportedPeers {
    /// The next controller that is silent since the last call, is silent no longer, or is back, by the controllers with a
    /// token.
    pub fn news(&mut self, silent: &[u64], present: &[u64]) -> Option<(Subject, Problem)> {
        if let Some(begun) = silent.iter().copied().find(|peer| !self.silent.contains(peer)) {
            self.silent.push(begun);
            self.left.retain(|peer| *peer != begun);
            return Some((Subject::Peer(begun), Problem::Warning(describe_silent(begun))));
        }
        let Some(ended) = self.silent.iter().copied().find(|peer| !silent.contains(peer)) else {
            return self.returned(present);
        };
        self.silent.retain(|peer| *peer != ended);
        let problem = if present.contains(&ended) {
            Problem::End(format!("the status of controller {ended:016x} comes again"))
        } else {
            self.note_left(ended);
            Problem::Warning(format!(
                "controller {ended:016x}, whose status did not come, has left: it has ended, or the link to it is still cut"
            ))
        };
        Some((Subject::Peer(ended), problem))
    }

    fn note_left(&mut self, peer: u64) {
        if self.left.len() >= LEFT_MAX {
            self.left.remove(0);
        }
        self.left.push(peer);
    }

    /// The next controller that had left while it was silent, and has a token again.
    fn returned(&mut self, present: &[u64]) -> Option<(Subject, Problem)> {
        let back = self.left.remove(self.left.iter().position(|peer| present.contains(peer))?);
        Some((Subject::Peer(back), Problem::End(format!("controller {back:016x} is in the room again"))))
    }
}

/// A controller whose token remains and whose status does not come.
fn describe_silent(source: u64) -> String {
    let seconds = SILENCE.as_secs();
    format!(
        "no status from controller {source:016x} for {seconds} s, although it has not left: the link to it is cut, or it hangs"
    )
}

#[cfg(test)]
mod tests {
    use heliostat_proto::Stamp;

    use super::*;

    fn status(source: u64) -> NodeStatus {
        NodeStatus { stamp: Stamp { source, ..Stamp::default() }, ..NodeStatus::default() }
    }

    #[test]
    fn a_standby_is_missing_after_its_end_until_another_controller_reports() {
        let (statuses, now) = (PeerStatuses::default(), Instant::now());
        let is_missing = |peers: &[u64]| {
            let silent = statuses.silent(peers, now);
            statuses.is_standby_missing(peers, &silent, now + LAST_STATUS_WITHIN)
        };
        assert!(!is_missing(&[]), "there was none");
        assert!(!is_missing(&[7]));
        let gauges = CalibrationProgress::default().gauges().map(|(name, value)| (name.to_owned(), value)).to_vec();
        statuses.note(&NodeStatus { gauges, ..status(7) }, now);
        assert!(!is_missing(&[]), "the end of a calibration");
        assert!(!is_missing(&[8]));
        statuses.note(&status(8), now);
        assert!(!is_missing(&[8]));
        assert!(is_missing(&[]));
        assert!(is_missing(&[9]), "a token alone is no controller that reports");
        statuses.note(&status(9), now);
        assert!(!is_missing(&[9]));
    }

    #[test]
    fn a_standby_that_ends_in_order_is_not_missing_whether_its_token_or_its_last_status_is_first() {
        let (statuses, now) = (PeerStatuses::default(), Instant::now());
        let is_missing = |peers: &[u64]| {
            let silent = statuses.silent(peers, now);
            statuses.is_standby_missing(peers, &silent, now + LAST_STATUS_WITHIN)
        };
        let last = |source| NodeStatus { counters: vec![(NodeStatus::ENDING.to_owned(), 1)], ..status(source) };
        for source in [7, 8] {
            assert!(!is_missing(&[source]));
            statuses.note(&status(source), now);
            if source == 7 {
                assert!(is_missing(&[]), "nothing is known of its end");
                assert!(!statuses.is_standby_missing(&[], &[], now), "its last status may be on its way");
            }
            statuses.note(&last(source), now);
            assert!(!is_missing(&[]), "{source}");
        }
        // The end of another one excuses no crash.
        assert!(!is_missing(&[9]));
        statuses.note(&status(9), now);
        statuses.note(&last(7), now);
        assert!(is_missing(&[]));
    }

    #[test]
    fn a_controller_is_silent_while_its_token_remains_without_a_status() {
        let (statuses, start) = (PeerStatuses::default(), Instant::now());
        assert!(statuses.silent(&[1, 2], start).is_empty(), "the token is a sign");
        statuses.note(&status(1), start + SILENCE / 2);
        statuses.note(&status(3), start);
        assert_eq!(statuses.silent(&[1, 2], start + SILENCE), [2]);
        statuses.note(&status(2), start + SILENCE);
        assert_eq!(statuses.silent(&[1, 2], start + SILENCE * 3 / 2), [1]);
        assert!(!statuses.is_standby_missing(&[1, 2], &[1], start), "one of two is silent");
        assert!(statuses.is_standby_missing(&[1], &[1], start), "the one of the room is silent");
        assert!(statuses.silent(&[2], start + SILENCE * 3 / 2).is_empty(), "it has left");
        assert!(statuses.silent(&[1, 2], start + SILENCE * 3 / 2).is_empty(), "it has joined");
    }

    #[test]
    fn a_controller_that_is_silent_is_named_once_and_its_end_once() {
        let mut reported = ReportedPeers::default();
        for _ in 0..2 {
            let Some((Subject::Peer(7), Problem::Warning(text))) = reported.news(&[7], &[7]) else {
                panic!("a warning")
            };
            assert!(text.contains("controller 0000000000000007"), "{text}");
            assert!(reported.news(&[7], &[7]).is_none());
            assert!(matches!(reported.news(&[], &[7]), Some((Subject::Peer(7), Problem::End(_)))));
            assert!(reported.news(&[], &[7]).is_none());
        }
    }

    #[test]
    fn a_silent_controller_whose_token_ends_is_no_good_news() {
        let mut reported = ReportedPeers::default();
        assert!(reported.news(&[7], &[7]).is_some());
        let Some((Subject::Peer(7), Problem::Warning(text))) = reported.news(&[], &[]) else { panic!("a warning") };
        assert!(text.ends_with("has left: it has ended, or the link to it is still cut"), "{text}");
        assert!(reported.news(&[], &[]).is_none());
    }

    #[test]
    fn the_return_of_a_controller_that_had_left_ends_the_warning_once() {
        let mut reported = ReportedPeers::default();
        assert!(reported.news(&[7], &[7]).is_some() && reported.news(&[], &[]).is_some());
        assert!(reported.news(&[], &[8]).is_none(), "another controller");
        let Some((Subject::Peer(7), Problem::End(text))) = reported.news(&[], &[7, 8]) else { panic!("an end") };
        assert_eq!(text, "controller 0000000000000007 is in the room again");
        assert!(reported.news(&[], &[7, 8]).is_none());
    }

    #[test]
    fn a_controller_whose_token_is_back_without_its_status_is_silent_again() {
        let mut reported = ReportedPeers::default();
        assert!(reported.news(&[7], &[7]).is_some() && reported.news(&[], &[]).is_some());
        assert!(matches!(reported.news(&[7], &[7]), Some((Subject::Peer(7), Problem::Warning(_)))));
        assert!(matches!(reported.news(&[], &[7]), Some((Subject::Peer(7), Problem::End(_)))));
        assert!(reported.news(&[], &[7]).is_none(), "one end");
    }

    #[test]
    fn of_the_controllers_that_left_the_last_ones_are_remembered() {
        let mut reported = ReportedPeers::default();
        for peer in 0..=LEFT_MAX as u64 {
            assert!(reported.news(&[peer], &[peer]).is_some() && reported.news(&[], &[]).is_some());
        }
        assert!(reported.news(&[], &[0]).is_none());
        assert!(matches!(reported.news(&[], &[1]), Some((Subject::Peer(1), Problem::End(_)))));
    }
}
