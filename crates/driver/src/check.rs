//! The conformance check: sends valid and invalid messages to any driver and reports which rules it
//! keeps.
//!
//! The check uses only public messages: capabilities, telemetry, safety reports and liveliness
//! tokens. A driver without safety reports is not judged by the rules that need them. Each finding
//! has its evidence; for a rule that could not be judged, that is the reason. A wait ends when the
//! driver has answered, or after some seconds; so on a busy machine the check is slow, but its
//! result is correct.
//!
//! - [`report`]: findings and their verdicts.
//! - `rules`: the rules, one function each, with those of the stop in `safety_rules` and of bounds
//!   in `bound_rules`; `judging`: what they share.
//! - `room_in_use`: the controllers of the room, beside which no check begins.
//! - `test_session`: the session of the check with the driver; `received`: what it has received.

mod bound_rules;
mod judging;
mod received;
pub mod report;
mod room_in_use;
mod rules;
mod safety_rules;
mod test_session;

use std::time::Duration;

use anyhow::{Context, Result, bail};
use heliostat_bus::{ACCEPTS_WITHIN, Bus, BusConfig, join_through};

pub use self::report::{Finding, Report, Verdict};
use self::room_in_use::expect_no_controller;
use self::test_session::TestSession;

/// Timeout for the presence of a driver.
const PRESENCE_LIMIT: Duration = Duration::from_secs(5);

/// Checks the driver of the array of a room with this index; `show` takes a line of progress before each rule.
///
/// # Errors
/// No driver in the room, a controller that would interfere, a transport that fails.
pub fn run(config: &BusConfig, array: usize, show: &dyn Fn(String)) -> Result<Report> {
    // A peer sees only the processes to which it connects; one of them reaches the controller.
    if let (Some(through), _) = join_through(config, ACCEPTS_WITHIN) {
        expect_no_controller(&through)?;
        through.close()?;
    }
    let bus = Bus::open(config).context("cannot join the room")?;
    let room = bus.room().clone();
    let keys = room.array(array);
    let begun = std::time::Instant::now();
    while !test_session::is_present(&bus, &keys)? {
        if begun.elapsed() >= PRESENCE_LIMIT {
            let reason = Bus::find_connection_problem(config).map_or_else(
                || {
                    format!(
                        "expected a liveliness token of a driver ({}) or a simulator; start it with the same room, \
                         the same --array and a matching endpoint",
                        keys.drivers_alive()
                    )
                },
                |problem| format!("this process is not connected: {problem}"),
            );
            bail!("no driver in room \"{room}\": {reason}");
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    expect_no_controller(&bus)?;
    let mut session = TestSession::start(bus, array, config.is_authenticated())?;
    let findings = rules::judge(&mut session, show)?;
    let report = Report {
        room: room.to_string(),
        hardware: session.capabilities.hardware.clone(),
        driver: session.capabilities.driver.clone(),
        mirrors: session.capabilities.mirrors(),
        findings,
        problem: session.problem(),
    };
    session.close()?;
    Ok(report)
}
