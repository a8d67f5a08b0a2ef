//! Tests of what a view keeps.

use heliostat_proto::{Room, SOURCES_MAX, Stamp, TruthUser, UserState};

use super::*;
use crate::sums::SumFigures;

fn status(source: u64, decisions: u64, standby: u64) -> NodeStatus {
    NodeStatus {
        stamp: Stamp { source, ..Stamp::default() },
        counters: vec![("decisions".into(), decisions), ("standby".into(), standby)],
        ..NodeStatus::default()
    }
}

fn shown(received: &Received) -> (u64, u64) {
    let status = received.fresh_status(NodeKind::Controller.name()).expect("a fresh status");
    (status.stamp.source, status.counters[0].1)
}

#[test]
fn the_reports_of_a_second_source_replace_those_of_the_first_one_only_after_its_end() {
    let mut received = Received::default();
    received.alive.insert((NodeKind::Tracker.name(), 1));
    let stamp = |source| Stamp { source, ..Stamp::default() };
    let take = |received: &mut Received, source| {
        let stamp = stamp(source);
        received.take_users(UserReport { stamp, ..UserReport::default() });
        received.take_channel(ChannelReport { stamp, ..ChannelReport::default() });
        received.take_obstacles(ObstacleReport { stamp, ..ObstacleReport::default() });
        let sources = [
            received.users.as_ref().map(|(_, users)| users.stamp.source),
            received.channel.as_ref().map(|(_, channel)| channel.stamp.source),
            received.obstacles.as_ref().map(|(_, obstacles)| obstacles.stamp.source),
        ];
        (sources, received.user_reports)
    };
    assert_eq!(take(&mut received, 1), ([Some(1); 3], 1));
    assert_eq!(take(&mut received, 2), ([Some(1); 3], 1));
    received.take_presence((NodeKind::Tracker.name(), 1), Presence::Gone);
    received.take_users(UserReport { stamp: stamp(2), ..UserReport::default() });
    assert!(received.channel.is_none() && received.obstacles.is_none(), "those of the first one");
    assert_eq!(take(&mut received, 2), ([Some(2); 3], 3));
}

#[test]
fn a_viewer_that_opens_late_displays_the_source_on_which_the_controller_decides() {
    let mut received = Received::default();
    received.alive.extend([(NodeKind::Tracker.name(), 1), (NodeKind::Tracker.name(), 2)]);
    let take = |received: &mut Received, source| {
        let stamp = Stamp { source, ..Stamp::default() };
        received.take_users(UserReport { stamp, ..UserReport::default() });
        received.users.as_ref().map(|(_, users)| users.stamp.source)
    };
    assert_eq!([take(&mut received, 2), take(&mut received, 1)], [Some(2); 2], "the first one that it received");
    let mut decided = status(9, 5, 0);
    decided.node = NodeKind::Controller;
    decided.counters.push(NodeStatus::room_source_counter(1));
    received.alive.insert((NodeKind::Controller.name(), 9));
    received.take_status(0, decided);
    assert_eq!(take(&mut received, 2), Some(2), "until the other one reports");
    assert_eq!([take(&mut received, 1), take(&mut received, 2)], [Some(1); 2]);
}

#[test]
fn a_controller_that_has_just_started_has_no_decision_times_of_its_predecessor() {
    let (mut received, name) = (Received::default(), NodeKind::Controller.name());
    received.alive.insert((name, 1));
    let mut first = status(1, 500, 0);
    first.counters.push(("decision_us_le:500".into(), 500));
    received.take_status(0, first);
    assert_ne!(received.decision_times(), Histogram::default());
    received.alive = BTreeSet::from([(name, 2)]);
    assert_eq!(received.decision_times(), Histogram::default());
}

#[test]
fn the_counters_of_two_controllers_do_not_mix() {
    let mut received = Received::default();
    let name = NodeKind::Controller.name();
    received.alive.extend([(name, 1), (name, 2)]);
    received.take_status(0, status(1, 500, 0));
    received.take_status(0, status(2, 3, 0));
    assert_eq!(shown(&received), (1, 500), "the one that is displayed stays");
    received.take_status(0, status(1, 501, 1));
    received.take_status(0, status(2, 4, 0));
    assert_eq!(shown(&received), (2, 4), "the first is in standby");
    received.take_status(0, status(1, 502, 1));
    assert_eq!(shown(&received), (2, 4), "a controller in standby replaces none");
    for (source, is_taken) in [(1, false), (2, true)] {
        let stamp = Stamp { source, ..Stamp::default() };
        received.take_belief(BeliefReport { stamp, ..BeliefReport::default() });
        assert_eq!(received.belief.is_some(), is_taken, "the belief of the displayed controller");
    }
    received.alive.remove(&(name, 2));
    received.take_status(0, status(2, 5, 1));
    assert_eq!(shown(&received), (2, 4), "its last status, of the handover");
    received.take_status(0, status(1, 503, 0));
    assert_eq!(shown(&received), (1, 503), "the second has left");
}

#[test]
fn the_rates_beside_a_status_of_the_simulator_stay_those_of_its_instant() {
    let mut received = Received::default();
    let truth = |rate_bps| {
        let users = vec![TruthUser { user: 3, rate_bps, ..TruthUser::default() }];
        RoomTruth { users, ..RoomTruth::default() }
    };
    received.take_truth(truth(10e6));
    received.take_status(0, NodeStatus { node: NodeKind::SimNode, ..status(7, 0, 0) });
    received.take_truth(truth(20e6));
    assert_eq!(received.rates_at_status, [(3, 10e6)]);
}

#[test]
fn a_user_who_stands_still_keeps_its_heading_until_it_leaves() {
    let mut received = Received::default();
    let mut heading = |velocity_m_s| {
        let users = vec![UserState { user: 3, velocity_m_s, ..UserState::default() }];
        received.take_users(UserReport { users, ..UserReport::default() });
        received.headings[&3]
    };
    assert_eq!(heading([0.0, 0.0]), Vec3::zeros());
    assert_eq!(heading([0.0, 1.5]), Vec3::new(0.0, 1.0, 0.0));
    assert_eq!(heading([0.0, 0.0]), Vec3::new(0.0, 1.0, 0.0));
    received.take_users(UserReport::default());
    assert!(received.headings.is_empty());
}

#[test]
fn the_history_has_one_entry_for_each_report_of_a_simulated_or_a_real_room() {
    let mut received = Received::default();
    let sum = |name: &str| PastSum { sum: SumFigures::default(), name: name.into(), idle: false };
    received.keep_sum(sum("before any report"));
    let now = Instant::now();
    for (ms, name) in [(900, "first"), (900, "of the same report"), (850, "shortly after"), (600, "second")] {
        received.users = Some((now - Duration::from_millis(ms), UserReport::default()));
        received.keep_sum(sum(name));
    }
    received.truth = Some((now, RoomTruth::default()));
    received.keep_sum(sum("of the truth"));
    let kept: Vec<&str> = received.history.iter().map(|(_, sum)| sum.name.as_str()).collect();
    assert_eq!(kept, ["first", "second", "of the truth"]);
    received.truth = Some((now + HISTORY, RoomTruth::default()));
    received.keep_sum(sum("much later"));
    let kept: Vec<&str> = received.history.iter().map(|(_, sum)| sum.name.as_str()).collect();
    assert_eq!(kept, ["of the truth", "much later"], "the span of the chart");
}

#[test]
fn a_controller_is_shown_to_lead_only_while_an_array_reports() {
    let mut received = Received::default();
    received.alive.extend([(NodeKind::Controller.name(), 1), (NodeKind::Controller.name(), 2)]);
    received.take_status(0, status(1, 500, 0));
    received.take_status(0, status(2, 0, 1));
    let roles =
        |received: &Received| -> Vec<Role> { received.present_controllers().into_iter().map(|one| one.role).collect() };
    assert_eq!(roles(&received), [Role::Unheard, Role::StandsBy], "no array has reported");
    received.arrays.note(1, MirrorTelemetry::default());
    assert_eq!(roles(&received), [Role::Leads, Role::StandsBy], "one of several arrays is enough");
    received.arrays.age(EXPIRY);
    assert_eq!(roles(&received), [Role::Unheard, Role::StandsBy], "the link to the array is cut");
    assert_eq!(shown(&received), (1, 500), "its figures stay displayed");
}

#[test]
fn the_geometries_of_two_controllers_do_not_replace_each_other() {
    let mut received = Received::default();
    received.take_status(0, NodeStatus { scenario: "hash".into(), ..status(1, 500, 0) });
    for (source, scenario) in [(1, "one"), (2, "other"), (1, "one"), (2, "other")] {
        let stamp = Stamp { source, ..Stamp::default() };
        received.take_controller_geometry(RoomGeometry { stamp, scenario: scenario.into() });
    }
    let announced = |source, geometry: &str, scenario: &str| AnnouncedController {
        name: controller_name(source),
        geometry: geometry.into(),
        scenario: scenario.into(),
    };
    let announcements = received.announcements();
    assert_eq!(announcements.of_controllers, [announced(1, "one", "hash"), announced(2, "other", "")]);
    assert_eq!(announcements.sim_node_scenario, "", "no simulator");
    let simulator = NodeStatus { node: NodeKind::SimNode, scenario: "room".into(), ..NodeStatus::default() };
    received.take_status(0, simulator);
    assert_eq!(received.announcements().sim_node_scenario, "room");
    let drawn = received.drawn_controller_geometry().map(|(_, text)| text);
    assert_eq!(drawn.as_deref(), Some("one"), "that of the displayed controller");
}

#[test]
fn the_geometries_of_very_many_controllers_do_not_keep_out_that_of_one_in_the_room() {
    let mut received = Received::default();
    let take = |received: &mut Received, source| {
        let (stamp, scenario) = (Stamp { source, ..Stamp::default() }, "one".to_owned());
        received.take_controller_geometry(RoomGeometry { stamp, scenario });
    };
    (1..200).for_each(|source| take(&mut received, source));
    assert_eq!(received.controller_geometries.len(), SOURCES_MAX);
    received.alive.insert((NodeKind::Controller.name(), 500));
    take(&mut received, 500);
    assert_eq!(received.controller_geometries.len(), SOURCES_MAX);
    assert!(received.controller_geometries.contains_key(&500));
}

#[test]
fn of_two_controllers_that_command_the_one_is_displayed_that_the_array_follows() {
    let mut received = Received::default();
    received.alive.extend([(NodeKind::Controller.name(), 1), (NodeKind::Controller.name(), 2)]);
    received.arrays.note(0, MirrorTelemetry { epoch: 500, ..MirrorTelemetry::default() });
    let mut take = |source, epoch| {
        let mut status = status(source, source, 0);
        status.counters.push(("epoch".into(), epoch));
        received.take_status(0, status);
        shown(&received).0
    };
    assert_eq!([take(1, 900), take(2, 500), take(1, 900)], [1, 2, 2]);
}

#[test]
fn a_room_of_which_nothing_is_seen_is_named_with_the_rooms_that_are_seen() {
    let mut received = Received::of("lba");
    let alone = received.unseen();
    assert!(alone.as_deref().is_some_and(|note| note.starts_with("no process of this room answers: ")), "{alone:?}");
    let other = Room::new("lab").expect("a valid name").alive(NodeKind::SimNode, 9);
    received.take_token(&other, Presence::Alive);
    let note = received.unseen().expect("the room has no process");
    let start = "room lba has no process here: rooms that are there: lab; check --room and --connect";
    assert!(note.starts_with(start), "{note}");
    assert!(received.alive.is_empty(), "a process of another room is none of this one");
    received.take_token(&other, Presence::Gone);
    assert_eq!(received.unseen(), alone);
    received.take_token(&other.replace("/lab/", "/lba/"), Presence::Alive);
    assert_eq!(received.unseen(), None);
}
