//! The end of an emergency stop, by its name: `heliostat driver rearm`.

use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use heliostat_array::latch::LatchedStop;
use heliostat_bus::{Bus, BusConfig, Class};
use heliostat_proto::{NodeKind, Rearm, Room, SafetyReport, Stamp, decode, encode};
use heliostat_service::{clock::utc_ns, source_id};

/// Timeout of an answer of the driver.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(5);

/// Time between two queries to the driver.
const QUERY_INTERVAL: Duration = Duration::from_millis(50);

/// Why an array starts stopped, and how it is released.
pub fn advice(room: &Room, stop: &LatchedStop) -> String {
    // Escaped: both texts can come from any process of the room.
    let [operator, reason] = [&stop.operator, &stop.reason].map(|text| text.escape_debug().to_string());
    let by = if operator.is_empty() { operator } else { format!(" by {operator}") };
    format!(
        "the array starts stopped{by}: {reason}. When its mirrors may move, re-arm it: \
         heliostat driver rearm --room {room}, with an endpoint of this driver"
    )
}

/// Releases the stop of a room's array and returns its last report with the stop.
///
/// # Errors
/// No driver with a safety report, an array that is not stopped, a driver that does not release
/// the stop, a transport that fails.
pub fn rearm(config: &BusConfig, operator: &str, reason: &str) -> Result<SafetyReport> {
    let bus = Bus::open(config).context("cannot join the room")?;
    let room = bus.room().clone();
    let source = source_id::random();
    let token = bus.announce(&room.alive(NodeKind::Viewer, source))?;
    let publisher = bus.publisher(&room.rearm(), Class::RealTimeBlock)?;
    let report = fetch(&bus, |_| true)?.with_context(|| {
        format!(
            "no safety report in room \"{room}\" within {} s: expected a driver; give the room and an endpoint of the \
             driver, or re-arm an older driver with heliostat ui",
            ANSWER_TIMEOUT.as_secs()
        )
    })?;
    ensure!(report.stopped, "the array of room \"{room}\" is not stopped: nothing to re-arm");
    let (stop_source, stop_sequence) = (report.stop_source, report.stop_sequence);
    let stamp = Stamp { source, sequence: 1, time_ns: utc_ns() };
    let order = Rearm { stamp, stop_source, stop_sequence, operator: operator.into(), reason: reason.into() };
    let mut payload = Vec::new();
    encode(&order, &mut payload)?;
    publisher.put(&payload)?;
    let is_released =
        |now: &SafetyReport| !now.stopped || (now.stop_source, now.stop_sequence) != (stop_source, stop_sequence);
    match fetch(&bus, is_released)? {
        Some(now) if !now.stopped => {}
        Some(now) => bail!("another stop is latched by now, by {:?}: {}", now.operator, now.reason),
        None => bail!("the driver did not release the stop: it may allow re-arms by operators only; read its log"),
    }
    drop(token);
    bus.close()?;
    Ok(report)
}

/// The first safety report that fits, within the timeout.
fn fetch(bus: &Bus, fits: impl Fn(&SafetyReport) -> bool) -> Result<Option<SafetyReport>> {
    let until = Instant::now() + ANSWER_TIMEOUT;
    loop {
        let answers = bus.fetch(&bus.room().safety(), ANSWER_TIMEOUT)?;
        let report = answers.iter().find_map(|payload| decode(payload).ok());
        if let Some(report) = report.filter(&fits) {
            return Ok(Some(report));
        }
        if Instant::now() >= until {
            return Ok(None);
        }
        std::thread::sleep(QUERY_INTERVAL);
    }
}
