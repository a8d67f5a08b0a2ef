//! Drivers that left before the stop, by the status of a controller of this test.

use heliostat_bus::Class;
use heliostat_proto::{LatchedStopReport, LostDriver, MAX_ARRAYS, NodeKind, NodeStatus, Stamp, StopReport};

use super::array::{Manner, publish};
use super::{TIME_LIMIT, arrays, awaited, unconfirmed};

/// The source of the controller.
const CONTROLLER: u64 = 5;

/// The status of the controller, which has lost these drivers.
fn status(lost: &[LostDriver]) -> NodeStatus {
    let stamp = Stamp { source: CONTROLLER, ..Stamp::default() };
    let counters = lost.iter().map(LostDriver::counter).collect();
    NodeStatus { stamp, node: NodeKind::Controller, counters, ..NodeStatus::default() }
}

#[test]
fn a_stop_names_the_driver_that_a_controller_has_lost() {
    let (_arrays, switch, (own, _bus)) = arrays("lost", &[Manner::Stops]);
    let _token = own.announce(&own.room().alive(NodeKind::Controller, CONTROLLER)).unwrap();
    let publisher = own.publisher(&own.room().status(NodeKind::Controller), Class::LowDrop).unwrap();
    awaited("the token of the controller", || !switch.unheard_controllers().is_empty());
    let lost = LostDriver { array: 0, source: 7, since_ns: 1_767_355_384_000_000_000 };
    awaited("the status of the controller", || {
        publish(&publisher, &status(&[lost]));
        switch.unheard_controllers().is_empty()
    });
    let open = unconfirmed(&switch);
    let was_lost = "driver 0000000000000007 was lost at 2026-01-02 12:03:04 UTC";
    let expected = format!("array 0 is not confirmed: {was_lost}; its mirrors may still move: cut the power");
    assert_eq!(open, [expected]);
    let unreleased = switch.unreleased_lost();
    assert!(unreleased.len() == 1 && unreleased[0].starts_with(&format!("array 0: {was_lost}, ")), "{unreleased:?}");
    awaited("the end of the loss", || {
        publish(&publisher, &status(&[]));
        switch.unreleased_lost().is_empty()
    });
    switch.stop_and_confirm("test", TIME_LIMIT).unwrap();
}

#[test]
fn a_controller_whose_status_does_not_come_is_named_and_keeps_no_stop_unconfirmed() {
    let (_arrays, switch, (own, _bus)) = arrays("unheard", &[Manner::Stops]);
    let _token = own.announce(&own.room().alive(NodeKind::Controller, CONTROLLER)).unwrap();
    awaited("the token of the controller", || !switch.unheard_controllers().is_empty());
    switch.stop_and_confirm("test", TIME_LIMIT).unwrap();
    let unheard = switch.unheard_controllers();
    assert!(unheard[0].starts_with("controller 0000000000000005 has not reported which drivers"), "{unheard:?}");
}

#[test]
fn a_status_under_the_key_of_another_kind_of_process_names_no_lost_driver() {
    let (_arrays, switch, (own, _bus)) = arrays("forged", &[Manner::Stops]);
    let _token = own.announce(&own.room().alive(NodeKind::Controller, CONTROLLER)).unwrap();
    let publisher = |node| own.publisher(&own.room().status(node), Class::LowDrop).unwrap();
    let (of_viewer, of_controller) = (publisher(NodeKind::Viewer), publisher(NodeKind::Controller));
    let stamp = Stamp { source: CONTROLLER + 1, ..Stamp::default() };
    let forged = NodeStatus { stamp, ..status(&[LostDriver { array: 0, source: 7, since_ns: 1 }]) };
    awaited("the status of the controller", || {
        publish(&of_viewer, &forged);
        publish(&of_controller, &status(&[]));
        switch.unheard_controllers().is_empty()
    });
    assert_eq!(switch.unreleased_lost(), [""; 0]);
    switch.stop_and_confirm("test", TIME_LIMIT).unwrap();
}

#[test]
fn a_report_under_the_key_of_an_array_that_no_room_has_counts_for_no_array() {
    let (_arrays, switch, (own, _bus)) = arrays("stray", &[Manner::Stops]);
    let _token = own.announce(&own.room().alive(NodeKind::Controller, CONTROLLER)).unwrap();
    let publisher = |key: &str| own.publisher(key, Class::LowDrop).unwrap();
    let stray = publisher(&own.room().array(MAX_ARRAYS).stops());
    let of_controller = publisher(&own.room().status(NodeKind::Controller));
    let stops = vec![LatchedStopReport { source: 3, sequence: 4, ..LatchedStopReport::default() }];
    awaited("the status of the controller", || {
        publish(&stray, &StopReport { stops: stops.clone(), ..StopReport::default() });
        publish(&of_controller, &status(&[]));
        switch.unheard_controllers().is_empty()
    });
    assert!(switch.known_stops().is_empty(), "{:?}", switch.known_stops());
}
