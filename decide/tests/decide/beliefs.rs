//! The belief about the users as a message.

use heliostat_decide::policy::PolicyKind;
use heliostat_proto::{BeliefReport, encode};

use crate::support::{MS, Room, build, controller, scenario};

#[test]
fn the_belief_of_a_decision_is_reported_without_an_allocation() {
    let scenario = scenario(&["control.belief=\"filter\"", "streams.positions.rate_hz=100"]);
    let mut controller = controller(&scenario, build(PolicyKind::Nearest, &scenario).unwrap());
    let mut room = Room::new(&scenario);
    let mut report = BeliefReport::buffer();
    assert!(!controller.report_beliefs(Room::time(0), &mut report), "no report has arrived");
    for tick in 1..=30 {
        room.tick(&mut controller, tick);
    }
    let now = Room::time(30);
    let counted = allocation_counter::measure(|| assert!(controller.report_beliefs(now, &mut report)));
    assert_eq!(counted.count_total, 0);
    assert_eq!((report.tick, report.holds_ns), (30, now + 5 * MS), "half an interval after the report");
    let users = room.positions(30).users;
    for (belief, user) in report.users.iter().zip(&users) {
        assert_eq!(belief.user, user.user);
        let [dx, dy] = [0, 1].map(|axis| belief.position_m[axis] - user.position_m[axis]);
        assert!(dx.hypot(dy) < 0.1, "{belief:?} {user:?}");
        let [along_x, along_y] = belief.velocity_m_s;
        let off = (belief.heading_rad - along_y.atan2(along_x)).rem_euclid(std::f32::consts::TAU);
        assert!(off.min(std::f32::consts::TAU - off) < 0.2, "a walking user faces ahead: {belief:?}");
        assert!(belief.heading_certainty > 0.9 && belief.blocked_probability < 0.1, "{belief:?}");
    }
    assert_eq!(report.users.len(), users.len());
    assert_eq!(encode(&report, &mut Vec::new()), Ok(()));
    assert!(controller.innovations().is_some_and(|innovations| innovations.count == 29 * 3));
}

#[test]
fn without_a_filter_there_is_no_belief() {
    for belief in ["none", "constant-velocity"] {
        let scenario = scenario(&[&format!("control.belief=\"{belief}\"")]);
        let mut controller = controller(&scenario, build(PolicyKind::Nearest, &scenario).unwrap());
        Room::new(&scenario).tick(&mut controller, 1);
        assert!(!controller.report_beliefs(Room::time(1), &mut BeliefReport::buffer()), "{belief}");
        assert_eq!(controller.innovations(), None, "{belief}");
    }
}
