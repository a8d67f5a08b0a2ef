//! How a command joins a room for a moment.

use std::time::Duration;

use heliostat_bus::{Bus, BusConfig, Reach, Role};
use heliostat_service::output;

/// A process that is there accepts a connection within this time.
const CONNECTED_WITHIN: Duration = Duration::from_millis(1200);

/// Joins a room; fails with the reason where there is no connection.
pub(super) fn join(config: &BusConfig, limit: Duration) -> Result<Bus, String> {
    if let Some(bus) = join_through(config) {
        return Ok(bus);
    }
    let bus = Bus::open(config).map_err(|error| error.to_string())?;
    if config.listen.is_empty() {
        check_connected(&bus, config, limit)?;
    }
    Ok(bus)
}

/// A client of the only process in `--connect`, which passes on the messages of those to which it is connected:
/// peers pass nothing on. `None` with several endpoints, and where that process does not answer.
pub(super) fn join_through(config: &BusConfig) -> Option<Bus> {
    let is_alone = config.listen.is_empty() && config.connect.len() == 1;
    let client = BusConfig { role: Role::Client, ..config.clone() }.reaching(Reach::Within(CONNECTED_WITHIN));
    (is_alone && Bus::has_listener(config)).then(|| Bus::open(&client).ok()).flatten()
}

/// The reason why there is no connection: soon where no process listens, and after the limit where one
/// accepts connections, for it may be slow.
pub(super) fn check_connected(bus: &Bus, config: &BusConfig, limit: Duration) -> Result<(), String> {
    if bus.wait_connected(CONNECTED_WITHIN) {
        return Ok(());
    }
    let endpoints = config.connect.join(", ");
    Err(match Bus::find_connection_problem(config) {
        Some(problem) => problem,
        None if Bus::has_listener(config) => {
            output::note(format_args!("the process at {endpoints} accepts connections and has not answered yet"));
            if bus.wait_connected(limit) {
                return Ok(());
            }
            format!("the process at {endpoints} does not answer as a process of a room")
        }
        None => format!("no process answers at {endpoints}"),
    })
}
