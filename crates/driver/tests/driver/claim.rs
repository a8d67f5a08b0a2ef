//! One process for each array: two drivers that start together.

use std::sync::{Arc, Mutex};

use heliostat_bus::{Bus, BusConfig, private_endpoint};
use heliostat_driver::Kit;
use heliostat_driver::claim::Claim;
use heliostat_driver::config::Config;
use heliostat_driver::run::{self, Settings};
use heliostat_proto::{NodeStatus, Room, decode};
use heliostat_service::Stop;

use crate::stops::RequestAtEnd;
use crate::{LIMIT, wait_until};

/// One board at which nothing answers: the driver tries again.
const BOARD: &str = "rows = 1\ncolumns = 1\n[[boards]]\nkind = \"servo-board\"\naddress = \"tcp:127.0.0.1:1\"\n\
                     min_deg = -30.0\nmax_deg = 30.0\nmirrors = [0]\n";

/// Whether each of two claims that begin together, of the sources 7 and 9, is given up; `None` where one took the
/// other for late, as on a machine that stood still.
fn given_up_claims(config: &BusConfig, endpoint: &str) -> Option<[bool; 2]> {
    let configs = [config.clone().listen_at(endpoint), config.clone().connect_to(endpoint)];
    let buses = configs.map(|one| Bus::open(&one).unwrap());
    assert!(buses.iter().all(|bus| bus.wait_connected(LIMIT)));
    let both = [(&buses[0], 7), (&buses[1], 9)];
    let mut claims = both.map(|(bus, source)| (Claim::begin(bus, 0..1, source).expect("no token yet"), false));
    // The second one may have received the token of the first by now, or receives it later.
    for ((bus, source), (claim, is_given_up)) in both.into_iter().zip(&mut claims) {
        *is_given_up = claim.announce(bus, &bus.room().array(0).driver_alive(source)).is_err();
    }
    let mut is_late = false;
    wait_until("the end of one", || {
        for (claim, is_given_up) in &mut claims {
            *is_given_up |= claim.check(|_| is_late = true).is_err();
        }
        is_late || claims.iter().any(|(_, is_given_up)| *is_given_up)
    });
    let refusal = Claim::begin(&buses[1], 0..1, 8).err().expect("the tokens of both").to_string();
    assert!(refusal.contains("another driver is in room \"claims\""), "{refusal}");
    (!is_late).then(|| claims.map(|(_, is_given_up)| is_given_up))
}

#[test]
fn of_two_claims_that_begin_together_the_one_with_the_higher_source_id_is_given_up() {
    let config = BusConfig::new(Room::new("claims").unwrap());
    let given_up = (0..10).find_map(|_| given_up_claims(&config, &private_endpoint().unwrap()));
    assert_eq!(given_up, Some([false, true]));
}

/// Runs a driver and announces another one of the lowest source id after it; returns the driver's error, or `None`
/// where it took the other one for late, as on a machine that stood still.
fn driver_beside_another(config: &BusConfig, endpoint: &str) -> Option<String> {
    let (stop, is_late) = (Stop::default(), Arc::new(Mutex::new(false)));
    let kit = Kit::new(heliostat_files::from_toml::<Config>(BOARD).unwrap().wall().unwrap());
    let settings = Settings::new(config.clone().listen_at(endpoint));
    let observer = Bus::open(&config.clone().connect_to(endpoint)).unwrap();
    let keys = observer.room().array(0);
    let noted = Arc::clone(&is_late);
    let _statuses = observer.subscribe(&keys.driver_status(), move |payload| {
        let status: NodeStatus = decode(payload).unwrap();
        let is_counted = status.counters.contains(&(NodeStatus::OTHER_PROCESSES.to_owned(), 1));
        *noted.lock().unwrap() |= is_counted && status.last_problem.contains("another driver has joined the room");
    });
    std::thread::scope(|scope| {
        let driver = scope.spawn(|| run::run(kit, &settings, &stop));
        let _end = RequestAtEnd(&stop);
        wait_until("the driver's token", || !observer.alive(&keys.drivers_alive(), LIMIT).unwrap().is_empty());
        let _other = observer.announce(&keys.driver_alive(0)).unwrap();
        wait_until("an answer to the other token", || driver.is_finished() || *is_late.lock().unwrap());
        stop.request();
        driver.join().unwrap().err().map(|error| error.to_string())
    })
}

#[test]
fn a_driver_ends_for_one_with_a_lower_source_id_that_starts_with_it() {
    let config = BusConfig::new(Room::new("together").unwrap());
    let refusal = (0..10).find_map(|_| driver_beside_another(&config, &private_endpoint().unwrap()));
    let refusal = refusal.expect("the driver ends");
    let expected = ["another driver is in room \"together\"", "alive/driver/0000000000000000"];
    assert!(expected.iter().all(|part| refusal.contains(part)), "{refusal}");
}
