//! The rates of the users and their sums, with the references of a simulated room.

use heliostat_channel::ChannelModel;
use heliostat_proto::gauges::OracleRate;
use heliostat_proto::{NodeKind, SumRates, TruthUser, UserState};
use serde::Serialize;

use super::Origin;
use crate::scene::ModelledSum;
use crate::sums::SumFigures;
use crate::view::Received;

/// One user.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct UserFigures {
    /// Number of the user.
    pub user: u32,
    /// Position of the detector in m.
    pub position_m: [f32; 3],
    /// Whether the direct path is blocked; absent where no process reports it.
    pub blocked: Option<bool>,
    /// Whether it is blocked by order.
    pub forced: bool,
    /// Rate in Mbit/s; 0 where it is unknown.
    pub rate_mbps: f32,
    /// Rate at the angles of the oracle in Mbit/s, by the last status of a simulated room; absent where it is unknown
    /// and while the mirrors do not follow a policy.
    pub oracle_mbps: Option<f64>,
    /// The user's rate as a share of [`oracle_mbps`](Self::oracle_mbps), both of the instant of that status; absent
    /// where it is unknown, and where the oracle gives this user no rate.
    pub share_of_oracle: Option<f64>,
    /// The user's rate at that instant in Mbit/s; absent without a share.
    pub compared_mbps: Option<f64>,
    /// Whether the rate is known: a receiver reported the user's SINR, or the room its truth.
    pub is_rate_known: bool,
    /// The user's minimum rate in Mbit/s.
    pub min_rate_mbps: f32,
}

impl UserFigures {
    /// Whether the minimum rate is met.
    pub fn is_met(&self) -> bool {
        self.rate_mbps >= self.min_rate_mbps
    }
}

/// Where the users come from, the tick, and the users.
pub(super) fn users(model: &ChannelModel, received: &Received) -> (Origin, u64, Vec<UserFigures>) {
    if let Some(truth) = Received::fresh(&received.truth) {
        let oracle = oracle_rates(received);
        let of_oracle = |user: u32| oracle.iter().find(|rate| rate.user == user);
        let user = |user: &TruthUser| {
            let compared = of_oracle(user.user).and_then(|rate| compared_with(received, rate));
            UserFigures {
                user: user.user,
                position_m: user.position_m,
                blocked: Some(user.los_blocked),
                forced: user.forced,
                rate_mbps: user.rate_bps * 1e-6,
                oracle_mbps: of_oracle(user.user).map(|rate| rate.mbps),
                share_of_oracle: compared.map(|(share, _)| share),
                compared_mbps: compared.map(|(_, mbps)| mbps),
                is_rate_known: true,
                min_rate_mbps: user.min_rate_bps * 1e-6,
            }
        };
        return (Origin::Simulated, truth.tick, truth.users.iter().map(user).collect());
    }
    let Some(report) = Received::fresh(&received.users) else { return (Origin::NoData, 0, Vec::new()) };
    // Before the first truth, and where it is rare, the reports of a simulator have the users.
    let origin = if received.is_simulated() { Origin::Simulated } else { Origin::Real };
    let channel = Received::fresh(&received.channel).map_or(&[][..], |report| &report.users);
    let user = |user: &UserState| {
        let gains = channel.iter().find(|gains| gains.user == user.user);
        let rate = |sinr: f32| model.budget.rate_bps(f64::from(sinr), report.users.len());
        UserFigures {
            user: user.user,
            position_m: user.position_m,
            blocked: gains.map(|gains| gains.los_gain == 0.0),
            forced: false,
            rate_mbps: gains.map_or(0.0, |gains| rate(gains.sinr) * 1e-6) as f32,
            oracle_mbps: None,
            share_of_oracle: None,
            compared_mbps: None,
            is_rate_known: gains.is_some(),
            min_rate_mbps: user.min_rate_bps * 1e-6,
        }
    };
    (origin, report.tick, report.users.iter().map(user).collect())
}

/// The rates of the users at the angles of the oracle, while the mirrors of a simulated room follow a policy.
fn oracle_rates(received: &Received) -> Vec<OracleRate> {
    let room = received.fresh_status(NodeKind::SimNode.name()).filter(|_| received.in_charge().idle.is_empty());
    room.map(OracleRate::all_of).unwrap_or_default()
}

/// A user's rate as a share of that of the oracle at the same instant, then this rate in Mbit/s. Its present rate is of a
/// later instant.
fn compared_with(received: &Received, oracle: &OracleRate) -> Option<(f64, f64)> {
    let (_, rate_bps) = received.rates_at_status.iter().find(|(user, _)| *user == oracle.user)?;
    let mbps = f64::from(*rate_bps) * 1e-6;
    (oracle.mbps > 0.0).then(|| (mbps / oracle.mbps, mbps))
}

/// The sum rates; `modelled` where a real room reports no gains, `None` where they are unknown.
pub(super) fn sum(received: &Received, users: &[UserFigures], modelled: Option<ModelledSum>) -> Option<SumFigures> {
    if let Some(truth) = Received::fresh(&received.truth) {
        return Some(sum_of(&truth.sum_rate_bps));
    }
    let policy = users.iter().map(|user| f64::from(user.rate_mbps)).sum();
    // A sum without the unknown rates would be too small.
    let is_known = !users.is_empty() && users.iter().all(|user| user.is_rate_known);
    let measured = is_known.then_some(SumFigures { policy, ..SumFigures::default() });
    let is_unknown = !users.is_empty() && users.iter().all(|user| !user.is_rate_known);
    let modelled = modelled.filter(|_| is_unknown && !received.is_simulated());
    measured.or(modelled.map(|ModelledSum { policy, no_irs }| SumFigures {
        policy,
        no_irs: Some(no_irs),
        is_modelled: true,
        ..SumFigures::default()
    }))
}

fn sum_of(sum: &SumRates) -> SumFigures {
    let mbps = |bps: f64| Some(bps * 1e-6);
    SumFigures {
        policy: sum.policy * 1e-6,
        no_irs: mbps(sum.no_irs),
        flat: mbps(sum.flat),
        oracle: mbps(sum.oracle),
        is_modelled: false,
    }
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, Instant};

    use heliostat_proto::{ArrayState, MirrorTelemetry, NodeStatus, RoomTruth, Stamp, UserReport};
    use heliostat_scenario::Scenario;

    use super::*;

    #[test]
    fn the_reports_of_a_simulator_are_those_of_a_simulated_room_also_without_a_recent_truth() {
        let model = Scenario::default().channel_model().expect("a model");
        let ago = |ms| Instant::now() - Duration::from_millis(ms);
        let by = |source| Stamp { source, ..Stamp::default() };
        let received = |truth: Option<Instant>, reports, source| Received {
            truth: truth.map(|at| (at, RoomTruth { stamp: by(7), ..RoomTruth::default() })),
            users: Some((reports, UserReport { stamp: by(source), ..UserReport::default() })),
            ..Received::default()
        };
        let origin = |truth, reports, source| users(&model, &received(truth, reports, source)).0;
        assert_eq!(origin(Some(ago(100)), ago(0), 7), Origin::Simulated);
        // A paused simulator that goes on publishes a report before its first truth.
        assert_eq!(origin(Some(ago(9000)), ago(0), 7), Origin::Simulated);
        assert_eq!(origin(Some(ago(9000)), ago(0), 8), Origin::Real, "of a tracker that came after it");
        assert_eq!(origin(Some(ago(3010)), ago(3010), 7), Origin::NoData);
        assert_eq!(origin(None, ago(0), 7), Origin::Real);
        let mut starting = received(None, ago(0), 7);
        starting.alive.insert((NodeKind::SimNode.name(), 7));
        assert_eq!(users(&model, &starting).0, Origin::Simulated, "of a simulator that has just started");
    }

    #[test]
    fn the_rate_of_the_oracle_is_known_in_a_simulated_room_whose_mirrors_follow_a_policy() {
        let model = Scenario::default().channel_model().expect("a model");
        let mut received = Received::default();
        received.alive.insert((NodeKind::Controller.name(), 7));
        let gauges = vec![OracleRate { user: 3, mbps: 12.5 }.gauge()];
        let status = NodeStatus { node: NodeKind::SimNode, gauges, ..NodeStatus::default() };
        received.statuses.insert(NodeKind::SimNode.name().into(), (Instant::now(), status));
        let truth = |user| {
            let users = vec![TruthUser { user, ..TruthUser::default() }];
            Some((Instant::now(), RoomTruth { users, ..RoomTruth::default() }))
        };
        let mut oracle = |state, user| {
            received.arrays.note(0, MirrorTelemetry { state, ..MirrorTelemetry::default() });
            received.truth = truth(user);
            users(&model, &received).2[0].oracle_mbps
        };
        assert_eq!(oracle(ArrayState::Following, 3), Some(12.5));
        assert_eq!(oracle(ArrayState::Following, 4), None, "this user has just entered");
        assert_eq!(oracle(ArrayState::Parked, 3), None, "no policy is judged");
    }

    #[test]
    fn a_share_of_the_oracle_compares_rates_of_one_instant() {
        let rates_at_status = vec![(3, 10e6), (4, 10e6)];
        let received = Received { rates_at_status, ..Received::default() };
        let compared = |user, mbps| compared_with(&received, &OracleRate { user, mbps });
        let (share, mbps) = compared(3, 12.5).expect("a share");
        assert!((share - 0.8).abs() < 1e-9 && (mbps - 10.0).abs() < 1e-9, "{share} {mbps}");
        assert_eq!(compared(4, 0.0), None, "the oracle gives this user no rate");
        assert_eq!(compared(5, 12.5), None, "this user has just entered");
    }
}
