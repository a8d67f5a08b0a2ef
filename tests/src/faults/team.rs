//! An array and several controllers, each on a host of its own on one network.

use heliostat_bus::{BusConfig, Reach};
use heliostat_proto::{ArrayState, Nanos, Room};
use heliostat_service::clock::utc_ns;

use crate::faults::effect::Effect;
use crate::faults::namespace::Segment;
use crate::faults::witness::Witness;
use crate::process::Process;
use crate::wait::wait_until;

const ROOM: &str = "faults";

/// Each host has addresses of its own.
const PORT: u16 = 7447;

/// What a fault of one controller did to the array.
#[derive(Clone, Debug, PartialEq)]
pub struct Succession {
    /// Longest time between two accepted commands, in report intervals.
    pub gap: f64,
    /// Commands that the array would have accepted without the fault, less those accepted.
    pub lost: u64,
    /// Changes of the epoch that the array follows, until all controllers are back.
    pub changes: usize,
    /// Whether the array parked.
    pub has_parked: bool,
}

/// An array on this host, and controllers on other ones.
pub struct Team {
    witness: Witness,
    controllers: Vec<Process>,
    /// When each was started.
    started_ns: Vec<Nanos>,
    interval_ns: Nanos,
    /// The setting of the rate of the reports, which array and controllers share.
    rate: String,
    _array: Process,
    // Namespaces end after the processes in them.
    segment: Segment,
}

impl Team {
    /// Starts everything.
    ///
    /// # Panics
    /// When the network cannot be made.
    pub fn start(controllers: usize, reports_per_s: u64) -> Self {
        let segment = Segment::create(controllers);
        let endpoint = format!("tcp/{}:{PORT}", segment.own_address());
        let rate = format!("streams.positions.rate_hz={reports_per_s}");
        let rates = ["--set", &rate, "--set", "streams.telemetry.rate_hz=100", "--set", "streams.truth.rate_hz=0.1"];
        let array = ["sim-node", "--room", ROOM, "--listen", &endpoint];
        let _array =
            Process::heliostat(&[&array[..], &rates, &["--insecure", "--exit-with-parent", "--json"]].concat());
        let room = Room::new(ROOM).expect("the name is valid");
        // Peers do not forward the statuses of the controllers.
        let endpoints = (0..controllers).map(|host| format!("tcp/{}:{PORT}", segment.address(host)));
        let config = BusConfig::new(room).connect_to(&endpoint).reaching(Reach::Eventually);
        let config = endpoints.fold(config, |config, endpoint| config.connect_to(&endpoint));
        let mut team = Self {
            witness: Witness::connect(&config),
            controllers: Vec::new(),
            started_ns: vec![0; controllers],
            interval_ns: 1_000_000_000 / reports_per_s,
            rate,
            _array,
            segment,
        };
        for index in 0..controllers {
            team.started_ns[index] = utc_ns();
            let controller = team.start_controller(index);
            team.controllers.push(controller);
            // The start of the next one tells their statuses apart.
            wait_until("the status of a controller", || team.witness.controllers().len() > index);
        }
        team
    }

    /// Waits until one controller leads and all others stand by: its index, and that of one of the others.
    ///
    /// # Panics
    /// When that does not happen within the time limit.
    pub fn settle(&self) -> [usize; 2] {
        let leader = self.witness.wait_for_leader(&self.started_ns);
        [leader, usize::from(leader == 0)]
    }

    /// Lets a fault happen, waits until all controllers are back, and returns its effect.
    ///
    /// # Panics
    /// When they are not within the time limit.
    pub fn undergo(&mut self, fault: impl FnOnce(&mut Self)) -> Succession {
        let begin_ns = utc_ns();
        fault(self);
        self.settle();
        let end_ns = utc_ns();
        wait_until("a command after the fault", || {
            self.witness.samples().last().is_some_and(|sample| sample.accepted_ns > end_ns)
        });
        let samples = self.witness.samples();
        let effect = Effect::between(&samples, begin_ns, end_ns, self.interval_ns);
        let first = samples.partition_point(|sample| sample.seen_ns < begin_ns).saturating_sub(1);
        let changes = samples[first..].windows(2).filter(|pair| pair[0].epoch != pair[1].epoch).count();
        Succession {
            gap: effect.gap_ms * 1e6 / self.interval_ns as f64,
            lost: effect.lost,
            changes,
            has_parked: effect.states.contains(&ArrayState::Parked),
        }
    }

    /// A controller.
    pub fn controller(&mut self, index: usize) -> &mut Process {
        &mut self.controllers[index]
    }

    /// Starts a controller again, after it ended or was killed.
    pub fn restart(&mut self, index: usize) {
        self.started_ns[index] = utc_ns();
        self.controllers[index] = self.start_controller(index);
    }

    /// The network of the hosts; each controller has the host of its index.
    pub fn segment(&self) -> &Segment {
        &self.segment
    }

    fn start_controller(&self, index: usize) -> Process {
        let endpoint = |address: String| format!("tcp/{address}:{PORT}");
        let own = endpoint(self.segment.address(index));
        let others = (0..self.started_ns.len()).filter(|host| *host != index);
        let others = others.map(|host| self.segment.address(host)).chain([self.segment.own_address()]);
        let others: Vec<String> = others.map(endpoint).collect();
        let links = others.iter().flat_map(|other| ["--connect", other.as_str()]);
        let start = ["controller", "--policy", "nearest", "--room", ROOM, "--set", &self.rate, "--listen", &own];
        let arguments: Vec<&str> = start.into_iter().chain(links).collect();
        Process::heliostat_under(
            &self.segment.wrapper(index),
            &[],
            &[&arguments[..], &["--insecure", "--exit-with-parent", "--json"]].concat(),
        )
    }
}
