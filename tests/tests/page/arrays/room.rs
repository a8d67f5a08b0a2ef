//! A room with two arrays: its scenario, an observer of both, and drivers with simulated mirrors.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use heliostat_array::Kit;
use heliostat_bus::{Bus, BusConfig, Subscription};
use heliostat_driver::run::{self, Settings};
use heliostat_driver::stop_record::StopRecordSettings;
use heliostat_proto::{
    ArrayState, MirrorCommand, MirrorTelemetry, NodeStatus, Room, Stamp, UserReport, UserState, decode,
};
use heliostat_room::mirrors::SimulatedMirrors;
use heliostat_scenario::Scenario;
use heliostat_service::Stop;
use heliostat_service::clock::utc_ns;
use heliostat_tests::encoded;

/// Six mirrors on one wall, then eight on another.
pub const TWO: &str =
    "name = \"two\"\n[[mirrors]]\nrows = 2\ncolumns = 3\n[[mirrors]]\nrows = 2\ncolumns = 4\nwall = \"-x\"\n";

pub fn scenario_file(folder: &Path) -> String {
    let file = folder.join("two.toml");
    std::fs::write(&file, TWO).expect("a writable folder");
    file.to_str().expect("a path in UTF-8").to_owned()
}

/// The latest command and telemetry of each array, how many commands there were, and the latest status
/// of each process.
#[derive(Clone, Debug, Default)]
pub struct Latest {
    /// By the last part of their keys.
    pub statuses: BTreeMap<String, NodeStatus>,
    pub commands: BTreeMap<usize, (u64, MirrorCommand)>,
    pub telemetry: BTreeMap<usize, MirrorTelemetry>,
}

pub struct Observer {
    pub bus: Bus,
    latest: Arc<Mutex<Latest>>,
    _subscriptions: Vec<Subscription>,
}

impl Observer {
    pub fn join(room: &str, endpoints: &[&str]) -> Self {
        let config = BusConfig::new(Room::new(room).expect("a valid name"));
        let config = endpoints.iter().fold(config, |config, endpoint| config.connect_to(endpoint));
        let bus = Bus::open(&config).expect("the bus opens");
        let latest: Arc<Mutex<Latest>> = Arc::default();
        let mut subscriptions = Vec::new();
        for array in [0, 1] {
            let keys = bus.room().array(array);
            let kept = Arc::clone(&latest);
            subscriptions.push(bus.subscribe(&keys.command(), move |payload| {
                let mut latest = kept.lock().expect("no callback panics");
                let count = latest.commands.get(&array).map_or(0, |(count, _)| *count);
                latest.commands.insert(array, (count + 1, decode(payload).expect("a sound command")));
            }));
            let kept = Arc::clone(&latest);
            subscriptions.push(bus.subscribe(&keys.telemetry(), move |payload| {
                let telemetry = decode(payload).expect("sound telemetry");
                kept.lock().expect("no callback panics").telemetry.insert(array, telemetry);
            }));
        }
        let kept = Arc::clone(&latest);
        subscriptions.push(bus.subscribe_keyed(&bus.room().all_status(), move |key, payload| {
            let name = key.rsplit_once('/').expect("a key has parts").1.to_owned();
            kept.lock().expect("no callback panics").statuses.insert(name, decode(payload).expect("a sound status"));
        }));
        let subscriptions = subscriptions.into_iter().collect::<Result<_, _>>().expect("valid keys");
        Self { bus, latest, _subscriptions: subscriptions }
    }

    pub fn latest(&self) -> Latest {
        self.latest.lock().expect("no callback panics").clone()
    }

    pub fn states(&self) -> Vec<ArrayState> {
        self.latest().telemetry.values().map(|telemetry| telemetry.state).collect()
    }

    /// A counter of the controller; 0 where it is absent.
    pub fn controller_counter(&self, name: &str) -> u64 {
        let latest = self.latest();
        let counters = latest.statuses.get("controller").map_or(&[][..], |status| &status.counters);
        counters.iter().find(|(counter, _)| counter == name).map_or(0, |(_, count)| *count)
    }

    /// Commands so far to an array.
    pub fn commands(&self, array: usize) -> u64 {
        self.latest().commands.get(&array).map_or(0, |(count, _)| *count)
    }
}

/// Drives one of two arrays until `stop`, with simulated mirrors in place of hardware.
pub fn drive(array: usize, config: BusConfig, folder: PathBuf, stop: &Stop) -> Result<u64, String> {
    let scenario = Scenario::from_toml(TWO).expect("valid");
    let model = scenario.channel_model().expect("a model");
    let mirrors = SimulatedMirrors::new(&scenario.actuator, &model.mirrors.arrays()[array], 1, array as u32);
    let record = StopRecordSettings { directory: Some(folder), start_armed: true };
    let settings = Settings { record, array, ..Settings::new(config) };
    run::run(Kit::new(mirrors), &settings, stop).map(|summary| summary.commands).map_err(|error| error.to_string())
}

/// Users at rest, as a tracker would report them.
pub fn report(tick: u64) -> Vec<u8> {
    let at = |user: u32| [user as f32 - 2.0, 0.5 * user as f32 - 1.0, 0.85];
    let user = |user: u32| UserState { user, position_m: at(user), velocity_m_s: [0.0; 2], min_rate_bps: 1e6 };
    let stamp = Stamp { source: 7, sequence: tick, time_ns: utc_ns() };
    encoded(&UserReport { stamp, tick, users: (0..5).map(user).collect() })
}

/// Requests stops when dropped, so that every thread ends where a check fails.
pub struct RequestAtEnd(pub Vec<Stop>);

impl Drop for RequestAtEnd {
    fn drop(&mut self) {
        self.0.iter().for_each(Stop::request);
    }
}
