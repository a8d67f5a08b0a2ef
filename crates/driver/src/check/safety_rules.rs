//! The rules of the emergency stop: latch, re-arm and safety report.

use std::time::Duration;

use anyhow::Result;
use heliostat_proto::{ArrayState, Counters, MAX_STOPS, MirrorTelemetry, Nanos, SafetyReport, StopAction, StopReport};
use heliostat_service::clock::utc_ns;

use super::judging::{Outcome, conditions, not_judged, shows, verdict};
use super::test_session::{TestSession, bytes};

/// Observation time of a stop after its sender has left.
const ORPHAN_WATCH: Duration = Duration::from_millis(1500);

/// Attempts to release all stops: a page repeats those that the list of the array did not name.
const RELEASES: usize = 5;

/// Lead of a stop from a wrong clock.
const HOUR_NS: u64 = 3_600_000_000_000;

/// The first of many senders of stops: no other rule uses it, or one above it.
const OTHER_SENDERS: u64 = 1 << 8;

/// Why a rule is not judged for a driver without safety reports.
pub const NOT_SUPPORTED: &str = "not supported: the driver publishes no safety report";

/// Why a rule is not judged for a driver without stop reports.
const NO_STOP_REPORT: &str = "not supported: the driver publishes no stop report";

/// A stop is latched, and released by a later re-arm of kind 9.
pub fn stop(session: &mut TestSession) -> Result<Outcome> {
    let stopped_ns = utc_ns();
    let from = session.count();
    let stop = session.send_stop(StopAction::Stop, stopped_ns)?;
    let Some(telemetry) = session.telemetry(from, |telemetry| telemetry.state == ArrayState::Stopped) else {
        return verdict(false, format!("a stop was sent; state {:?} since", session.last().state));
    };
    let (roll, yaw) = session.angles_at(0.7);
    let command = session.command(roll, yaw);
    let (refused, after) = session.send_and_count(&[bytes(&command)?])?;
    let still = after.state == ArrayState::Stopped && after.roll_commanded == telemetry.roll_commanded;
    let latched = refused == Counters { stopped: 1, ..Counters::default() } && still;
    session.send_stop(StopAction::Rearm, stopped_ns - 1)?;
    let command = session.command(roll, yaw);
    let (early, _) = session.send_and_count(&[bytes(&command)?])?;
    let ignored = early == Counters { stopped: 1, ..Counters::default() };
    let from = session.count();
    rearm_unnamed(session, stop, stopped_ns)?;
    let parked = session.telemetry(from, |telemetry| telemetry.state == ArrayState::Parked).is_some();
    let command = session.command(roll, yaw);
    let (counted, after) = session.send_and_count(&[bytes(&command)?])?;
    let follows = counted.accepted == 1 && shows(&after, &command);
    conditions(
        &[
            ("a command is refused while stopped, and moves no mirror", latched),
            ("an early re-arm is ignored", ignored),
            ("a later re-arm parks the array", parked),
            ("the next command is followed", follows),
        ],
        "",
    )
}

/// A stop outlives its sender.
pub fn orphaned_stop(session: &mut TestSession) -> Result<Outcome> {
    let stopped_ns = utc_ns();
    let shows = |telemetry: &MirrorTelemetry| telemetry.state == ArrayState::Stopped;
    let Some(stop) = session.send_stop_and_leave(stopped_ns, shows)? else {
        return verdict(false, format!("a stop was sent by another process; state {:?} since", session.last().state));
    };
    // Long enough for the driver to notice that the sender has left, and to report a change of
    // state.
    let left = session.count();
    let released = session.wait(ORPHAN_WATCH, |received| {
        received.telemetry[left..]
            .iter()
            .find(|telemetry| telemetry.state != ArrayState::Stopped)
            .map(|telemetry| telemetry.state)
    });
    let (roll, yaw) = session.angles_at(0.7);
    let command = session.command(roll, yaw);
    let (counted, _) = session.send_and_count(&[bytes(&command)?])?;
    let refused = counted == Counters { stopped: 1, ..Counters::default() };
    let from = session.count();
    rearm_unnamed(session, stop, stopped_ns)?;
    let parked = session.telemetry(from, |telemetry| telemetry.state == ArrayState::Parked).is_some();
    conditions(
        &[
            ("the array stays stopped", released.is_none()),
            ("a command is refused", refused),
            ("the re-arm of another process parks the array", parked),
        ],
        "",
    )
}

/// Safety reports are published, answer queries, and name the latched stop.
pub fn report(session: &mut TestSession) -> Result<Outcome> {
    if session.safety.is_none() {
        return not_judged(NOT_SUPPORTED);
    }
    let from = session.inspect(|received| received.safety.len());
    let periodic = session.safety_report(from, |_| true).is_some();
    let stop = session.send_stop(StopAction::Stop, utc_ns())?;
    let names = |report: &SafetyReport| report.stopped && (report.stop_source, report.stop_sequence) == stop;
    let named = session.safety_report(from, names).is_some();
    let answered = session.fetch_safety()?.is_some_and(|report| names(&report));
    let parked = release(session, stop)?;
    let cleared = session.fetch_safety()?.is_some_and(|report| !report.stopped);
    conditions(
        &[
            ("published", periodic),
            ("a report names a new stop", named),
            ("the answer to a query names it", answered),
            ("a re-arm by its name parks the array", parked),
            ("the answer to a query reports the release", cleared),
        ],
        "",
    )
}

/// Stop reports name the stops of two senders, and that the device has executed them; each is released
/// by its name.
pub fn stop_report(session: &mut TestSession) -> Result<Outcome> {
    let Some(first) = session.fetch_stops()? else {
        return not_judged(NO_STOP_REPORT);
    };
    let one = session.send_stop(StopAction::Stop, utc_ns())?;
    let two = session.send_stop_of(1)?;
    let held = session.stop_report(|report| names(report) == [one, two] && report.device_stopped);
    let problem = session.fetch_stops()?.map(|report| report.problem).unwrap_or_default();
    let before = session.count();
    session.send_rearm(one.0, one.1)?;
    let kept = session.stop_report(|report| names(report) == [two]).is_some();
    let stayed = session.inspect(|received| {
        received.telemetry[before..].iter().all(|telemetry| telemetry.state == ArrayState::Stopped)
    });
    let parked = release(session, two)?;
    let cleared = session.stop_report(|report| report.stops.is_empty() && !report.device_stopped).is_some();
    conditions(
        &[
            ("no stop is reported before the first", first.stops.is_empty()),
            ("two stops are held, and executed by the device", held.is_some()),
            ("the release of one is reported", kept),
            ("the array is still stopped then", stayed),
            ("the release of the other parks it", parked),
            ("the last report has no stop", cleared),
        ],
        &problem,
    )
}

/// A later stop of a sender replaces its earlier one, and a stop without sender stands for those that the list
/// cannot name.
pub fn stop_list(session: &mut TestSession) -> Result<Outcome> {
    if session.fetch_stops()?.is_none() {
        return not_judged(NO_STOP_REPORT);
    }
    session.send_stop_of(OTHER_SENDERS)?;
    let later = session.send_stop_of(OTHER_SENDERS)?;
    let replaced = session.stop_report(|report| names(report) == [later]).is_some();
    for sender in 1..=MAX_STOPS as u64 {
        session.send_stop_of(OTHER_SENDERS + sender)?;
    }
    let full = session.stop_report(|report| report.stops.len() == MAX_STOPS && names(report).contains(&(0, 0)));
    let from = session.count();
    let released = release_all(session)?;
    let parked = session.telemetry(from, |telemetry| telemetry.state == ArrayState::Parked).is_some();
    conditions(
        &[
            ("a later stop of a sender replaces its earlier one", replaced),
            ("of more senders than the list holds, the last place is that of a stop without sender", full.is_some()),
            ("re-arms by the names in the list release all of them", released && parked),
        ],
        "",
    )
}

/// A stop that arrives by its repetition alone is held by its name; after its release the repetition has no effect.
pub fn stop_repetition(session: &mut TestSession) -> Result<Outcome> {
    if session.fetch_stops()?.is_none() {
        return not_judged(NO_STOP_REPORT);
    }
    let stop = session.unknown_stop();
    session.send_repetition(stop)?;
    let names = |report: &StopReport| report.stops.iter().any(|held| (held.source, held.sequence) == stop);
    if session.stop_report(|report| names(report) && report.device_stopped).is_none() {
        // A driver that stops without naming it is released as far as possible.
        release(session, stop)?;
        return verdict(
            false,
            "a stop was repeated to the array; no stop report names it with an executed stop".into(),
        );
    }
    let parked = release(session, stop)?;
    session.send_repetition(stop)?;
    let (roll, yaw) = session.angles_at(0.7);
    let command = session.command(roll, yaw);
    let (_, after) = session.send_and_count(&[bytes(&command)?])?;
    let follows = shows(&after, &command);
    if !follows {
        release(session, stop)?;
    }
    conditions(
        &[
            ("it is held by its name, and executed by the device", true),
            ("a re-arm by its name parks the array", parked),
            ("its repetition after the release is ignored", follows),
        ],
        "",
    )
}

/// A stop from a clock one hour ahead is released by its name, and by no other name.
pub fn named_rearm(session: &mut TestSession) -> Result<Outcome> {
    if session.safety.is_none() {
        return not_judged(NOT_SUPPORTED);
    }
    let earlier = session.send_stop(StopAction::Stop, utc_ns())?;
    let from = session.count();
    let stop = session.send_stop(StopAction::Stop, utc_ns() + HOUR_NS)?;
    let stopped = session.telemetry(from, |telemetry| telemetry.state == ArrayState::Stopped).is_some();
    for (source, sequence) in [earlier, (stop.0, stop.1 + 1), (stop.0 ^ 1, stop.1), (0, 0)] {
        session.send_rearm(source, sequence)?;
    }
    let (roll, yaw) = session.angles_at(0.7);
    let command = session.command(roll, yaw);
    let (counted, _) = session.send_and_count(&[bytes(&command)?])?;
    let kept = counted == Counters { stopped: 1, ..Counters::default() };
    let parked = release(session, stop)?;
    let command = session.command(roll, yaw);
    let (_, after) = session.send_and_count(&[bytes(&command)?])?;
    let follows = shows(&after, &command);
    conditions(
        &[
            ("a stop one hour ahead is obeyed", stopped),
            ("re-arms by other names release nothing", kept),
            ("a re-arm by its name parks the array", parked),
            ("the next command is followed", follows),
        ],
        "",
    )
}

/// Releases a stop of the check by a re-arm of kind 9, which releases no later one; by its name in a room with keys, where
/// a driver refuses kind 9.
fn rearm_unnamed(session: &TestSession, (source, sequence): (u64, u64), stopped_ns: Nanos) -> Result<()> {
    if session.is_authenticated {
        return session.send_rearm(source, sequence);
    }
    session.send_stop(StopAction::Rearm, stopped_ns + 1)?;
    Ok(())
}

/// The names of the stops in a report.
fn names(report: &StopReport) -> Vec<(u64, u64)> {
    report.stops.iter().map(|stop| (stop.source, stop.sequence)).collect()
}

/// Releases the stops that the array lists, also those that a holder then repeats; whether the list stays empty.
fn release_all(session: &TestSession) -> Result<bool> {
    for _ in 0..RELEASES {
        let held = session.inspect(|received| received.stops.last().map(names)).unwrap_or_default();
        for (source, sequence) in held {
            session.send_rearm(source, sequence)?;
        }
        if session.stop_report(|report| report.stops.is_empty()).is_none() {
            return Ok(false);
        }
        let again = session
            .wait(ORPHAN_WATCH, |received| received.stops.last().filter(|last| !last.stops.is_empty()).map(names));
        if again.is_none() {
            return Ok(true);
        }
    }
    Ok(false)
}

/// Releases a stop by its name; whether the array parks.
fn release(session: &mut TestSession, (source, sequence): (u64, u64)) -> Result<bool> {
    let from = session.count();
    session.send_rearm(source, sequence)?;
    Ok(session.telemetry(from, |telemetry| telemetry.state == ArrayState::Parked).is_some())
}
