//! A room of real processes: an array, a controller, and for a driver a board and a tracker.

use std::path::{Path, PathBuf};

use heliostat_bus::{AccessRole, BusConfig, Identity, free_loopback_endpoint, private_endpoint};
use heliostat_proto::{ArrayState, Room};
use heliostat_service::clock::utc_ns;
use tempfile::TempDir;

use crate::faults::attacker::Attacker;
use crate::faults::board::LoopbackBoard;
use crate::faults::effect::Effect;
use crate::faults::proxy::Proxy;
use crate::faults::tracker::Tracker;
use crate::faults::witness::Witness;
use crate::process::{Ended, Process};
use crate::wait::wait_until;

/// Name of every room of the campaign.
const ROOM: &str = "faults";

/// Mirrors of the loopback board.
const BOARD_MIRRORS: usize = 6;

/// What drives the mirrors of the room.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Array {
    /// `heliostat sim-node`, which also reports the users.
    Simulated,
    /// `heliostat driver run` with a [`LoopbackBoard`]; a [`Tracker`] reports the users.
    Board,
}

/// How a process is started.
#[derive(Clone, Debug, Default)]
pub struct Launch {
    /// Program that starts it.
    pub wrapper: Vec<String>,
    /// Variables in its environment.
    pub variables: Vec<(String, String)>,
    /// Further flags.
    pub flags: Vec<String>,
}

impl Launch {
    /// The same with these flags.
    #[must_use]
    pub fn flags(mut self, flags: &[&str]) -> Self {
        self.flags.extend(flags.iter().map(|flag| (*flag).to_owned()));
        self
    }

    fn start(&self, arguments: &[&str]) -> Process {
        let variables: Vec<(&str, &str)> =
            self.variables.iter().map(|(name, value)| (name.as_str(), value.as_str())).collect();
        let flags: Vec<&str> = self.flags.iter().map(String::as_str).collect();
        Process::heliostat_under(
            &self.wrapper,
            &variables,
            &[arguments, &flags, &["--exit-with-parent", "--json"]].concat(),
        )
    }
}

/// A room that is not started yet.
#[derive(Clone, Debug)]
pub struct Setup {
    /// What drives the mirrors.
    pub array: Array,
    /// How the simulator or the driver is started.
    pub of_array: Launch,
    /// How the controller is started.
    pub of_controller: Launch,
    /// The endpoint at which the array listens.
    pub array_endpoint: String,
    /// The endpoint at which the controller connects to the array, if it is another one.
    pub link_endpoint: Option<String>,
    controller_endpoint: String,
    /// The folder of keys of a room with access control.
    keys: Option<PathBuf>,
}

impl Setup {
    /// A room on this machine, with direct links over Unix sockets.
    ///
    /// # Panics
    /// When there is no endpoint.
    pub fn new(array: Array) -> Self {
        let endpoint = || private_endpoint().expect("an endpoint");
        Self {
            array,
            of_array: Launch::default(),
            of_controller: Launch::default(),
            array_endpoint: endpoint(),
            link_endpoint: None,
            controller_endpoint: endpoint(),
            keys: None,
        }
    }

    /// The same with links over TCP, for a fault of the network.
    ///
    /// # Panics
    /// When no port is free.
    #[must_use]
    pub fn over_tcp(mut self) -> Self {
        let endpoint = || free_loopback_endpoint().expect("a free port");
        (self.array_endpoint, self.controller_endpoint) = (endpoint(), endpoint());
        self
    }

    /// With the keys in a folder, which it makes.
    ///
    /// # Panics
    /// When the keys cannot be made.
    #[must_use]
    pub fn secured_by(mut self, keys: &Path) -> Self {
        make_keys(keys);
        let encrypted = || free_loopback_endpoint().expect("a free port").replace("tcp/", "tls/");
        (self.array_endpoint, self.controller_endpoint) = (encrypted(), encrypted());
        let flags = ["--tls", keys.to_str().expect("the path is text")];
        self.of_array = self.of_array.flags(&flags);
        self.of_controller = self.of_controller.flags(&flags);
        self.keys = Some(keys.to_path_buf());
        self
    }

    /// Starts it, and waits until the array follows.
    ///
    /// # Panics
    /// When the array does not follow within the time limit.
    pub fn start(self) -> FaultRoom {
        FaultRoom::start(self, None)
    }

    /// Starts it with a proxy between array and controller.
    ///
    /// # Panics
    /// As for [`Setup::start`].
    pub fn start_with_proxy(self) -> FaultRoom {
        let mut setup = self.over_tcp();
        let proxy = Proxy::start(&setup.array_endpoint);
        setup.link_endpoint = Some(proxy.endpoint().to_owned());
        FaultRoom::start(setup, Some(proxy))
    }

    /// A session with direct links to array and controller, and the rights of a viewer.
    ///
    /// # Panics
    /// When the keys of the room cannot be used.
    pub fn session(&self) -> BusConfig {
        let room = Room::new(ROOM).expect("the name is valid");
        let config = BusConfig::new(room).connect_to(&self.array_endpoint).connect_to(&self.controller_endpoint);
        match &self.keys {
            Some(keys) => config.secured_by(Identity::load(keys, &[AccessRole::Viewer]).expect("keys of a viewer")),
            None => config,
        }
    }
}

/// A running room.
pub struct FaultRoom {
    /// The simulator or the driver.
    pub array: Process,
    /// The controller.
    pub controller: Process,
    /// Records telemetry and status.
    pub witness: Witness,
    setup: Setup,
    proxy: Option<Proxy>,
    board: Option<LoopbackBoard>,
    _tracker: Option<Tracker>,
    folder: TempDir,
}

impl FaultRoom {
    fn start(setup: Setup, proxy: Option<Proxy>) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let board = (setup.array == Array::Board).then(|| {
            let board = LoopbackBoard::start(BOARD_MIRRORS);
            std::fs::write(folder.path().join("array.toml"), board.configuration()).expect("a file can be written");
            board
        });
        let (array, controller) = (start_array(&setup, &folder), start_controller(&setup));
        let witness = Witness::connect(&setup.session());
        let _tracker = board.is_some().then(|| Tracker::start(&setup.session()));
        let room = Self { array, controller, witness, setup, proxy, board, _tracker, folder };
        room.witness.wait_until_steady();
        room
    }

    /// Lets a fault happen and waits until the array follows again; returns the effect.
    ///
    /// The fault lasts as long as the call of `fault`, which also ends it.
    ///
    /// # Panics
    /// When the array does not follow again within the time limit.
    pub fn undergo(&mut self, fault: impl FnOnce(&mut Self)) -> Effect {
        self.witness.wait_until_steady();
        wait_until("the status of array and controller", || self.witness.statuses() >= 2);
        let (counted, begin_ns) = (self.witness.notable_counters(), utc_ns());
        fault(self);
        self.witness.effect_since(&counted, begin_ns)
    }

    /// Starts the controller again, after it ended or was killed.
    pub fn restart_controller(&mut self) {
        self.controller = start_controller(&self.setup);
    }

    /// Starts the array again, after it ended or was killed.
    pub fn restart_array(&mut self) {
        self.array = start_array(&self.setup, &self.folder);
    }

    /// Ends the controller in order (SIGTERM).
    pub fn end_controller(&mut self) -> Ended {
        end(&mut self.controller)
    }

    /// How the processes are started, for the next start.
    pub fn setup_mut(&mut self) -> &mut Setup {
        &mut self.setup
    }

    /// Another process of `heliostat`, with links to array and controller.
    pub fn start_process(&self, launch: &Launch, arguments: &[&str]) -> Process {
        let links =
            ["--room", ROOM, "--connect", &self.setup.array_endpoint, "--connect", &self.setup.controller_endpoint];
        Process::heliostat_under(&launch.wrapper, &[], &[arguments, &links].concat())
    }

    /// A publisher that is no part of the room, connected to array and controller.
    pub fn attacker(&self) -> Attacker {
        Attacker::join(&self.setup.session())
    }

    /// A folder for files of the room.
    pub fn folder(&self) -> PathBuf {
        self.folder.path().to_path_buf()
    }

    /// The proxy between array and controller.
    ///
    /// # Panics
    /// When the room was started without one.
    pub fn proxy(&self) -> &Proxy {
        self.proxy.as_ref().expect("the room has a proxy")
    }

    /// The board of a driver.
    ///
    /// # Panics
    /// When the array is simulated; the same holds for the tracker.
    pub fn board(&self) -> &LoopbackBoard {
        self.board.as_ref().expect("the room has a board")
    }

    /// Waits until telemetry has this state.
    ///
    /// # Panics
    /// When it has not within the time limit.
    pub fn wait_for_state(&self, state: ArrayState) {
        wait_until(&format!("telemetry with state {}", state.name()), || self.witness.state() == Some(state));
    }
}

fn start_array(setup: &Setup, folder: &TempDir) -> Process {
    let listen = ["--room", ROOM, "--listen", &setup.array_endpoint];
    match setup.array {
        Array::Simulated => {
            // As often as the reports, so that each accepted command is seen; and the references
            // seldom, because they cost much time.
            let rates = ["--set", "streams.telemetry.rate_hz=100", "--set", "streams.truth.rate_hz=0.1"];
            setup.of_array.start(&[&["sim-node"], &listen[..], &rates].concat())
        }
        Array::Board => {
            let path = |name: &str| folder.path().join(name).display().to_string();
            let (config, state) = (path("array.toml"), path("state"));
            let driver = ["driver", "run", "--config", &config, "--state", &state, "--start-armed"];
            setup.of_array.start(&[&driver, &listen[..]].concat())
        }
    }
}

/// Makes the keys of the room in a folder.
///
/// # Panics
/// When they cannot be made.
pub fn make_keys(folder: &Path) {
    let folder = folder.to_str().expect("the path is text");
    let made = Process::heliostat(&["keys", "init", "--room", ROOM, "--out", folder]).wait();
    assert!(made.status.success(), "{}", made.errors);
}

fn start_controller(setup: &Setup) -> Process {
    let link = setup.link_endpoint.as_ref().unwrap_or(&setup.array_endpoint);
    let flags = [
        "controller",
        "--policy",
        "nearest",
        "--room",
        ROOM,
        "--connect",
        link,
        "--listen",
        &setup.controller_endpoint,
    ];
    let columns = format!("mirrors.columns={}", BOARD_MIRRORS / 2);
    let size = match setup.array {
        Array::Simulated => vec![],
        Array::Board => vec!["--set", "mirrors.rows=2", "--set", &columns],
    };
    setup.of_controller.start(&[&flags[..], &size].concat())
}

fn end(process: &mut Process) -> Ended {
    process.signal("TERM");
    process.wait_mut()
}
