//! The bounds on the numbers of commands and calibrations.
//!
//! These rules are judged only for a driver that publishes a safety report: an older one could
//! follow the test values, and would then refuse every later command.

use anyhow::Result;
use heliostat_proto::messages::fault;
use heliostat_proto::{Counters, MirrorCommand, MirrorTelemetry, SafetyReport};

use super::judging::{Outcome, conditions, evidence, not_judged, refused, shows, verdict};
use super::report::Verdict;
use super::safety_rules::NOT_SUPPORTED;
use super::test_session::{TestSession, bytes};

/// An epoch at the end of its range is refused, and the present one goes on.
pub fn epoch(session: &mut TestSession) -> Result<Outcome> {
    refuses(session, |_, command| command.epoch = u64::MAX)
}

/// A sequence at the end of its range is refused, in the present epoch and in a new one.
pub fn sequence(session: &mut TestSession) -> Result<Outcome> {
    let (in_epoch, evidence) = refuses(session, |_, command| command.sequence = u64::MAX)?;
    if in_epoch != Verdict::Kept {
        return Ok((in_epoch, evidence));
    }
    refuses(session, |_, command| {
        command.epoch += 1;
        command.sequence = u64::MAX;
    })
}

/// A validity above the announced bound is refused.
pub fn validity(session: &mut TestSession) -> Result<Outcome> {
    let (longest, evidence) = refuses(session, |_, command| command.validity_ms = u32::MAX)?;
    if longest != Verdict::Kept {
        return Ok((longest, evidence));
    }
    refuses(session, |safety, command| command.validity_ms = safety.validity_max_ms.saturating_add(1))
}

/// Sends a changed command, which must be rejected, and then a valid one, which must be applied.
fn refuses(session: &mut TestSession, change: fn(&SafetyReport, &mut MirrorCommand)) -> Result<Outcome> {
    let Some(safety) = session.safety.clone() else { return not_judged(NOT_SUPPORTED) };
    let mut command = session.command(0.0, 0.0);
    change(&safety, &mut command);
    let outcome = refused(session, &[bytes(&command)?], Counters { rejected: 1, ..Counters::default() })?;
    let (roll, yaw) = session.angles_at(0.55);
    let next = session.command(roll, yaw);
    let (counted, telemetry) = session.send_and_count(&[bytes(&next)?])?;
    if counted.accepted == 1 && shows(&telemetry, &next) {
        return Ok(outcome);
    }
    let why = format!("{}; the next valid command: {}", outcome.1, evidence(&counted, &telemetry));
    verdict(false, why)
}

/// Gains and offsets beyond their bounds are refused, and the calibration in use remains.
pub fn calibration(session: &mut TestSession) -> Result<Outcome> {
    if session.safety.is_none() {
        return not_judged(NOT_SUPPORTED);
    }
    let mirrors = session.capabilities.mirrors();
    let mut refusals = Vec::new();
    for (gain, offset_rad) in [(1e-38, 0.0), (0.4, 0.0), (1.0, 0.3)] {
        let from = session.count();
        let used = session.calibrate(mirrors, 1.0, 0.0)?;
        let clear =
            |telemetry: &MirrorTelemetry| telemetry.calibration == used && telemetry.faults & fault::CALIBRATION == 0;
        let cleared = session.telemetry(from, clear).is_some();
        let from = session.count();
        session.calibrate(mirrors, gain, offset_rad)?;
        let flagged =
            |telemetry: &MirrorTelemetry| telemetry.calibration == used && telemetry.faults & fault::CALIBRATION != 0;
        refusals.push((gain, offset_rad, cleared && session.telemetry(from, flagged).is_some()));
    }
    session.calibrate(mirrors, 1.0, 0.0)?;
    let named =
        |(gain, offset, kept): &(f32, f64, bool)| (format!("gain {gain:e} with offset {offset} is refused"), *kept);
    let refusals: Vec<(String, bool)> = refusals.iter().map(named).collect();
    conditions(&refusals.iter().map(|(name, kept)| (name.as_str(), *kept)).collect::<Vec<_>>(), "")
}
