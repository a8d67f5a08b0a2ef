//! The answer to an order, from what its receiver reports.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use heliostat_proto::reported_stops::RoomStop;
use heliostat_proto::{NodeKind, NodeStatus};
use heliostat_service::printable::printable;
use serde::Serialize;

use crate::View;
use crate::order::Order;
use crate::stop_words::still_stopped;
use crate::view::EXPIRY;

/// Reported and ordered values differ at most by the rounding to 32 bits.
const TOLERANCE: f64 = 1e-4;
/// A status that arrives this long after an order describes the time after the order.
const SETTLED: Duration = Duration::from_millis(1500);

/// The state of an order.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case", tag = "state", content = "reason")]
pub enum Answer {
    /// Published; the receiver has not answered yet.
    Sent,
    /// The state of the receiver is as ordered.
    Done,
    /// It released its stops, and another stop keeps the mirrors stopped, as this text says.
    StillStopped(String),
    /// It had no effect, for this reason.
    Refused(String),
    /// The state of the receiver is not as ordered, and it named no reason.
    Missing,
    /// It was published to a room in which no array is present.
    Absent,
    /// A later order replaced it before the receiver answered.
    Replaced,
}

impl Answer {
    /// Whether a later report can change it.
    pub(crate) fn is_open(&self) -> bool {
        matches!(self, Self::Sent | Self::Missing | Self::Absent)
    }

    /// The answer in words, for the page and the log of events.
    pub(crate) fn in_words(&self) -> String {
        match self {
            Self::Sent => "sent, not answered yet".to_owned(),
            Self::Done => "done".to_owned(),
            Self::StillStopped(rest) => format!("released: {rest}"),
            Self::Refused(reason) => format!("refused: {reason}"),
            Self::Missing => "no answer".to_owned(),
            Self::Absent => "no array has confirmed it".to_owned(),
            Self::Replaced => "replaced by a later order".to_owned(),
        }
    }

    /// The answer in the log of events, and whether it is a problem; none before the first one.
    pub(crate) fn in_log(&self) -> Option<(String, bool)> {
        let is_bad = !matches!(self, Self::Done | Self::Replaced);
        (*self != Self::Sent).then(|| (self.in_words(), is_bad))
    }
}

/// What the processes report, as far as it answers orders.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Reported {
    pub controller: Option<(Instant, NodeStatus)>,
    pub simulator: Option<(Instant, NodeStatus)>,
    /// Whether every array for which a stop is held has stopped.
    pub is_stopped: bool,
    /// The stops that are held for any array.
    pub held_stops: Vec<RoomStop>,
    /// The sources of the controllers that are in the room.
    pub controllers: BTreeSet<u64>,
    /// The source of the last status of a controller, of any age.
    pub last_controller: Option<u64>,
    /// Whether the room has an array: a live process of one, or telemetry.
    pub array_present: bool,
}

impl View {
    /// What the processes report.
    pub(crate) fn reported(&self) -> Reported {
        let received = self.received();
        let status = |node: NodeKind| {
            let status = received.statuses.get(node.name()).filter(|(at, _)| at.elapsed() < EXPIRY);
            status.cloned()
        };
        Reported {
            controller: status(NodeKind::Controller),
            simulator: status(NodeKind::SimNode),
            controllers: received.controller_sources().collect(),
            last_controller: received.last_controller(),
            array_present: received.is_array_present(),
            ..Reported::default()
        }
    }
}

impl Reported {
    /// Whether a controller is in the room, or was there last: one that hangs can return after its token has ended.
    fn has_seen(&self, controller: u64) -> bool {
        self.controllers.contains(&controller) || self.last_controller == Some(controller)
    }
}

/// A published order.
#[derive(Clone, Debug)]
pub(crate) struct Published {
    pub order: Order,
    pub at: Instant,
    /// The name of its message in the last problem of the receiver; empty if no message was sent.
    pub tag: String,
    /// What the processes reported before.
    pub before: Reported,
}

impl Published {
    /// The answer, if there is one yet.
    pub fn answer(&self, now: &Reported) -> Option<Answer> {
        let is_done = match &self.order {
            Order::Policy { name } => return self.policy(name, now),
            Order::Stop | Order::Rearm { .. } if !now.array_present => return Some(Answer::Absent),
            Order::Stop => now.is_stopped,
            Order::Rearm { stops } => {
                let is_named = |held: &RoomStop| stops.iter().any(|stop| stop.0 == held.name);
                let is_released = !now.held_stops.iter().any(is_named);
                return is_released.then(|| still_stopped(&now.held_stops).map_or(Answer::Done, Answer::StillStopped));
            }
            Order::KillController {} => now.controllers.is_empty(),
            Order::RestartController {} => now.controllers.iter().any(|source| !self.before.has_seen(*source)),
            Order::Power { .. }
            | Order::Blocked { .. }
            | Order::Speed { .. }
            | Order::Stick { .. }
            | Order::Release {} => {
                return self.simulator(now);
            }
        };
        is_done.then_some(Answer::Done)
    }

    fn policy(&self, name: &str, now: &Reported) -> Option<Answer> {
        let (at, status) = now.controller.as_ref().filter(|(at, _)| *at > self.at)?;
        let refusal = self.refusal(status);
        let before = self.before.controller.as_ref().map(|(_, status)| status);
        let count = |status: &NodeStatus, name: &str| status.counter(name).unwrap_or_default();
        let rose = |name: &str| before.is_none_or(|before| count(before, name) != count(status, name));
        let is_settled = at.duration_since(self.at) > SETTLED;
        if refusal.is_some() {
            return refusal;
        }
        if status.policy == name && (rose("policies_switched") || is_settled) {
            return Some(Answer::Done);
        }
        // A later problem replaced the reason.
        let is_refused = is_settled && before.is_some() && rose("policies_refused") && !rose("policies_switched");
        is_refused.then(|| Answer::Refused("the controller refused it; its log has the reason".into()))
    }

    fn simulator(&self, now: &Reported) -> Option<Answer> {
        let (_, status) = now.simulator.as_ref().filter(|(at, _)| *at > self.at)?;
        if let Some(refusal) = self.refusal(status) {
            return Some(refusal);
        }
        let is = |name: &str, value: f64| status.gauge(name).is_some_and(|gauge| (gauge - value).abs() < TOLERANCE);
        let is_done = match &self.order {
            Order::Power { watts } => is("power_w", f64::from(*watts)),
            Order::Speed { max_m_s } => is("speed_max_m_s", f64::from(*max_m_s)),
            Order::Blocked { users } => is("forced_users", f64::from(*users)),
            Order::Stick { .. } => status.gauge("faulty_mirrors").is_some_and(|count| count > 0.0),
            Order::Release {} => is("faulty_mirrors", 0.0),
            _ => false,
        };
        is_done.then_some(Answer::Done)
    }

    /// The refusal of this order in a status.
    fn refusal(&self, status: &NodeStatus) -> Option<Answer> {
        let (_, reason) = status.last_problem.split_once(&self.tag).filter(|_| !self.tag.is_empty())?;
        Some(Answer::Refused(printable(reason.trim_start_matches([':', ' '])).into_owned()))
    }
}

#[cfg(test)]
mod tests {
    use heliostat_proto::{Stamp, StopName};

    use crate::order::StopLabel;

    use super::*;

    fn tag(source: u64, sequence: u64) -> String {
        Stamp { source, sequence, ..Stamp::default() }.order_name()
    }

    const POLICY: &str = "fixed-point";

    fn published(order: Order) -> Published {
        let before = Reported { controller: Some((Instant::now(), status("greedy", 0, ""))), ..Reported::default() };
        Published { order, at: Instant::now(), tag: tag(7, 3), before }
    }

    fn status(policy: &str, switched: u64, problem: &str) -> NodeStatus {
        NodeStatus {
            policy: policy.into(),
            counters: vec![("policies_switched".into(), switched)],
            last_problem: problem.into(),
            ..NodeStatus::default()
        }
    }

    fn later(status: NodeStatus) -> Option<(Instant, NodeStatus)> {
        Some((Instant::now() + Duration::from_millis(1), status))
    }

    #[test]
    fn a_policy_order_is_answered_by_the_status_of_the_controller_only() {
        let order = published(Order::Policy { name: POLICY.into() });
        let answer = |status| order.answer(&Reported { controller: status, ..Reported::default() });
        assert_eq!(answer(None), None);
        assert_eq!(answer(later(status("greedy", 0, ""))), None);
        assert_eq!(answer(later(status(POLICY, 1, ""))), Some(Answer::Done));
        // A status from before the order is no answer to it.
        assert_eq!(answer(Some((order.before.controller.as_ref().unwrap().0, status(POLICY, 1, "")))), None);
        let refusal = format!("{}: there is no such policy", tag(7, 3));
        assert_eq!(
            answer(later(status("greedy", 0, &refusal))),
            Some(Answer::Refused("there is no such policy".into()))
        );
    }

    #[test]
    fn the_refusal_of_another_order_is_no_answer() {
        let order = published(Order::Policy { name: POLICY.into() });
        for other in [tag(7, 4), tag(8, 3), String::new()] {
            let problem = format!("{other}: there is no such policy");
            let now = Reported { controller: later(status("greedy", 0, &problem)), ..Reported::default() };
            assert_eq!(order.answer(&now), None, "{problem}");
        }
    }

    #[test]
    fn only_the_reports_of_the_arrays_answer_a_stop_and_a_rearm() {
        let present = || Reported { array_present: true, ..Reported::default() };
        let order = published(Order::Stop);
        assert_eq!(order.answer(&present()), None);
        assert_eq!(order.answer(&Reported { is_stopped: true, ..present() }), Some(Answer::Done));
        let (one, other) = (StopName { source: 3, sequence: 4 }, StopName { source: 5, sequence: 1 });
        let order = published(Order::Rearm { stops: vec![StopLabel(one)] });
        let held = |names: &[StopName]| {
            let stop = |name: &StopName| RoomStop {
                name: *name,
                operator: String::new(),
                reason: "two".into(),
                arrays: vec![0],
                known: Duration::ZERO,
                stands_for_unlisted: false,
            };
            Reported { held_stops: names.iter().map(stop).collect(), ..present() }
        };
        assert_eq!(order.answer(&held(&[one])), None);
        assert_eq!(order.answer(&held(&[])), Some(Answer::Done));
        let remains = format!("the mirrors stay stopped by {other} (\"two\") at array 0");
        assert_eq!(order.answer(&held(&[other])), Some(Answer::StillStopped(remains)));
    }

    #[test]
    fn a_stop_or_a_rearm_in_a_room_without_an_array_is_answered_at_once() {
        for order in [Order::Stop, Order::Rearm { stops: Vec::new() }] {
            let order = published(order);
            assert_eq!(order.answer(&Reported::default()), Some(Answer::Absent));
        }
    }

    #[test]
    fn a_restart_is_done_only_when_another_controller_is_in_the_room() {
        let reported = |controllers: &[u64], last| Reported {
            controllers: controllers.iter().copied().collect(),
            last_controller: last,
            ..Reported::default()
        };
        // A controller with a token, and one without: it was killed, or hangs.
        for before in [reported(&[4], Some(4)), reported(&[], Some(4))] {
            let order = Published { before, ..published(Order::RestartController {}) };
            let answer = |controllers: &[u64]| order.answer(&reported(controllers, Some(4)));
            assert_eq!([answer(&[]), answer(&[4]), answer(&[9])], [None, None, Some(Answer::Done)]);
        }
    }

    #[test]
    fn a_value_is_answered_by_the_gauge_of_the_room() {
        let order = published(Order::Power { watts: 0.5 });
        let answer = |watts: f64| {
            let status = NodeStatus { gauges: vec![("power_w".into(), watts)], ..NodeStatus::default() };
            order.answer(&Reported { simulator: later(status), ..Reported::default() })
        };
        assert_eq!(answer(2.0), None);
        assert_eq!(answer(0.5), Some(Answer::Done));
    }
}
