//! What the stop reports of a room are read as.

use super::reported_array::TELEMETRY_AGE_MAX;
use super::*;
use crate::enumerations::NodeKind;
use crate::limits::{MAX_STOPS, START_WINDOW_NS};
use crate::lost_driver::LostDriver;
use crate::structures::Counters;

const NOW: Duration = Duration::from_secs(100);

fn report(sequence: u64, device_stopped: bool) -> StopReport {
    StopReport {
        stamp: Stamp { source: 9, sequence, time_ns: 0 },
        device_stopped,
        stops: vec![LatchedStopReport { source: 3, sequence: 4, ..LatchedStopReport::default() }],
        ..StopReport::default()
    }
}

fn order() -> EmergencyStop {
    EmergencyStop { stamp: Stamp { source: 3, sequence: 4, time_ns: 0 }, ..EmergencyStop::default() }
}

fn ordered() -> ReportedStops {
    let mut stops = ReportedStops::default();
    stops.announce(NOW, 1);
    stops.order(NOW, &order());
    stops
}

/// Array 0 reports the stop of [`order`], and then that it is released.
fn release(stops: &mut ReportedStops) {
    stops.handle_stops(NOW, 0, report(1, true));
    stops.handle_stops(NOW, 0, StopReport { stops: Vec::new(), ..report(2, false) });
    assert_eq!(stops.stops(), []);
}

/// The arrays for which the stop of [`order`] is held, and due for repetition.
fn due(stops: &ReportedStops) -> Vec<usize> {
    let arrays: Vec<usize> = stops.unreported(NOW).into_iter().map(|(array, ..)| array).collect();
    assert_eq!(arrays, stops.stops().first().map_or_else(Vec::new, |stop| stop.arrays.clone()));
    arrays
}

#[test]
fn a_stop_of_this_process_is_held_for_an_array_that_appears_after_its_release_at_another_one() {
    let mut stops = ReportedStops::default();
    stops.handle_telemetry(NOW, 0, &MirrorTelemetry::default());
    stops.order(NOW, &order());
    release(&mut stops);
    let mut with_geometry = stops.clone();
    stops.handle_driver(NOW, (Some(1), 7), true);
    assert_eq!(due(&stops), [1], "the array that has released the stop stays released");
    with_geometry.announce(NOW, 3);
    assert_eq!(due(&with_geometry), [1, 2]);
    let name = order().name();
    assert_eq!([0, 1, 2].map(|array| stops.has_reported(array, name)), [true, false, false]);
    let released = StopReport { stops: Vec::new(), released: vec![name], ..report(1, false) };
    stops.handle_stops(NOW, 1, released);
    assert!(due(&stops).is_empty() && stops.has_reported(1, name), "it had the stop before it appeared here");
}

#[test]
fn a_later_stop_of_its_sender_confirms_a_stop() {
    let mut stops = ordered();
    stops.order(NOW, &EmergencyStop { stamp: Stamp { sequence: 5, ..order().stamp }, ..order() });
    let later = vec![LatchedStopReport { source: 3, sequence: 5, ..LatchedStopReport::default() }];
    stops.handle_stops(NOW, 0, StopReport { stops: later, ..report(1, true) });
    assert!(stops.has_stopped(order().name(), NOW, NOW));
    assert!(!stops.has_stopped(StopName { sequence: 6, ..order().name() }, NOW, NOW));
}

#[test]
fn a_stop_that_this_process_releases_is_held_for_no_array_that_appears_later() {
    let mut stops = ReportedStops::default();
    stops.handle_telemetry(NOW, 0, &MirrorTelemetry::default());
    stops.order(NOW, &order());
    stops.forget_unlatched(&[order().name()], NOW);
    release(&mut stops);
    stops.handle_driver(NOW, (Some(1), 7), true);
    assert!(due(&stops).is_empty());
}

#[test]
fn a_stop_of_this_process_is_held_for_the_first_array_that_appears() {
    let mut stops = ReportedStops::default();
    stops.order(NOW, &order());
    assert!(stops.is_empty() && stops.stops().is_empty());
    stops.handle_telemetry(NOW, 0, &MirrorTelemetry::default());
    assert_eq!(due(&stops), [0]);
}

#[test]
fn a_stop_that_every_array_of_the_geometry_has_dropped_is_not_held_for_the_arrays_of_a_larger_one() {
    let mut stops = ordered();
    release(&mut stops);
    stops.announce(NOW, 2);
    assert_eq!(due(&stops), [0; 0]);
}

#[test]
fn a_stop_report_that_arrives_late_shows_no_device_as_stopped() {
    let mut stops = ordered();
    stops.handle_stops(NOW, 0, report(2, false));
    stops.handle_stops(NOW, 0, report(1, true));
    assert_eq!(stops.standings(NOW, None), [(0, Standing::Latched { problem: String::new() })]);
    stops.handle_stops(NOW, 0, report(3, true));
    assert_eq!(stops.standings(NOW, None), [(0, Standing::Stopped)]);
}

#[test]
fn a_late_report_of_one_of_two_drivers_shows_its_device_not_as_stopped() {
    let mut stops = ordered();
    let of_other = |sequence| {
        let report = report(sequence, true);
        StopReport { stamp: Stamp { source: report.stamp.source + 1, ..report.stamp }, ..report }
    };
    let sources = [report(1, true), of_other(1)].map(|report| report.stamp.source);
    sources.into_iter().for_each(|source| stops.handle_driver(NOW, (Some(0), source), true));
    for report in [report(5, false), of_other(9), report(4, true), of_other(10)] {
        stops.handle_stops(NOW, 0, report);
    }
    assert!(!stops.has_stopped(order().name(), NOW, NOW));
    stops.handle_stops(NOW, 0, report(6, true));
    assert!(stops.has_stopped(order().name(), NOW, NOW));
}

#[test]
fn a_stop_that_a_later_report_of_an_array_does_not_name_is_forgotten_for_it() {
    let name = StopName { source: 3, sequence: 4 };
    let mut stops = ReportedStops::default();
    stops.announce(NOW, 3);
    stops.handle_stops(NOW, 0, report(1, true));
    stops.handle_stops(NOW, 1, StopReport { stops: Vec::new(), ..report(1, false) });
    stops.forget_unlatched(&[name], NOW);
    assert_eq!(stops.stops()[0].arrays, [0, 1, 2], "a repetition may be on its way");
    let later = NOW + Duration::from_nanos(1);
    stops.handle_stops(later, 0, report(2, true));
    stops.handle_stops(later, 1, StopReport { stops: Vec::new(), ..report(2, false) });
    stops.forget_unlatched(&[name], NOW);
    assert_eq!(stops.stops()[0].arrays, [0, 2], "the last one does not answer");
}

#[test]
fn an_array_that_has_stopped_and_does_not_record_the_stop_is_named() {
    let mut stops = ordered();
    let with_problem = |report| StopReport { problem: "the disk is full".into(), ..report };
    stops.handle_stops(NOW, 0, with_problem(report(1, false)));
    assert_eq!(stops.unrecorded(NOW), [], "the problem of a device");
    stops.handle_stops(NOW, 0, with_problem(report(2, true)));
    assert_eq!(stops.standings(NOW, None), [(0, Standing::Stopped)]);
    assert_eq!(stops.unrecorded(NOW), [(0, "the disk is full".to_owned())]);
    assert!(!stops.has_stops_after(0, NOW));
    let later = NOW + Duration::from_nanos(1);
    stops.handle_stops(later, 0, report(3, true));
    assert!(stops.has_stops_after(0, NOW));
    assert_eq!(stops.unrecorded(later), [], "it is recorded now");
}

#[test]
fn each_of_two_drivers_of_an_array_has_to_confirm_a_stop() {
    let mut stops = ordered();
    let of_other = |report: StopReport| StopReport { stamp: Stamp { source: 7, ..report.stamp }, ..report };
    let shared = |open: &[u64], problem: &str| -> [(usize, Standing); 1] {
        [(0, Standing::Shared { drivers: 2, open: open.to_vec(), problem: problem.to_owned() })]
    };
    stops.handle_driver(NOW, (Some(0), 9), true);
    stops.handle_stops(NOW, 0, report(1, true));
    assert_eq!(stops.standings(NOW, None), [(0, Standing::Stopped)]);
    stops.handle_driver(NOW, (Some(0), 7), true);
    assert_eq!(stops.standings(NOW, None), shared(&[7], ""), "it is silent");
    assert!(!stops.has_stopped(order().name(), NOW, NOW));
    let no_link = StopReport { problem: "no link".into(), ..report(1, false) };
    stops.handle_stops(NOW, 0, of_other(no_link));
    assert_eq!(stops.standings(NOW, None), shared(&[7], "no link"), "its device has not stopped");
    stops.handle_stops(NOW, 0, of_other(report(2, true)));
    assert_eq!(stops.standings(NOW, None), [(0, Standing::Stopped)]);
    assert!(stops.has_stopped(order().name(), NOW, NOW));
    assert_eq!(stops.standings(NOW + REPORT_AGE_MAX, None), shared(&[7, 9], ""));
    stops.handle_driver(NOW, (Some(0), 7), false);
    assert_eq!(stops.standings(NOW, None), [(0, Standing::Stopped)], "the other one has ended");
}

/// An array with the stop of [`order`] that its driver 9 confirms, and a driver 7 that has been silent since [`NOW`]; and
/// the time when its connection expires.
fn with_frozen_driver() -> (ReportedStops, Duration) {
    let (mut stops, later) = (ordered(), NOW + TELEMETRY_AGE_MAX);
    [7, 9].into_iter().for_each(|source| stops.handle_driver(NOW, (Some(0), source), true));
    let stamp = Stamp { source: 7, sequence: 1, time_ns: 0 };
    stops.handle_telemetry(NOW, 0, &MirrorTelemetry { stamp, ..MirrorTelemetry::default() });
    stops.handle_stops(later, 0, report(1, true));
    (stops, later)
}

#[test]
fn a_driver_that_is_lost_before_it_answers_keeps_a_stop_unconfirmed_until_it_returns_and_answers() {
    let (mut stops, later) = with_frozen_driver();
    stops.handle_driver(later, (Some(0), 7), false);
    assert_eq!(stops.standings(later, None), [(0, Standing::Lost { drivers: vec![7], since_ns: None })]);
    assert!(!stops.has_stopped(order().name(), later, NOW));
    stops.handle_driver(later, (Some(0), 7), true);
    let open = Standing::Shared { drivers: 2, open: vec![7], problem: String::new() };
    assert_eq!(stops.standings(later, None), [(0, open)], "it has returned");
    let of_other = StopReport { stamp: Stamp { source: 7, sequence: 1, time_ns: 0 }, ..report(1, true) };
    stops.handle_stops(later, 0, of_other);
    assert!(stops.has_stopped(order().name(), later, NOW));
    // It froze again after its answer.
    let last = later + REPORT_AGE_MAX;
    stops.handle_stops(last, 0, report(2, true));
    stops.handle_driver(last, (Some(0), 7), false);
    assert_eq!(stops.standings(last, None), [(0, Standing::Stopped)], "its device has executed the stop");
}

#[test]
fn a_driver_that_reports_until_its_end_is_lost_too_unless_it_has_confirmed_and_a_release_forgets_it() {
    let (mut stops, later) = with_frozen_driver();
    let of_it = |sequence, has_executed| StopReport {
        stamp: Stamp { source: 7, sequence, time_ns: 0 },
        ..report(sequence, has_executed)
    };
    let mut confirmed = stops.clone();
    confirmed.handle_stops(later, 0, of_it(2, true));
    confirmed.handle_driver(later, (Some(0), 7), false);
    assert_eq!(confirmed.standings(later, None), [(0, Standing::Stopped)], "its device has executed the stop");
    stops.handle_stops(later, 0, of_it(2, false));
    stops.handle_driver(later, (Some(0), 7), false);
    stops.handle_stops(later, 0, report(2, true));
    assert_eq!(
        stops.standings(later, None),
        [(0, Standing::Lost { drivers: vec![7], since_ns: None })],
        "its device moves"
    );
    stops.handle_stops(later, 0, StopReport { stops: Vec::new(), ..report(3, false) });
    assert_eq!(stops.standings(later, None), [(0, Standing::Free)]);
    let again = EmergencyStop { stamp: Stamp { sequence: 5, ..order().stamp }, ..order() };
    stops.order(later, &again);
    let latched = vec![LatchedStopReport { source: 3, sequence: 5, ..LatchedStopReport::default() }];
    stops.handle_stops(later, 0, StopReport { stops: latched, ..report(4, true) });
    assert_eq!(stops.standings(later, None), [(0, Standing::Stopped)], "it was not there at the order");
}

#[test]
fn a_driver_that_ends_at_its_start_for_another_one_before_it_accepted_a_command_is_not_lost() {
    let lost = |source: u64, accepted: &[u64], token: fn(u64) -> Driver, end: Duration| {
        let (mut stops, end) = (ordered(), NOW + end);
        stops.handle_driver(NOW, (Some(0), 5), true);
        stops.handle_driver(NOW, token(source), true);
        for (sequence, accepted) in (1..).zip(accepted) {
            let stamp = Stamp { source, sequence, time_ns: 0 };
            let counters = Counters { accepted: *accepted, ..Counters::default() };
            stops.handle_telemetry(NOW, 0, &MirrorTelemetry { stamp, counters, ..MirrorTelemetry::default() });
        }
        stops.handle_driver(end, token(source), false);
        stops.lost(end).len()
    };
    let driver: fn(u64) -> Driver = |source| (Some(0), source);
    let window = Duration::from_nanos(START_WINDOW_NS);
    assert_eq!(lost(7, &[0], driver, window), 0);
    assert_eq!(lost(7, &[0], |source| (None, source), window), 0, "a simulator");
    assert_eq!(lost(7, &[0, 1, 0], driver, window), 1, "it has moved mirrors");
    assert_eq!(lost(7, &[], driver, window), 1, "nothing shows that it moved none");
    assert_eq!(lost(7, &[0], driver, window + Duration::from_nanos(1)), 1, "it ends for another reason");
    assert_eq!(lost(3, &[0], driver, window), 1, "the other one had to end");
}

/// The status of a controller that has lost these drivers.
fn status_with(lost: &[LostDriver]) -> NodeStatus {
    let stamp = Stamp { source: 5, ..Stamp::default() };
    let counters = lost.iter().map(LostDriver::counter).collect();
    NodeStatus { stamp, node: NodeKind::Controller, counters, ..NodeStatus::default() }
}

#[test]
fn a_driver_that_was_lost_before_this_process_looked_keeps_a_stop_unconfirmed_while_a_controller_reports_it() {
    let mut stops = ordered();
    stops.handle_controller(5, true);
    stops.handle_stops(NOW, 0, report(1, true));
    assert_eq!((stops.unheard_controllers(), stops.lost(NOW)), (vec![5], vec![]));
    let lost = LostDriver { array: 0, source: 7, since_ns: 3_000_000_000 };
    stops.handle_status(NOW, &NodeStatus { node: NodeKind::Driver, ..status_with(&[lost]) });
    assert_eq!(stops.unheard_controllers(), [5], "the status of another process");
    stops.handle_status(NOW, &status_with(&[lost]));
    let standing = Standing::Lost { drivers: vec![7], since_ns: Some(3_000_000_000) };
    assert!(stops.unheard_controllers().is_empty());
    assert_eq!((stops.standings(NOW, None), stops.lost(NOW)), (vec![(0, standing.clone())], vec![(0, standing)]));
    assert!(!stops.has_stopped(order().name(), NOW, NOW));
    let mut returned = stops.clone();
    returned.handle_driver(NOW, (Some(0), 7), true);
    assert_eq!(returned.lost(NOW), [], "its token shows that it is there");
    let mut ended = stops.clone();
    ended.handle_controller(5, false);
    assert_eq!(ended.lost(NOW), []);
    ended.handle_status(NOW, &status_with(&[lost]));
    assert_eq!((ended.lost(NOW).len(), ended.lost(NOW + REPORT_AGE_MAX).len()), (1, 0), "it has no token");
    stops.handle_status(NOW, &status_with(&[]));
    assert_eq!(stops.standings(NOW, None), [(0, Standing::Stopped)], "the controller has seen a release");
}

#[test]
fn a_room_is_heard_with_the_last_of_its_arrays_and_controllers_or_after_some_time() {
    let mut stops = ReportedStops::default();
    assert!(!stops.is_heard(NOW), "no array is known");
    stops.announce(NOW, 2);
    stops.handle_controller(5, true);
    stops.handle_stops(NOW, 0, report(1, true));
    stops.handle_stops(NOW, 1, report(1, true));
    assert!(!stops.is_heard(NOW), "the controller may have lost a driver");
    let later = NOW + STOPS_WITHIN + Duration::from_millis(1);
    assert!(stops.is_heard(later), "a controller that hangs keeps no stop unconfirmed");
    stops.handle_status(NOW, &status_with(&[]));
    assert!(stops.is_heard(NOW));
    let mut moving = ReportedStops::default();
    moving.announce(NOW, 2);
    moving.handle_stops(NOW, 0, report(1, true));
    moving.handle_telemetry(NOW, 1, &MirrorTelemetry::default());
    assert!(!moving.is_heard(NOW), "the stops of array 1 are on their way");
}

#[test]
fn the_statuses_of_many_controllers_that_have_ended_do_not_keep_out_that_of_another_one() {
    let mut stops = ordered();
    let status = |source| NodeStatus { stamp: Stamp { source, ..Stamp::default() }, ..status_with(&[]) };
    (100..200).for_each(|source| stops.handle_status(NOW, &status(source)));
    let later = NOW + REPORT_AGE_MAX;
    stops.handle_controller(5, true);
    stops.handle_status(later, &status_with(&[]));
    assert!(stops.unheard_controllers().is_empty());
}

#[test]
fn the_statuses_of_many_controllers_without_a_token_do_not_keep_out_that_of_one_with_a_token() {
    let mut stops = ordered();
    let status = |source| NodeStatus { stamp: Stamp { source, ..Stamp::default() }, ..status_with(&[]) };
    let lost = LostDriver { array: 0, source: 7, since_ns: 1_000_000_000 };
    (100..200).for_each(|source| stops.handle_status(NOW, &status(source)));
    stops.handle_status(NOW, &status_with(&[lost]));
    assert_eq!(stops.lost(NOW), [], "it has no token, and there is no place for it");
    stops.handle_controller(5, true);
    stops.handle_status(NOW, &status_with(&[lost]));
    assert!(stops.unheard_controllers().is_empty());
    assert_eq!(stops.lost(NOW), [(0, Standing::Lost { drivers: vec![7], since_ns: Some(1_000_000_000) })]);
}

#[test]
fn an_array_that_only_a_controller_has_seen_has_to_confirm_a_stop_too() {
    let mut stops = ordered();
    stops.handle_stops(NOW, 0, report(1, true));
    stops.handle_status(NOW, &status_with(&[LostDriver { array: 1, source: 7, since_ns: 1 }]));
    assert_eq!(stops.standings(NOW, None), [(0, Standing::Stopped), (1, Standing::Silent)]);
}

#[test]
fn an_array_that_may_have_two_drivers_is_known_by_their_tokens() {
    let mut stops = ReportedStops::default();
    stops.handle_driver(NOW, (Some(0), 7), true);
    stops.handle_driver(NOW, (Some(1), 8), true);
    assert!(!stops.has_shared_array());
    let mut simulated = stops.clone();
    stops.handle_driver(NOW, (Some(1), 9), true);
    assert!(stops.has_shared_array());
    assert_eq!([0, 1].map(|array| stops.drivers_of(array)), [vec![7], vec![8, 9]]);
    simulated.handle_driver(NOW, (None, 6), true);
    assert_eq!(
        [0, 1].map(|array| simulated.drivers_of(array)),
        [vec![6, 7], vec![6, 8]],
        "a simulator drives each array"
    );
}

#[test]
fn arrays_that_started_stopped_have_one_stop_with_the_reason_of_each() {
    let mut stops = ReportedStops::default();
    for (array, reason) in ["no first file", "no second file"].into_iter().enumerate() {
        let latched = LatchedStopReport { reason: reason.into(), ..LatchedStopReport::default() };
        let stamp = Stamp { source: 9 + array as u64, sequence: 1, time_ns: 0 };
        stops.handle_stops(NOW, array, StopReport { stamp, stops: vec![latched], ..StopReport::default() });
    }
    let all = stops.stops();
    assert_eq!((all.len(), &*all[0].arrays), (1, &[0, 1][..]));
    assert_eq!(all[0].reason, "no first file; no second file");
}

#[test]
fn a_stop_without_sender_in_a_full_list_stands_for_others_whatever_its_reason_is() {
    let listed = |sequence, named: u64, has_unlisted: bool| {
        let unlisted = LatchedStopReport { reason: "no record".into(), ..LatchedStopReport::default() };
        let named = (1..=named).map(|source| LatchedStopReport { source, sequence: 1, ..LatchedStopReport::default() });
        let stops = has_unlisted.then_some(unlisted).into_iter().chain(named).collect();
        StopReport { stops, ..report(sequence, true) }
    };
    let full = MAX_STOPS as u64 - 1;
    let mut stops = ReportedStops::default();
    let mut stands = |report| {
        stops.handle_stops(NOW, 0, report);
        let stops = stops.stops();
        stops.iter().find(|stop| stop.name == StopName::default()).map(|stop| stop.stands_for_unlisted)
    };
    assert_eq!(stands(listed(1, full - 1, true)), Some(false), "a list with a free place names every stop");
    assert_eq!(stands(listed(2, full, true)), Some(true));
    assert_eq!(stands(listed(3, 1, true)), Some(true), "the others are not listed since");
    assert_eq!(stands(listed(4, 1, false)), None);
    assert_eq!(stands(listed(5, 1, true)), Some(false), "another one");
}

#[test]
fn an_array_gets_the_stop_itself_only_when_its_stop_reports_would_have_come() {
    let mut stops = ordered();
    for (now, is_older) in [(NOW, false), (NOW + STOPS_WITHIN + Duration::from_millis(1), true)] {
        stops.handle_telemetry(now, 0, &MirrorTelemetry::default());
        let unreported = stops.unreported(now);
        assert!(matches!(&unreported[..], [(0, _, found)] if *found == is_older), "{unreported:?}");
    }
}

#[test]
fn an_array_without_a_fresh_report_does_not_answer() {
    let mut stops = ordered();
    assert_eq!(stops.standings(NOW, None), [(0, Standing::Silent)]);
    stops.handle_stops(NOW, 0, report(1, true));
    let later = NOW + REPORT_AGE_MAX;
    assert_eq!(stops.standings(later - Duration::from_millis(1), None), [(0, Standing::Stopped)]);
    assert_eq!(stops.standings(later, None), [(0, Standing::Silent)]);
    assert!(!stops.has_stopped(StopName { source: 3, sequence: 4 }, NOW, NOW + Duration::from_millis(1)));
}
