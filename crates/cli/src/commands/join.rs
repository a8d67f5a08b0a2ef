//! How a command joins a room for a moment.

use std::time::Duration;

use heliostat_bus::{Bus, BusConfig, Reach, Role};
use heliostat_service::output;

/// A process that is there accepts a connection within this time.
const CONNECTED_WITHIN: Duration = Duration::from_millis(1200);

/// Longest wait for the processes that another one reaches.
const ALIVE_WITHIN: Duration = Duration::from_millis(500);

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

/// A client of the process in `--connect` that reaches the most processes: it passes on the messages of those to which
/// it is connected, where peers pass nothing on. Endpoints without a process are named. `None` where no process answers,
/// and where it is no peer without a certificate: the rights of a certificate end at the first process.
pub(super) fn join_through(config: &BusConfig) -> Option<Bus> {
    if config.role == Role::Client || config.identity.is_some() || !config.listen.is_empty() {
        return None;
    }
    let mut widest: Option<(usize, Bus)> = None;
    for endpoint in &config.connect {
        let client = BusConfig { role: Role::Client, connect: vec![endpoint.clone()], ..config.clone() };
        let client = client.reaching(Reach::Within(CONNECTED_WITHIN));
        let joined = Bus::has_listener(&client).then(|| Bus::open(&client).ok()).flatten();
        let Some(bus) = joined else {
            if config.connect.len() > 1 {
                output::note(format_args!("no process of a room answers at {endpoint}"));
            }
            continue;
        };
        let reached = bus.alive(&bus.room().all_alive(), ALIVE_WITHIN).map_or(0, |alive| alive.len());
        if widest.as_ref().is_none_or(|(most, _)| reached > *most) {
            widest = Some((reached, bus));
        }
    }
    widest.map(|(_, bus)| bus)
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
