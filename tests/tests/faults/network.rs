//! Links that are interrupted, closed or occupied.

use std::net::TcpStream;
use std::path::Path;
use std::time::Duration;

use heliostat_bus::{AccessRole, BusConfig, Identity};
use heliostat_needs::needs;
use heliostat_proto::EmergencyStop;
use heliostat_tests::encoded;
use heliostat_tests::faults::{Array, Attacker, Effect, Link, Setup, make_keys};

use crate::{measure, wait_s};

fn partition(seconds: f64) -> Effect {
    Setup::new(Array::Simulated).start_with_proxy().undergo(|room| {
        room.proxy().partition();
        wait_s(seconds);
        room.proxy().heal();
    })
}

#[test]
fn the_array_parks_during_a_partition_of_30_s() {
    measure("the_array_parks_during_a_partition_of_30_s", || partition(30.0));
}

#[test]
fn a_connection_that_died_without_a_close_is_replaced() {
    measure("a_connection_that_died_without_a_close_is_replaced", || {
        Setup::new(Array::Simulated).start_with_proxy().undergo(|room| room.proxy().abandon_connections())
    });
}

#[test]
fn closed_connections_are_opened_again() {
    measure("closed_connections_are_opened_again", || {
        Setup::new(Array::Simulated).start_with_proxy().undergo(|room| room.proxy().close_connections())
    });
}

#[needs("network-namespaces")]
#[test]
fn a_link_between_two_hosts_that_was_down_for_3_s_is_used_again() {
    let link = Link::create();
    measure("a_link_between_two_hosts_that_was_down_for_3_s_is_used_again", || {
        let mut setup = Setup::new(Array::Simulated).over_tcp();
        let (_, port) = setup.array_endpoint.rsplit_once(':').expect("an endpoint ends in a port");
        let [host, for_witness] =
            [link.address(), link.witness_address()].map(|address| format!("tcp/{address}:{port}"));
        setup.array_endpoint = for_witness;
        setup.of_array = setup.of_array.flags(&["--listen", &host, "--insecure"]);
        setup.of_array.wrapper = link.wrapper();
        setup.link_endpoint = Some(host);
        setup.start().undergo(|_| {
            link.cut();
            wait_s(3.0);
            link.heal();
        })
    });
}

#[test]
fn silent_connections_do_not_delay_a_new_controller() {
    measure("silent_connections_do_not_delay_a_new_controller", || {
        let mut silent = Vec::new();
        Setup::new(Array::Simulated).over_tcp().start().undergo(|room| {
            let address = room.setup_mut().array_endpoint.trim_start_matches("tcp/").to_owned();
            silent.extend((0..400).map_while(|_| TcpStream::connect(&address).ok()));
            room.controller.kill();
            room.restart_controller();
        })
    });
}

/// The effect of sessions that have no right to enter a room with access control.
fn outsider(config: impl Fn(&BusConfig, &Path) -> BusConfig) -> Effect {
    let keys = tempfile::tempdir().expect("a folder");
    let mut room = Setup::new(Array::Simulated).secured_by(&keys.path().join("keys")).start();
    let other_keys = keys.path().join("other-keys");
    make_keys(&other_keys);
    let outsider = Attacker::outside(&config(&room.setup_mut().session(), &other_keys));
    let effect = room.undergo(|room| {
        let stop = |sequence| encoded(&EmergencyStop { stamp: Attacker::stamp(sequence), ..EmergencyStop::default() });
        outsider.flood(&room.witness.room().stop(), 100.0, Duration::from_secs(3), stop);
    });
    assert!(outsider.alive().is_empty(), "an outsider sees the processes of the room");
    effect
}

#[test]
fn a_peer_without_a_certificate_does_not_stop_the_array() {
    measure("a_peer_without_a_certificate_does_not_stop_the_array", || {
        outsider(|session, _| {
            let plain = |endpoint: &String| endpoint.replace("tls/", "tcp/");
            let connect = session.connect.iter().map(plain).collect();
            BusConfig { connect, identity: None, ..session.clone() }
        })
    });
}

#[test]
fn a_peer_of_another_authority_does_not_stop_the_array() {
    measure("a_peer_of_another_authority_does_not_stop_the_array", || {
        outsider(|session, other_keys| {
            let identity = Identity::load(other_keys, &[AccessRole::Operator]).expect("keys of an operator");
            session.clone().secured_by(identity)
        })
    });
}
