//! The table of faults: what is done to a room, and what its effect may be.

use crate::faults::promise::Promise::{self, Follows, FollowsAgain, ParksThenFollows, StopsThenFollows};

/// A fault of the campaign.
#[derive(Clone, Copy, Debug)]
pub struct Fault {
    /// Heading under which the page lists it.
    pub group: &'static str,
    /// Its test.
    pub test: &'static str,
    /// What is done.
    pub action: &'static str,
    /// The bound on its effect.
    pub promise: Promise,
}

impl Fault {
    /// The fault of a test.
    ///
    /// # Panics
    /// When the table has no such row.
    pub fn of(test: &str) -> &'static Self {
        FAULTS
            .iter()
            .find(|fault| fault.test == test)
            .unwrap_or_else(|| panic!("the table of faults has no row {test}"))
    }
}

const fn fault(group: &'static str, test: &'static str, action: &'static str, promise: Promise) -> Fault {
    Fault { group, test, action, promise }
}

const PROCESSES: &str = "Processes";
const NETWORK: &str = "Network";
const BUILDING: &str = "Two hosts";
const DISKS: &str = "Disks";
const CLOCKS: &str = "Clocks";
const PAYLOADS: &str = "Payloads";
const STOPS: &str = "Emergency stops";
const DUPLICATES: &str = "Duplicates";
const FLOODS: &str = "Floods";
const DEVICES: &str = "Devices and policies";

/// All faults, in the order of the page.
pub const FAULTS: &[Fault] = &[
    fault(
        PROCESSES,
        "the_array_parks_while_the_controller_is_frozen",
        "the controller is frozen for 3 s (SIGSTOP)",
        ParksThenFollows(5.0),
    ),
    fault(
        PROCESSES,
        "a_killed_controller_is_replaced_by_the_next",
        "the controller is killed (SIGKILL) and started again",
        FollowsAgain(5.0),
    ),
    fault(
        PROCESSES,
        "a_controller_ended_by_sigterm_is_replaced_by_the_next",
        "the controller ends (SIGTERM) and is started again",
        FollowsAgain(5.0),
    ),
    fault(
        PROCESSES,
        "a_killed_simulator_is_served_again_after_its_restart",
        "the simulator is killed and started again",
        FollowsAgain(5.0),
    ),
    fault(
        PROCESSES,
        "a_killed_driver_follows_again_after_its_restart",
        "the driver is killed and started again",
        FollowsAgain(5.0),
    ),
    fault(PROCESSES, "a_frozen_recorder_does_not_disturb_the_room", "a recorder is frozen for 3 s", Follows),
    fault(PROCESSES, "a_killed_recorder_does_not_disturb_the_room", "a recorder is killed", Follows),
    fault(PROCESSES, "a_killed_viewer_does_not_disturb_the_room", "a viewer (`heliostat ui`) is killed", Follows),
    fault(
        PROCESSES,
        "three_frozen_viewers_do_not_disturb_the_room",
        "three viewers are frozen for 8 s, beyond the lease of 5 s",
        Follows,
    ),
    fault(
        NETWORK,
        "the_array_parks_during_a_partition_of_30_s",
        "controller and array are partitioned for 30 s, beyond the lease of 5 s",
        ParksThenFollows(10.0),
    ),
    fault(
        NETWORK,
        "a_connection_that_died_without_a_close_is_replaced",
        "the connection carries no more bytes and is not closed; new ones work",
        ParksThenFollows(15.0),
    ),
    fault(
        NETWORK,
        "closed_connections_are_opened_again",
        "the connection of controller and array is closed",
        FollowsAgain(5.0),
    ),
    fault(
        NETWORK,
        "a_link_between_two_hosts_that_was_down_for_3_s_is_used_again",
        "packets between the hosts of controller and array are lost for 3 s (network namespaces)",
        ParksThenFollows(15.0),
    ),
    fault(
        NETWORK,
        "silent_connections_do_not_delay_a_new_controller",
        "400 TCP connections that send nothing are opened to the array, then the controller is killed and started again",
        FollowsAgain(5.0),
    ),
    fault(
        NETWORK,
        "a_peer_without_a_certificate_does_not_stop_the_array",
        "a process without a certificate sends 300 stops into a room with access control",
        Follows,
    ),
    fault(
        NETWORK,
        "a_peer_of_another_authority_does_not_stop_the_array",
        "a process with a certificate of another authority sends 300 stops into a room with access control",
        Follows,
    ),
    fault(
        BUILDING,
        "the_standby_of_the_other_host_replaces_a_killed_controller",
        "the controller on host A is killed and not started again",
        FollowsAgain(5.0),
    ),
    fault(
        BUILDING,
        "the_standby_of_the_other_host_replaces_a_frozen_controller",
        "the controller on host A is frozen for 3 s",
        FollowsAgain(5.0),
    ),
    fault(BUILDING, "a_killed_standby_does_not_disturb_the_room", "the standby on host B is killed", Follows),
    fault(BUILDING, "a_frozen_standby_does_not_disturb_the_room", "the standby on host B is frozen for 3 s", Follows),
    fault(
        BUILDING,
        "a_killed_array_is_served_again_through_its_router",
        "the array on host A is killed and started again after 1 s",
        FollowsAgain(5.0),
    ),
    fault(
        BUILDING,
        "a_frozen_array_is_served_again_through_its_router",
        "the array on host A is frozen for 3 s",
        FollowsAgain(5.0),
    ),
    fault(
        BUILDING,
        "the_room_follows_again_after_its_router_was_killed",
        "the router of host A is killed and started again after 1 s",
        FollowsAgain(5.0),
    ),
    fault(
        BUILDING,
        "the_room_follows_again_after_its_router_was_frozen",
        "the router of host A is frozen for 3 s",
        FollowsAgain(5.0),
    ),
    fault(
        BUILDING,
        "a_killed_router_of_the_other_host_does_not_disturb_the_room",
        "the router of host B is killed and started again after 1 s",
        Follows,
    ),
    fault(
        BUILDING,
        "a_frozen_router_of_the_other_host_does_not_disturb_the_room",
        "the router of host B is frozen for 8 s, beyond the lease of 5 s",
        Follows,
    ),
    fault(
        BUILDING,
        "the_loss_of_the_other_host_does_not_disturb_the_room",
        "all processes of host B are killed and started again after 3 s",
        Follows,
    ),
    fault(
        BUILDING,
        "a_cut_link_between_the_hosts_does_not_disturb_a_room_whose_leader_is_local",
        "the link between the hosts is down for 3 s",
        Follows,
    ),
    fault(
        BUILDING,
        "a_stop_beyond_a_cut_link_does_not_disturb_a_room_whose_leader_is_local",
        "the link between the hosts is down for 6 s, and the room beyond it is stopped from this host",
        Follows,
    ),
    fault(
        BUILDING,
        "a_room_is_stopped_while_the_link_to_its_standby_is_cut",
        "the link between the hosts is down for 6 s; the room is stopped from the host of its array, and released",
        StopsThenFollows(5.0),
    ),
    fault(
        BUILDING,
        "a_link_cut_beyond_the_lease_does_not_disturb_a_room_whose_leader_is_local",
        "the link between the hosts is down for 12 s, until the standby stands by again",
        FollowsAgain(5.0),
    ),
    fault(
        BUILDING,
        "lost_packets_between_the_hosts_do_not_disturb_a_room_whose_leader_is_local",
        "10 % of the packets between the hosts are lost for 8 s",
        Follows,
    ),
    fault(
        BUILDING,
        "a_local_standby_takes_over_when_the_link_to_the_host_of_the_leader_is_cut",
        "the leader is the controller on host B, and the link between the hosts is down for 3 s",
        FollowsAgain(5.0),
    ),
    fault(
        BUILDING,
        "a_local_standby_takes_over_when_the_host_of_the_leader_is_lost",
        "the leader is the controller on host B, and all processes of host B are killed and started again after 3 s",
        FollowsAgain(5.0),
    ),
    fault(DISKS, "a_full_disk_ends_the_recorder_and_not_the_room", "the file of a recorder can grow no more", Follows),
    fault(
        CLOCKS,
        "the_array_parks_while_the_clock_of_the_controller_is_1_h_ahead",
        "the clock of the controller is 1 h ahead for 3 s",
        ParksThenFollows(5.0),
    ),
    fault(
        CLOCKS,
        "a_controller_that_started_a_day_ahead_can_be_replaced",
        "a controller starts with its clock a day ahead, the clock is corrected, and the controller is started again",
        FollowsAgain(5.0),
    ),
    fault(PAYLOADS, "wrong_versions_on_every_key_are_refused", "100 payloads of another version on each key", Follows),
    fault(PAYLOADS, "truncated_payloads_on_every_key_are_refused", "100 truncated payloads on each key", Follows),
    fault(PAYLOADS, "oversized_payloads_on_every_key_are_refused", "3 payloads of 2 MiB on each key", Follows),
    fault(PAYLOADS, "a_calibration_with_a_vanishing_gain_is_refused", "a calibration with gains of 1e-38", Follows),
    fault(
        PAYLOADS,
        "wild_values_of_an_operator_are_refused_by_the_simulator",
        "simulator controls with a speed of 1e9 m/s and a power of 3e38 W",
        Follows,
    ),
    fault(
        PAYLOADS,
        "an_unknown_policy_is_refused_by_the_controller",
        "10 orders to switch to a policy that does not exist",
        Follows,
    ),
    fault(
        STOPS,
        "a_stop_of_any_sender_is_obeyed_until_its_re_arm",
        "a foreign process stops the array, and an operator re-arms it after 1 s",
        StopsThenFollows(5.0),
    ),
    fault(DUPLICATES, "a_second_driver_is_refused", "a second driver starts", Follows),
    fault(
        FLOODS,
        "a_flood_of_user_reports_is_survived",
        "5000 user reports of a foreign source a second for 3 s",
        Follows,
    ),
    fault(FLOODS, "a_flood_of_commands_is_survived", "5000 commands of an old epoch a second for 3 s", Follows),
    fault(
        FLOODS,
        "a_flood_of_telemetry_is_survived",
        "5000 telemetry messages of a foreign source a second for 3 s",
        Follows,
    ),
    fault(
        FLOODS,
        "a_flood_of_invalid_stops_is_survived",
        "5000 payloads that are no stops a second for 3 s on the key of stops",
        Follows,
    ),
    fault(
        DEVICES,
        "the_array_follows_again_after_it_was_offline",
        "the simulated array does not answer for 2 s",
        FollowsAgain(5.0),
    ),
    fault(
        DEVICES,
        "the_array_follows_again_after_its_reboot",
        "the simulated array restarts within 2 s",
        FollowsAgain(5.0),
    ),
    fault(
        DEVICES,
        "late_mirrors_do_not_end_the_commands",
        "each command reaches the simulated mirrors 1 s late for 3 s",
        Follows,
    ),
    fault(
        DEVICES,
        "a_slow_board_does_not_end_the_commands",
        "the board of a driver answers after 300 ms for 3 s",
        FollowsAgain(5.0),
    ),
    fault(DEVICES, "a_silent_board_is_used_again", "the board of a driver does not answer for 3 s", FollowsAgain(10.0)),
    fault(
        DEVICES,
        "a_board_that_disconnects_is_reported_and_used_again",
        "the board of a driver closes its connections for 3 s",
        FollowsAgain(10.0),
    ),
    fault(
        DEVICES,
        "a_policy_slower_than_the_reports_does_not_end_the_commands",
        "the controller runs policy `oracle`, slower than the reports, for 3 s",
        Follows,
    ),
];
