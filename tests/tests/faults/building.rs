//! Two hosts with a router each: processes, routers and the link between them fail.

use heliostat_needs::needs;
use heliostat_tests::faults::{Building, Effect, Host};

use crate::{freeze, measure, wait_s};

/// Time after which a service manager starts a process again, `RestartSec` of the units.
const RESTART_S: f64 = 1.0;

/// Index of the room that is measured, whose array is on host A.
const MEASURED_ROOM: usize = 0;
/// Index of the room whose array is on host B.
const OTHER_ROOM: usize = 1;

/// Measures a fault in a building of its own.
fn in_building(test: &str, fault: impl Fn(&mut Building)) {
    measure(test, || -> Effect { Building::start().undergo(Host::A, &fault) });
}

#[needs("network-namespaces", "router")]
#[test]
fn the_standby_of_the_other_host_replaces_a_killed_controller() {
    in_building("the_standby_of_the_other_host_replaces_a_killed_controller", |building| building.leader().kill());
}

#[needs("network-namespaces", "router")]
#[test]
fn the_standby_of_the_other_host_replaces_a_frozen_controller() {
    in_building("the_standby_of_the_other_host_replaces_a_frozen_controller", |building| {
        freeze(building.leader(), 3.0);
    });
}

#[needs("network-namespaces", "router")]
#[test]
fn a_killed_standby_does_not_disturb_the_room() {
    in_building("a_killed_standby_does_not_disturb_the_room", |building| building.standby().kill());
}

#[needs("network-namespaces", "router")]
#[test]
fn a_frozen_standby_does_not_disturb_the_room() {
    in_building("a_frozen_standby_does_not_disturb_the_room", |building| {
        freeze(building.standby(), 3.0);
    });
}

#[needs("network-namespaces", "router")]
#[test]
fn a_killed_array_is_served_again_through_its_router() {
    in_building("a_killed_array_is_served_again_through_its_router", |building| {
        building.array().kill();
        wait_s(RESTART_S);
        building.restart_array();
    });
}

#[needs("network-namespaces", "router")]
#[test]
fn a_frozen_array_is_served_again_through_its_router() {
    in_building("a_frozen_array_is_served_again_through_its_router", |building| {
        freeze(building.array(), 3.0);
    });
}

#[needs("network-namespaces", "router")]
#[test]
fn the_room_follows_again_after_its_router_was_killed() {
    in_building("the_room_follows_again_after_its_router_was_killed", |building| {
        building.router(Host::A).kill();
        wait_s(RESTART_S);
        building.restart_router(Host::A);
    });
}

#[needs("network-namespaces", "router")]
#[test]
fn the_room_follows_again_after_its_router_was_frozen() {
    in_building("the_room_follows_again_after_its_router_was_frozen", |building| {
        freeze(building.router(Host::A), 3.0);
    });
}

#[needs("network-namespaces", "router")]
#[test]
fn a_killed_router_of_the_other_host_does_not_disturb_the_room() {
    in_building("a_killed_router_of_the_other_host_does_not_disturb_the_room", |building| {
        building.router(Host::B).kill();
        wait_s(RESTART_S);
        building.restart_router(Host::B);
    });
}

#[needs("network-namespaces", "router")]
#[test]
fn a_frozen_router_of_the_other_host_does_not_disturb_the_room() {
    in_building("a_frozen_router_of_the_other_host_does_not_disturb_the_room", |building| {
        freeze(building.router(Host::B), 8.0);
    });
}

#[needs("network-namespaces", "router")]
#[test]
fn the_loss_of_the_other_host_does_not_disturb_the_room() {
    in_building("the_loss_of_the_other_host_does_not_disturb_the_room", |building| {
        building.kill_host_b();
        wait_s(3.0);
        building.restart_host_b();
    });
}

#[needs("network-namespaces", "router")]
#[test]
fn a_cut_link_between_the_hosts_does_not_disturb_a_room_whose_leader_is_local() {
    in_building("a_cut_link_between_the_hosts_does_not_disturb_a_room_whose_leader_is_local", |building| {
        building.cable.cut();
        wait_s(3.0);
        building.cable.heal();
    });
}

#[needs("network-namespaces", "router")]
#[test]
fn a_stop_beyond_a_cut_link_does_not_disturb_a_room_whose_leader_is_local() {
    in_building("a_stop_beyond_a_cut_link_does_not_disturb_a_room_whose_leader_is_local", |building| {
        building.cable.cut();
        wait_s(2.0);
        let stopped = building.operate(Host::A, OTHER_ROOM, &["stop", "--timeout", "3"]);
        assert!(!stopped.status.success(), "its array is out of reach: {}", stopped.output);
        wait_s(1.0);
        building.cable.heal();
        building.wait_for_standby(Host::B);
    });
}

#[needs("network-namespaces", "router")]
#[test]
fn a_room_is_stopped_while_the_link_to_its_standby_is_cut() {
    in_building("a_room_is_stopped_while_the_link_to_its_standby_is_cut", |building| {
        building.cable.cut();
        wait_s(2.0);
        let stopped = building.operate(Host::A, MEASURED_ROOM, &["stop", "--timeout", "3"]);
        assert!(stopped.status.success(), "the array is on this host: {}", stopped.errors);
        wait_s(1.0);
        building.cable.heal();
        let released = building.operate(Host::A, MEASURED_ROOM, &["rearm", "--all"]);
        assert!(released.status.success(), "{}", released.errors);
    });
}

#[needs("network-namespaces", "router")]
#[test]
fn a_link_cut_beyond_the_lease_does_not_disturb_a_room_whose_leader_is_local() {
    in_building("a_link_cut_beyond_the_lease_does_not_disturb_a_room_whose_leader_is_local", |building| {
        building.cable.cut();
        wait_s(12.0);
        building.cable.heal();
        building.wait_for_standby(Host::B);
    });
}

#[needs("network-namespaces", "router")]
#[test]
fn lost_packets_between_the_hosts_do_not_disturb_a_room_whose_leader_is_local() {
    in_building("lost_packets_between_the_hosts_do_not_disturb_a_room_whose_leader_is_local", |building| {
        assert!(building.cable.lose(10), "packets cannot be lost: install nftables");
        wait_s(8.0);
        building.cable.lose_none();
    });
}

#[needs("network-namespaces", "router")]
#[test]
fn a_local_standby_takes_over_when_the_link_to_the_host_of_the_leader_is_cut() {
    let test = "a_local_standby_takes_over_when_the_link_to_the_host_of_the_leader_is_cut";
    measure(test, || {
        Building::start().undergo(Host::B, |building| {
            building.cable.cut();
            wait_s(3.0);
            building.cable.heal();
        })
    });
}

#[needs("network-namespaces", "router")]
#[test]
fn a_local_standby_takes_over_when_the_host_of_the_leader_is_lost() {
    let test = "a_local_standby_takes_over_when_the_host_of_the_leader_is_lost";
    measure(test, || {
        Building::start().undergo(Host::B, |building| {
            building.kill_host_b();
            wait_s(3.0);
            building.restart_host_b();
        })
    });
}
