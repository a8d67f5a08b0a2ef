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

use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use heliostat_bus::{ACCEPTS_WITHIN, Bus, BusConfig, join_through};
use heliostat_service::exit::Interrupted;
use heliostat_service::{Stop, duration};

pub use self::report::{Finding, Report, Verdict};
use self::report::{NOT_STOPPED_AGAIN, STOPPED_AGAIN};
use self::room_in_use::expect_no_controller;
use self::test_session::TestSession;

/// Timeout of a query for liveliness tokens.
const PRESENCE_LIMIT: Duration = Duration::from_secs(5);

/// Time without a driver after which a line states that the check waits for one.
const WAIT_SHOWN_AFTER: Duration = Duration::from_secs(1);

/// Checks the driver of the array of a room with this index, and waits for its start at most `wait`. `show` takes a line
/// before each rule. An array that was stopped is stopped again at the end, also where `end` is requested before the last
/// rule.
///
/// # Errors
/// No driver in the room, a controller that would interfere, a stop of an operator, a transport that fails;
/// [`Interrupted`] where `end` is requested.
pub fn run(config: &BusConfig, array: usize, wait: Duration, end: &Stop, show: &dyn Fn(String)) -> Result<Report> {
    expect_no_controller_through(config)?;
    let bus = Bus::open(config).context("cannot join the room")?;
    let room = bus.room().clone();
    let keys = room.array(array);
    let (begun, mut is_shown, mut has_waited) = (Instant::now(), false, false);
    while !test_session::is_present(&bus, &keys)? {
        if begun.elapsed() >= wait {
            let reason = find_unconnected(config, &bus).map_or_else(
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
        if begun.elapsed() >= WAIT_SHOWN_AFTER && !std::mem::replace(&mut is_shown, true) {
            show(format!(
                "waits for a driver of array {array} in room \"{room}\", at most {} (--wait)",
                duration::in_seconds(wait)
            ));
        }
        has_waited = true;
        if end.wait_for(Duration::from_millis(50)) {
            return Err(Interrupted).context("nothing was sent");
        }
    }
    // The driver that has come may be the one that reaches a controller.
    if has_waited {
        expect_no_controller_through(config)?;
    }
    expect_no_controller(&bus)?;
    let mut session = TestSession::start(bus, array, config.is_authenticated())?;
    let findings = rules::judge(&mut session, end, show);
    // Also where a rule could not be tried, and after a signal.
    let is_stopped = session.stop_again();
    let findings = match is_stopped {
        None => findings?,
        Some(true) => findings.context(STOPPED_AGAIN)?,
        Some(false) => findings.context(NOT_STOPPED_AGAIN)?,
    };
    let report = Report {
        room: room.to_string(),
        hardware: session.capabilities.hardware.clone(),
        driver: session.capabilities.driver.clone(),
        mirrors: session.capabilities.mirrors(),
        findings,
        problem: session.problem(),
        is_stopped,
    };
    session.close()?;
    Ok(report)
}

/// Why this process is not connected: a fault of a connection, or where it has none, that no process answers.
fn find_unconnected(config: &BusConfig, bus: &Bus) -> Option<String> {
    Bus::find_connection_problem(config).or_else(|| {
        let is_alone = !config.connect.is_empty() && !bus.wait_connected(Duration::ZERO);
        let find = || Bus::find_unresolved(config).or_else(|| Bus::find_unanswered(config));
        if is_alone { find() } else { None }
    })
}

/// Refuses a room with a controller that one of the processes in `connect` reaches: a peer sees only those to which it
/// connects.
fn expect_no_controller_through(config: &BusConfig) -> Result<()> {
    if let (Some(through), _) = join_through(config, ACCEPTS_WITHIN) {
        expect_no_controller(&through)?;
        through.close()?;
    }
    Ok(())
}
