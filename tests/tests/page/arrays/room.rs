//! A room with two arrays: its scenario, an observer of both, and drivers with simulated mirrors.

use std::path::{Path, PathBuf};

use heliostat_array::Kit;
use heliostat_bus::{Bus, BusConfig};
use heliostat_driver::run::{self, Settings};
use heliostat_driver::stop_record::StopRecordSettings;
use heliostat_proto::{ArrayState, MirrorCommand, MirrorTelemetry, NodeKind, NodeStatus, Room};
use heliostat_room::mirrors::SimulatedMirrors;
use heliostat_scenario::Scenario;
use heliostat_service::Stop;
use heliostat_tests::{Latest, TWO_ARRAYS};

pub fn scenario_file(folder: &Path) -> String {
    let file = folder.join("two.toml");
    std::fs::write(&file, TWO_ARRAYS).expect("a writable folder");
    file.to_str().expect("a path in UTF-8").to_owned()
}

/// What the processes of a room with two arrays publish.
pub struct Observer {
    pub bus: Bus,
    pub commands: [Latest<MirrorCommand>; 2],
    pub telemetry: [Latest<MirrorTelemetry>; 2],
    pub drivers: [Latest<NodeStatus>; 2],
    pub controller: Latest<NodeStatus>,
}

impl Observer {
    pub fn join(room: &str, endpoints: &[&str]) -> Self {
        let config = BusConfig::new(Room::new(room).expect("a valid name"));
        let config = endpoints.iter().fold(config, |config, endpoint| config.connect_to(endpoint));
        let bus = Bus::open(&config).expect("the bus opens");
        let keys = [0, 1].map(|array| bus.room().array(array));
        Self {
            commands: keys.each_ref().map(|keys| Latest::of(&bus, &keys.command())),
            telemetry: keys.each_ref().map(|keys| Latest::of(&bus, &keys.telemetry())),
            drivers: keys.each_ref().map(|keys| Latest::of(&bus, &keys.driver_status())),
            controller: Latest::of(&bus, &bus.room().status(NodeKind::Controller)),
            bus,
        }
    }

    /// The states of the arrays whose telemetry has arrived.
    pub fn states(&self) -> Vec<ArrayState> {
        self.telemetry.iter().filter_map(|telemetry| telemetry.get().map(|telemetry| telemetry.state)).collect()
    }

    /// A counter of the controller; 0 where it is absent.
    pub fn controller_counter(&self, name: &str) -> u64 {
        self.controller.get().and_then(|status| status.counter(name)).unwrap_or(0)
    }

    /// Commands so far to an array.
    pub fn commands(&self, array: usize) -> u64 {
        self.commands[array].counted().0
    }
}

/// Drives one of two arrays until `stop`, with simulated mirrors in place of hardware.
pub fn drive(array: usize, config: BusConfig, folder: PathBuf, stop: &Stop) -> Result<u64, String> {
    let scenario = Scenario::from_toml(TWO_ARRAYS).expect("valid");
    let model = scenario.channel_model().expect("a model");
    let mirrors = SimulatedMirrors::new(&scenario.actuator, &model.mirrors.arrays()[array], 1, array as u32);
    let record = StopRecordSettings { directory: Some(folder), start_armed: true };
    let settings = Settings { record, array, ..Settings::new(config) };
    run::run(Kit::new(mirrors), &settings, stop).map(|summary| summary.commands).map_err(|error| error.to_string())
}

/// Requests stops when dropped, so that every thread ends where a check fails.
pub struct RequestAtEnd(pub Vec<Stop>);

impl Drop for RequestAtEnd {
    fn drop(&mut self) {
        self.0.iter().for_each(Stop::request);
    }
}
