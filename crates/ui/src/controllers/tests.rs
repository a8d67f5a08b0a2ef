//! Which controllers are shown, and the part of each.

use heliostat_proto::Stamp;

use super::refusals::STALE_DECISIONS;
use super::*;

fn status(source: u64, counters: &[(&str, u64)]) -> NodeStatus {
    let stamp = Stamp { source, ..Stamp::default() };
    let counters = counters.iter().map(|(name, count)| ((*name).to_owned(), *count)).collect();
    NodeStatus { stamp, counters, ..NodeStatus::default() }
}

#[test]
fn the_leader_is_first_and_one_that_has_left_is_gone() {
    let (mut controllers, name) = (Controllers::default(), NodeKind::Controller.name());
    controllers.take(&status(1, &[(STANDBY, 1), (TAKEOVERS, 1)]));
    controllers.take(&status(2, &[(STANDBY, 0), (TAKEOVERS, 3), (FALSE_TAKEOVERS, 2), ("host:host-a", 1)]));
    let present = controllers.present(&[(name, 1), (name, 2)].into(), None);
    let expected = ControllerFigures {
        name: "0000000000000002".into(),
        host: "host-a".into(),
        takeovers: 3,
        false_takeovers: 2,
        ..ControllerFigures::default()
    };
    assert_eq!((&present[0], present[1].role, present.len()), (&expected, Role::StandsBy, 2));
    let shown = [&present[0], &present[1]].map(ToString::to_string);
    assert_eq!(shown, ["0000000000000002 on host-a leads", "0000000000000001 stands by"]);
    assert_eq!(controllers.present(&[(name, 1)].into(), None).len(), 1);
}

#[test]
fn a_leader_whose_array_does_not_fit_is_said_to_send_no_commands() {
    let shown = |role, unfit: &str| {
        ControllerFigures { name: "a1".into(), role, unfit: unfit.into(), ..ControllerFigures::default() }.to_string()
    };
    assert_eq!(shown(Role::Leads, &unfit_in_words(&[])), "a1 leads, sends no commands");
    assert_eq!(shown(Role::Leads, "mirrors-1"), "a1 leads, sends no commands to mirrors-1");
    assert_eq!([shown(Role::Leads, ""), shown(Role::StandsBy, "array")], ["a1 leads", "a1 stands by"]);
}

#[test]
fn of_two_controllers_that_command_the_one_leads_whose_epoch_the_array_follows() {
    let (mut controllers, name) = (Controllers::default(), NodeKind::Controller.name());
    controllers.take(&status(1, &[(EPOCH, 900)]));
    let mut roles = |alive: &[u64], followed_epoch| -> Vec<(String, Role)> {
        controllers.take(&status(2, &[(EPOCH, 500)]));
        let alive = alive.iter().map(|source| (name, *source)).collect();
        let present = controllers.present(&alive, followed_epoch).into_iter();
        present.map(|one| (one.name[15..].to_owned(), one.role)).collect()
    };
    let of = |name: &str, role| (name.to_owned(), role);
    assert_eq!(roles(&[1, 2], Some(500)), [of("2", Role::Leads), of("1", Role::Unfollowed)]);
    let renewed = Some(500 + 3 * EPOCH_SLOTS);
    assert_eq!(roles(&[1, 2], renewed), [of("2", Role::Leads), of("1", Role::Unfollowed)]);
    assert_eq!(roles(&[1, 2], None), [of("1", Role::Unfollowed), of("2", Role::Unfollowed)]);
    assert_eq!(roles(&[1], Some(500)), [of("1", Role::Leads)], "no other one commands");
}

#[test]
fn of_very_many_controllers_the_leader_and_the_first_of_the_others_are_shown() {
    let (mut controllers, name) = (Controllers::default(), NodeKind::Controller.name());
    (1..200).for_each(|source| controllers.take(&status(source, &[(STANDBY, 1)])));
    controllers.take(&status(500, &[]));
    let alive = (1..=500).map(|source| (name, source)).collect();
    let present = controllers.present(&alive, None);
    assert_eq!((present.len(), present[0].name.as_str()), (SOURCES_MAX, controller_name(500).as_str()));
}

#[test]
fn a_controller_in_the_room_has_a_place_beside_very_many_others() {
    let (mut controllers, alive) = (Controllers::default(), [(NodeKind::Controller.name(), 500)].into());
    for source in 1..=500 {
        if controllers.has_place(source, &alive) {
            controllers.take(&status(source, &[]));
        }
    }
    assert_eq!((controllers.0.len(), controllers.0.contains_key(&500)), (SOURCES_MAX + 1, true));
}

#[test]
fn of_several_statuses_that_of_the_leader_is_chosen_by_the_followed_epoch() {
    let statuses = |standby| vec![status(1, &[(EPOCH, 900)]), status(2, &[(EPOCH, 500), (STANDBY, standby)])];
    let chosen = |statuses, followed_epoch| leading(statuses, followed_epoch).map(|status| status.stamp.source);
    assert_eq!([Some(900), Some(500)].map(|epoch| chosen(statuses(0), epoch)), [Some(1), Some(2)]);
    assert_eq!(chosen(statuses(1), Some(500)), Some(1), "the other one stands by");
    assert_eq!(chosen(vec![status(2, &[(STANDBY, 1)])], None), Some(2), "none leads");
    assert_eq!(chosen(Vec::new(), None), None);
}

#[test]
fn a_calibration_has_a_role_of_its_own_beside_the_controller_that_stands_by() {
    let (mut controllers, name) = (Controllers::default(), NodeKind::Controller.name());
    controllers.take(&status(1, &[(STANDBY, 1), (EPOCH, 400)]));
    let gauges = CalibrationProgress::default().gauges().map(|(name, value)| (name.to_owned(), value)).to_vec();
    controllers.take(&NodeStatus { gauges, ..status(2, &[(EPOCH, 500)]) });
    let roles = |controllers: &Controllers, followed_epoch| -> Vec<Role> {
        let present = controllers.present(&[(name, 1), (name, 2)].into(), followed_epoch);
        present.into_iter().map(|one| one.role).collect()
    };
    assert_eq!(roles(&controllers, Some(500)), [Role::Calibrates, Role::StandsBy]);
    controllers.take(&status(1, &[(EPOCH, 600)]));
    assert_eq!(roles(&controllers, Some(600)), [Role::Leads, Role::Unfollowed], "its lead is taken");
}

#[test]
fn an_epoch_of_a_process_without_a_status_shows_that_another_one_commands() {
    let (mut controllers, name) = (Controllers::default(), NodeKind::Controller.name());
    let alive: BTreeSet<_> = [(name, 1)].into();
    controllers.take(&status(1, &[(STANDBY, 1), (EPOCH, 3 * EPOCH_SLOTS + 1)]));
    let unseen = |controllers: &Controllers, epoch| controllers.follow_unseen(&alive, Some(epoch));
    assert!(unseen(&controllers, 4 * EPOCH_SLOTS + 2));
    assert!(!unseen(&controllers, 4 * EPOCH_SLOTS + 1), "its own next epoch");
    assert!(!controllers.follow_unseen(&alive, None) && !unseen(&controllers, 0));
    let with_token = [(name, 1), (name, 2)].into();
    assert!(!controllers.follow_unseen(&with_token, Some(4 * EPOCH_SLOTS + 2)), "it is seen, and silent");
    controllers.take(&status(2, &[]));
    assert!(!unseen(&controllers, 4 * EPOCH_SLOTS + 2), "it has just left");
    let mut leads = Controllers::default();
    leads.take(&status(1, &[]));
    assert!(!unseen(&leads, 4 * EPOCH_SLOTS + 2));
}

#[test]
fn a_standby_that_hangs_stays_listed_as_silent_until_another_one_joins() {
    let (mut controllers, name) = (Controllers::default(), NodeKind::Controller.name());
    let roles = |controllers: &Controllers, alive: &[u64]| -> Vec<Role> {
        let alive = alive.iter().map(|source| (name, *source)).collect();
        controllers.present(&alive, None).into_iter().map(|one| one.role).collect()
    };
    controllers.join(2);
    controllers.take(&status(2, &[(STANDBY, 1)]));
    controllers.age(EXPIRY);
    controllers.join(1);
    controllers.take(&status(1, &[]));
    assert_eq!(roles(&controllers, &[1, 2]), [Role::Leads, Role::Silent], "its token remains");
    let forget = |controllers: &mut Controllers, alive: &[u64]| {
        controllers.forget(&alive.iter().map(|source| (name, *source)).collect());
    };
    forget(&mut controllers, &[1, 2]);
    controllers.leave(2);
    forget(&mut controllers, &[1]);
    assert_eq!(roles(&controllers, &[1]), [Role::Leads, Role::Silent], "its connection has expired");
    controllers.join(5);
    let gauges = CalibrationProgress::default().gauges().map(|(name, value)| (name.to_owned(), value)).to_vec();
    controllers.take(&NodeStatus { gauges, ..status(5, &[]) });
    controllers.leave(5);
    assert_eq!(roles(&controllers, &[1]), [Role::Leads, Role::Silent], "a calibration takes no place");
    controllers.join(3);
    controllers.take(&status(3, &[(STANDBY, 1)]));
    assert_eq!(roles(&controllers, &[1, 3]), [Role::Leads, Role::StandsBy], "another one stands by");
    controllers.leave(3);
    assert_eq!(roles(&controllers, &[1]), [Role::Leads], "it has ended");
}

#[test]
fn a_token_without_a_status_is_a_controller_that_does_not_report() {
    let (mut controllers, name) = (Controllers::default(), NodeKind::Controller.name());
    let alive: BTreeSet<_> = [(name, 7)].into();
    controllers.join(7);
    assert!(controllers.present(&alive, None).is_empty(), "it has just started");
    controllers.age(REPORTS_WITHIN);
    let shown: Vec<String> = controllers.present(&alive, None).iter().map(ToString::to_string).collect();
    assert_eq!(shown, ["0000000000000007 does not report"]);
    controllers.leave(7);
    assert!(controllers.present(&BTreeSet::new(), None).is_empty(), "it never reported here");
}

#[test]
fn a_controller_refuses_the_reports_while_it_refuses_each_one() {
    let (mut controllers, name) = (Controllers::default(), NodeKind::Controller.name());
    let mut refuses = |decisions, stale, [from_future, of_stale]: [u64; 2], last_problem: &str| {
        let counters = [
            (STANDBY, 1),
            (DECISIONS, decisions),
            (STALE_DECISIONS, stale),
            ("refused:users:from-future", from_future),
            ("refused:users:stale", of_stale),
        ];
        controllers.take(&NodeStatus { last_problem: last_problem.into(), ..status(1, &counters) });
        controllers.present(&[(name, 1)].into(), None)[0].refuses.clone()
    };
    let ahead = "users refused: a report is 5.0 s ahead of this controller's clock; check the clocks of both";
    let reason = "a report is 5.0 s ahead of this controller's clock; check the clocks of both";
    assert_eq!(refuses(0, 0, [40, 0], ahead), "", "the refusals may be old");
    assert_eq!(refuses(0, 0, [50, 0], ahead), reason);
    assert_eq!(refuses(0, 0, [60, 0], "withheld by the stop of ann"), "from-future", "its problem is another one");
    assert_eq!(refuses(0, 0, [60, 0], ahead), "", "none came");
    assert_eq!(refuses(9, 9, [60, 9], "users refused: a report is 5.0 s old"), "a report is 5.0 s old");
    assert_eq!(refuses(20, 10, [60, 10], ""), "", "it has accepted some");
}

#[test]
fn a_controller_is_deciding_while_its_decisions_rise() {
    let (mut controllers, name) = (Controllers::default(), NodeKind::Controller.name());
    let mut after = |decisions| {
        controllers.take(&status(1, &[(DECISIONS, decisions)]));
        controllers.present(&[(name, 1)].into(), None)[0].is_deciding
    };
    assert_eq!([after(20), after(40), after(40)], [false, true, false]);
}
