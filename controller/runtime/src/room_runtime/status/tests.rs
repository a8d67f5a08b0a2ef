use heliostat_proto::LostDriver;

use super::*;
use crate::report::summary::ArrayStanding;

#[test]
fn what_keeps_commands_from_the_mirrors_is_the_problem_until_it_ends() {
    let mut reporter = Reporter::new(Identity::default());
    let refused = (Subject::Other, Problem::Warning("a report is refused".into()));
    let shown = |reporter: &mut Reporter, problem: Option<&(Subject, Problem)>| {
        reporter.keep(problem);
        reporter.present_problem(1)
    };
    assert_eq!(shown(&mut reporter, Some(&refused)), "a report is refused");
    reporter.unfit = Some("it is too small".into());
    assert_eq!(shown(&mut reporter, Some(&refused)), "the array receives no commands: it is too small");
    reporter.conditions.geometry = Some("rooms differ".into());
    reporter.stops = "withheld by a stop".into();
    assert_eq!(shown(&mut reporter, None), "the array receives no commands: it is too small");
    reporter.unfit = None;
    assert_eq!(shown(&mut reporter, None), "withheld by a stop");
    // The end of the stop falls together with another event, which alone is reported.
    reporter.stops.clear();
    let tenure = (Subject::Tenure, Problem::Warning("another controller leads".into()));
    assert_eq!(shown(&mut reporter, Some(&tenure)), "another controller leads");
    let ended = (Subject::Tenure, Problem::End("this controller leads".into()));
    assert_eq!(shown(&mut reporter, Some(&ended)), "rooms differ", "it began during the stop, and lasts");
    reporter.conditions.geometry = None;
    assert_eq!(shown(&mut reporter, None), "", "none of before returns");
}

#[test]
fn the_log_of_a_stop_names_what_it_withholds() {
    let stops = "withheld by the stop of ann".to_owned();
    let reporter = Reporter { stops, ..Reporter::new(Identity::default()) };
    let Some((Subject::Stops, problem)) = reporter.new_stops("") else { panic!("a stop") };
    assert_eq!(problem.text(), "commands are withheld by the stop of ann");
    assert_eq!(reporter.present_problem(1), "withheld by the stop of ann", "as the state of the status");
}

#[test]
fn a_notice_is_in_the_status_until_its_end() {
    let mut reporter = Reporter::new(Identity::default());
    let mut shown = |problem| {
        reporter.keep(Some(&(Subject::Tenure, problem)));
        reporter.present_problem(1)
    };
    assert_eq!(shown(Problem::Notice("this one stands by".into())), "this one stands by");
    assert_eq!(shown(Problem::Event("this controller takes over".into())), "");
    assert_eq!(shown(Problem::End("this controller leads".into())), "");
}

#[test]
fn light_that_is_not_watched_any_more_is_no_problem() {
    let mut reporter = Reporter::new(Identity::default());
    let mut shown = |light: &[ServedLight]| {
        let problem = reporter.new_light(light);
        reporter.keep(problem.as_ref());
        reporter.present_problem(1)
    };
    let light = |off_since_s| [ServedLight { of: "mirrors".into(), ratio: 0.62, off_since_s }];
    assert!(shown(&light(Some(3.0))).starts_with("the mirrors bring 0.62 of the expected light since"));
    assert_eq!(shown(&[]), "", "another source reports the users");
    assert!(shown(&light(Some(9.0))).starts_with("the mirrors bring 0.62"), "it is off again");
    assert_eq!(shown(&light(None)), "");
}

#[test]
fn the_end_of_the_watch_over_a_light_claims_no_new_measurement() {
    let mut reporter = Reporter::new(Identity::default());
    let off = [ServedLight { of: "mirrors".into(), ratio: 0.62, off_since_s: Some(3.0) }];
    assert!(matches!(reporter.new_light(&off), Some((_, Problem::Warning(_)))));
    let Some((_, Problem::End(end))) = reporter.new_light(&[]) else { panic!("no end") };
    assert_eq!(end, "the light of mirrors is not judged any longer");
}

#[test]
fn one_unfit_array_of_two_is_named_beside_a_controller_that_runs() {
    let mut reporter = Reporter::new(Identity::default());
    let array = |name: &str, unfit| ArrayStanding { name: name.into(), unfit, ..ArrayStanding::default() };
    let mut shown = |unfit: [bool; 2]| {
        let arrays = vec![array("mirrors", unfit[0]), array("mirrors-1", unfit[1])];
        let summary = Summary { unfit: Some("other mirrors".into()), arrays, decisions: 1, ..Summary::default() };
        let state = reporter.state(&summary);
        let swaps = SwapCounters::default();
        let snapshot = Snapshot { summary, problem: None, occurrences: 0, now: 0, state, swaps, room_source: None };
        let status = reporter.report(&snapshot, &StageTimes::default());
        let named = status.counters.into_iter().filter(|(name, _)| name.starts_with(NodeStatus::ARRAY_UNFIT_OF));
        (status.state, named.map(|(name, _)| name).collect::<Vec<_>>())
    };
    assert_eq!(shown([false, true]), ("running".into(), vec!["array_unfit:mirrors-1".into()]));
    assert_eq!(shown([true, true]), ("no commands: the array does not fit".into(), Vec::new()));
}

#[test]
fn an_absent_driver_is_named_before_silent_controllers() {
    let mut reporter = Reporter::new(Identity::default());
    let now = Conditions { without_driver: vec![0], silent_peers: vec![7, 8], ..Conditions::default() };
    let news = [0; 2].map(|_| reporter.new_condition(now.clone(), 1).map(|(subject, _)| subject));
    assert_eq!(news, [Some(Subject::Driver), Some(Subject::Peer(7))]);
}

#[test]
fn a_driver_is_not_blamed_while_this_process_has_no_connection() {
    let mut reporter = Reporter::new(Identity::default());
    let mut problem = |connection: Option<&str>| {
        let connection = connection.map(str::to_owned);
        let now = Conditions { without_driver: vec![0], connection, ..Conditions::default() };
        reporter.new_condition(now, 1);
        reporter.present_problem(1)
    };
    assert_eq!(problem(Some("no connection")), "no driver receives the commands: no connection");
    assert_eq!(problem(None), format!("no driver receives the commands: {DRIVER_ABSENT}"));
}

#[test]
fn the_drivers_that_have_left_are_in_each_status_also_while_the_policy_does_not_return() {
    let lost = LostDriver { array: 1, source: 7, since_ns: 5_000_000_000 };
    let mut reporter = Reporter::default();
    reporter.lost_drivers.set(vec![(lost, false)]);
    let (summary, swaps) = (Summary::default(), SwapCounters::default());
    let stalled = reporter.report_stall(&summary);
    let state = String::new();
    let snapshot = Snapshot { summary, problem: None, occurrences: 0, now: 0, state, swaps, room_source: Some(0xa) };
    let running = reporter.report(&snapshot, &StageTimes::default());
    assert_eq!([running.room_source(), stalled.room_source()], [Some(0xa), None]);
    assert_eq!([running, stalled].map(|status| LostDriver::all_of(&status)), [[lost], [lost]]);
}
