//! Two hosts with a Zenoh router each, and two rooms whose standby controllers are on the other host.
//!
//! The hosts are network namespaces with addresses of their own. All processes are clients of the
//! router of their host, with the keys of their room. The routers are linked by the cable between the
//! hosts. A further link to each host stays up, for the witness.

use std::path::{Path, PathBuf};

use heliostat_bus::{AccessRole, BusConfig, Identity, Reach, Role};
use heliostat_service::clock::utc_ns;
use tempfile::TempDir;

use crate::containers::zenohd;
use crate::faults::effect::Effect;
use crate::faults::namespace::{Cable, Link};
use crate::faults::witness::Witness;
use crate::process::{Ended, Process};

/// The rooms: array and leader of the first are on host A, those of the second on host B.
const ROOMS: [&str; 2] = ["studio", "foyer"];

/// Port of the first room at each router; the second has the next one.
const PORT: u16 = 7448;

/// One of the two hosts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Host {
    /// The host of the array and of the leader of the measured room.
    A,
    /// The host of its standby.
    B,
}

/// The processes of a room.
struct RoomProcesses {
    array: Process,
    leader: Process,
    standby: Process,
}

/// Two hosts, two routers and two rooms. The witness records the first room.
pub struct Building {
    /// Records the room of host A.
    pub witness: Witness,
    /// The link between the hosts.
    pub cable: Cable,
    rooms: Vec<RoomProcesses>,
    /// When the controllers of the first room were started, in ns.
    started_ns: [u64; 2],
    routers: Vec<Process>,
    zenohd: PathBuf,
    folder: TempDir,
    // Namespaces end after the processes in them.
    hosts: [Link; 2],
}

impl Building {
    /// Starts everything, and waits until the array follows and a standby stands by.
    ///
    /// # Panics
    /// When the array does not follow within the time limit.
    pub fn start() -> Self {
        let zenohd = zenohd();
        let hosts = [Link::create(), Link::create()];
        let cable = Cable::between(&hosts[0], &hosts[1]);
        let folder = tempfile::tempdir().expect("a folder");
        make_keys(folder.path(), &hosts, &cable);
        let routers = [0, 1].map(|host| start_router(&zenohd, folder.path(), &hosts[host], host)).into();
        let start = |room: usize, kind: Kind| start_process(folder.path(), &hosts, room, kind);
        let keys = folder.path().join(ROOMS[0]);
        let identity = Identity::load(&keys, &[AccessRole::Viewer]).expect("keys of a viewer");
        let config = BusConfig::new(identity.room().clone()).secured_by(identity);
        let config = config.connect_to(&format!("tls/{}:{PORT}", hosts[0].witness_address()));
        let config = BusConfig { role: Role::Client, ..config.reaching(Reach::Eventually) };
        let witness = Witness::connect(&config);
        let mut started_ns = [0; 2];
        let rooms = [0, 1].map(|room| {
            let (array, leader_ns) = (start(room, Kind::Array), utc_ns());
            let leader = start(room, Kind::Leader);
            if room == 0 {
                // The start of the second controller tells their statuses apart.
                witness.wait_until_steady();
                started_ns = [leader_ns, utc_ns()];
            }
            RoomProcesses { array, leader, standby: start(room, Kind::Standby) }
        });
        let mut building = Self { witness, cable, rooms: rooms.into(), started_ns, routers, zenohd, folder, hosts };
        building.settle(Host::A);
        building
    }

    /// Lets a fault happen, and waits until the array of the first room follows again. Before the fault
    /// the controller of the host is in charge, and that of the other one stands by.
    ///
    /// # Panics
    /// When it does not follow again within the time limit.
    pub fn undergo(&mut self, leader: Host, fault: impl FnOnce(&mut Self)) -> Effect {
        self.settle(leader);
        let (counted, begin_ns) = (self.witness.notable_counters(), utc_ns());
        fault(self);
        self.witness.effect_since(&counted, begin_ns)
    }

    /// Waits until the array follows, the controller of this host is in charge, and the other one stands
    /// by. On a busy machine a standby may have taken over: the controller that is wrongly in charge is
    /// then started again.
    ///
    /// # Panics
    /// When that does not happen within the time limit.
    pub fn settle(&mut self, leader: Host) {
        for _ in 0..20 {
            self.witness.wait_until_steady();
            let found = self.witness.wait_for_leader(&self.started_ns);
            if found == leader as usize {
                return;
            }
            self.controller(found).kill();
            self.witness.wait_until_steady();
            self.restart_controller(if found == 0 { Host::A } else { Host::B });
        }
        panic!("the controller of host {leader:?} does not stay in charge");
    }

    /// Waits until the controller of a host stands by.
    ///
    /// # Panics
    /// When it does not within the time limit.
    pub fn wait_for_standby(&self, host: Host) {
        self.witness.wait_for_standby(&self.started_ns, host as usize);
    }

    fn controller(&mut self, host: usize) -> &mut Process {
        let room = &mut self.rooms[0];
        if host == 0 { &mut room.leader } else { &mut room.standby }
    }

    /// The array of the first room.
    pub fn array(&mut self) -> &mut Process {
        &mut self.rooms[0].array
    }

    /// The controller on host A.
    pub fn leader(&mut self) -> &mut Process {
        &mut self.rooms[0].leader
    }

    /// The controller on host B.
    pub fn standby(&mut self) -> &mut Process {
        &mut self.rooms[0].standby
    }

    /// The router of a host.
    pub fn router(&mut self, host: Host) -> &mut Process {
        &mut self.routers[host as usize]
    }

    /// Starts the router of a host again, after it was killed.
    pub fn restart_router(&mut self, host: Host) {
        let index = host as usize;
        self.routers[index] = start_router(&self.zenohd, self.folder.path(), &self.hosts[index], index);
    }

    /// Starts the array of the first room again, after it was killed.
    pub fn restart_array(&mut self) {
        self.rooms[0].array = start_process(self.folder.path(), &self.hosts, 0, Kind::Array);
    }

    /// Starts the controller of the first room on a host again, after it was killed.
    pub fn restart_controller(&mut self, host: Host) {
        let kind = if host == Host::A { Kind::Leader } else { Kind::Standby };
        self.started_ns[host as usize] = utc_ns();
        *self.controller(host as usize) = start_process(self.folder.path(), &self.hosts, 0, kind);
    }

    /// Runs an operator's command for a room on a host, until it ends.
    pub fn operate(&self, host: Host, room: usize, command: &[&str]) -> Ended {
        let keys = self.folder.path().join(ROOMS[room]).display().to_string();
        let router = router_endpoint(room);
        let shared = ["--client", "--connect", &router, "--tls", &keys];
        Process::heliostat_under(&self.hosts[host as usize].wrapper(), &[], &[command, &shared].concat()).wait()
    }

    /// Kills all processes of host B.
    pub fn kill_host_b(&mut self) {
        self.routers[1].kill();
        self.rooms[0].standby.kill();
        self.rooms[1].array.kill();
        self.rooms[1].leader.kill();
    }

    /// Starts them again.
    pub fn restart_host_b(&mut self) {
        self.restart_router(Host::B);
        self.restart_controller(Host::B);
        self.rooms[1].array = start_process(self.folder.path(), &self.hosts, 1, Kind::Array);
        self.rooms[1].leader = start_process(self.folder.path(), &self.hosts, 1, Kind::Leader);
    }
}

/// A process of a room.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Array,
    Leader,
    Standby,
}

/// Makes the keys of both rooms and the folders of both routers, by the commands of docs/deploy.md.
fn make_keys(folder: &Path, hosts: &[Link; 2], cable: &Cable) {
    let path = |name: &str| folder.join(name).display().to_string();
    let addresses = [cable.address(0), cable.address(1), hosts[0].witness_address(), hosts[1].witness_address()];
    let of_hosts: Vec<&str> = addresses.iter().flat_map(|address| ["--host", address.as_str()]).collect();
    let run = |arguments: &[&str]| {
        let ended = Process::heliostat(arguments).wait();
        assert!(ended.status.success(), "{arguments:?}: {}", ended.errors);
    };
    for room in ROOMS {
        run(&[&["keys", "init", "--room", room, "--out", &path(room)], &of_hosts[..]].concat());
    }
    let [studio, foyer] = ROOMS.map(path);
    let port = PORT.to_string();
    let router = ["keys", "router", "--dir", &studio, "--dir", &foyer, "--port", &port, "--out"];
    run(&[&router[..], &[&path("router-0")]].concat());
    let peer = format!("{}:{PORT}", cable.address(0));
    run(&[&router[..], &[&path("router-1"), "--peer", &peer]].concat());
}

fn start_router(zenohd: &Path, folder: &Path, host: &Link, index: usize) -> Process {
    let config = folder.join(format!("router-{index}/router.json5")).display().to_string();
    Process::foreign(&host.wrapper(), zenohd, &["--config", &config])
}

/// The endpoint of a room at the router of each host.
fn router_endpoint(room: usize) -> String {
    format!("tls/127.0.0.1:{}", PORT + u16::try_from(room).expect("two rooms"))
}

fn start_process(folder: &Path, hosts: &[Link; 2], room: usize, kind: Kind) -> Process {
    // The standby is on the other host.
    let host = if kind == Kind::Standby { 1 - room } else { room };
    let keys = folder.join(ROOMS[room]).display().to_string();
    let router = router_endpoint(room);
    let state = folder.join(format!("state-{room}")).display().to_string();
    let own = match kind {
        // Telemetry as often as the reports, so that each accepted command is seen.
        Kind::Array => vec![
            "sim-node",
            "--set",
            "streams.telemetry.rate_hz=100",
            "--set",
            "streams.truth.rate_hz=0.1",
            "--state",
            &state,
            "--start-armed",
        ],
        Kind::Leader => vec!["controller", "--policy", "nearest"],
        Kind::Standby => vec!["controller", "--policy", "nearest", "--standby"],
    };
    let shared = ["--client", "--connect", &router, "--tls", &keys, "--exit-with-parent", "--json"];
    Process::heliostat_under(&hosts[host].wrapper(), &[], &[&own[..], &shared].concat())
}
