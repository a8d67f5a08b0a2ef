//! The rules of the contract, one function each; no rule depends on a later one.

use std::time::Duration;

use anyhow::{Context, Result};
use heliostat_proto::messages::fault;
use heliostat_proto::{
    ArrayState, CLOCK_LEAD_MAX_NS, Counters, Feedback, MirrorCommand, MirrorTelemetry, UserReport, ValidityClock,
};

use heliostat_service::Stop;
use heliostat_service::clock::utc_ns;
use heliostat_service::exit::Interrupted;

use super::judging::{Outcome, ROUNDING_RAD, aims, beside, conditions, evidence, not_judged, refused, shows, verdict};
use super::received::Received;
use super::report::{Failure, Finding, Verdict};
use super::test_session::{ANSWER_TIMEOUT, TestSession, bytes};
use super::{bound_rules, safety_rules};

/// Number of commands in the burst.
const FLOOD: usize = 300;

/// Number of consecutive messages whose rate is measured.
const RATED: usize = 10;

/// Validity of a command whose angles are measured, in ms.
const MEASURED_VALIDITY_MS: u32 = 8000;

/// Validity of the command that the array outlives, in ms.
const SILENCE_VALIDITY_MS: u32 = 2000;

/// Number of silences, where a pause of a busy machine hides one.
const SILENCE_ATTEMPTS: usize = 3;

/// Statuses that must arrive within the timeout of an answer.
const STATUSES: usize = 2;
/// Times of [`ANSWER_TIMEOUT`] in one of which they have to arrive.
const STATUS_WINDOWS: usize = 3;

/// A verdict with its evidence, or the reason why the rule was not judged.
type Judge = fn(&mut TestSession) -> Result<Outcome>;

/// The name of a rule, its requirement, and what judges it.
type Rule = (&'static str, &'static str, Judge);

const RULES: [Rule; 28] = [
    ("capabilities", "published each second, and in answer to queries", capabilities),
    ("telemetry", "at least ten per second, for all mirrors, with consecutive sequence numbers", telemetry),
    ("status", "a node status about once a second, from the source of the telemetry", status),
    ("follow", "a valid command is applied and reported", follow),
    ("measured", "measured angles only with closed-loop feedback, and near those of a command in force", measured),
    ("undecodable", "an undecodable payload is refused as rejected", undecodable),
    ("mirror-count", "a command for another number of mirrors is refused as rejected", mirror_count),
    ("not-finite", "an angle that is not finite is refused as rejected", not_finite),
    ("old-sequence", "a sequence that is not new is refused as old_sequence", old_sequence),
    ("old-epoch", "a lower epoch is refused as old_epoch; a higher one takes over", old_epoch),
    ("expired", "a command past its validity is refused as expired", expired),
    ("future", "a command from the future is refused as expired, with fault bit 32", future),
    ("limits", "angles beyond the limits are clamped and counted as clipped", limits),
    ("silence", "after its validity a command is held, then the array parks", silence),
    ("late", "a resumed command, after the end of validity, is followed and counted", late),
    ("flood", "after a burst of commands the last one is applied and telemetry continues", flood),
    ("stop", "a stop is latched; commands are refused as stopped until a later re-arm", safety_rules::stop),
    ("orphaned-stop", "a stop stays latched when its sender has left the room", safety_rules::orphaned_stop),
    ("calibration", "a valid calibration is used; an invalid one is refused with fault bit 16", calibration),
    ("safety-report", "a safety report each second, at each stop, and in answer to queries", safety_rules::report),
    ("stop-report", "a stop report names each stop, and that the device has executed it", safety_rules::stop_report),
    (
        "stop-repetition",
        "a stop that is only repeated is held until its release, and not again",
        safety_rules::stop_repetition,
    ),
    ("named-rearm", "a re-arm releases the stop that it names, also one with a future time", safety_rules::named_rearm),
    ("epoch-bound", "an epoch beyond the bound is refused as rejected, and locks nothing out", bound_rules::epoch),
    ("sequence-bound", "a sequence beyond the bound is refused as rejected", bound_rules::sequence),
    ("validity-bound", "a validity beyond the bound is refused as rejected", bound_rules::validity),
    ("calibration-bound", "a gain or an offset beyond its bound is refused", bound_rules::calibration),
    ("stop-list", "a sender has one stop, and a full list a stop without sender", safety_rules::stop_list),
];

/// Judges every rule; `show` takes a line before each.
///
/// # Errors
/// [`Interrupted`] where `end` is requested before the last rule, a stop of another sender, a transport that fails.
pub fn judge(session: &mut TestSession, end: &Stop, show: &dyn Fn(String)) -> Result<Vec<Finding>> {
    RULES
        .into_iter()
        .enumerate()
        .map(|(index, (rule, requirement, judge))| {
            // A rule releases its own stops: none is left half done.
            if end.is_requested() {
                return Err(Interrupted).with_context(|| format!("the check ended before the rule {rule}"));
            }
            if session.failure.is_none() {
                show(format!("rule {} of {}: {rule}", index + 1, RULES.len()));
            }
            let outcome = judge_one(session, rule, judge);
            session.expect_no_other_stop()?;
            let (verdict, evidence) = outcome?;
            Ok(Finding { rule, requirement, verdict, evidence })
        })
        .collect()
}

/// The outcome of one rule. A device that does not answer, or a driver that has ended, breaks none.
fn judge_one(session: &mut TestSession, rule: &'static str, judge: Judge) -> Result<Outcome> {
    if let Some(failure) = session.failure {
        return not_judged(failure.obstacle());
    }
    // The last telemetry before the rule shows a device that failed earlier.
    let from = session.count().saturating_sub(1);
    let outcome = judge(session)?;
    if outcome.0 != Verdict::Broken {
        return Ok(outcome);
    }
    session.note_failure(rule)?;
    let lost = || session.is_device_lost(from).then_some("the device did not answer");
    Ok(beside(session.failure.map(Failure::obstacle).or_else(lost), outcome))
}

fn capabilities(session: &mut TestSession) -> Result<Outcome> {
    let from = session.inspect(|received| received.capabilities.len());
    let announced = session.wait(ANSWER_TIMEOUT, |received| received.capabilities.get(from).cloned());
    let same = announced.is_some_and(|announced| {
        heliostat_proto::Capabilities { stamp: session.capabilities.stamp, ..announced } == session.capabilities
    });
    conditions(&[("published without a change", same), ("in answer to a query", session.answered)], "")
}

/// The rate of messages by their time stamps; 0 for fewer than two.
fn rate_hz(telemetry: &[MirrorTelemetry]) -> f64 {
    let [first, .., last] = telemetry else { return 0.0 };
    let span_ns = last.stamp.time_ns.saturating_sub(first.stamp.time_ns);
    (telemetry.len() - 1) as f64 / (span_ns as f64 * 1e-9).max(1e-9)
}

fn telemetry(session: &mut TestSession) -> Result<Outcome> {
    let from = session.count();
    // A pause of a busy machine lowers the rate of the messages around it, not that of all.
    let best_hz = |received: &Received| received.telemetry[from..].windows(RATED).map(rate_hz).fold(0.0, f64::max);
    let many = session.wait(ANSWER_TIMEOUT, |received| (best_hz(received) >= 9.0).then_some(()));
    let mirrors = session.capabilities.mirrors();
    let (count, complete, gaps, undecodable, rate_hz) = session.inspect(|received| {
        let recent = &received.telemetry[from..];
        let gap = |pair: &&[MirrorTelemetry]| pair[1].stamp.sequence != pair[0].stamp.sequence + 1;
        let complete = recent.iter().all(|telemetry| telemetry.check_mirrors(mirrors).is_ok());
        let rate_hz = best_hz(received).max(rate_hz(recent));
        (recent.len(), complete, recent.windows(2).filter(gap).count(), received.undecodable.len(), rate_hz)
    });
    conditions(
        &[
            ("at least ten per second", many.is_some()),
            ("of all mirrors", complete),
            ("without gaps", gaps == 0),
            ("decodable", undecodable == 0),
        ],
        &format!("{count} messages at {rate_hz:.1} Hz, {gaps} gaps, {undecodable} undecodable"),
    )
}

fn status(session: &mut TestSession) -> Result<Outcome> {
    let source = session.last().stamp.source;
    let (mut found, mut all) = (0, 0);
    // A busy machine may delay those of one time.
    for _ in 0..STATUS_WINDOWS {
        let from = session.inspect(|received| received.statuses.len());
        let of_source = |received: &Received| {
            let valid =
                received.statuses[from..].iter().filter_map(|(node, status)| Some((node, status.as_ref().ok()?)));
            valid.filter(|(node, status)| **node == status.node && status.stamp.source == source).count()
        };
        session.wait(ANSWER_TIMEOUT, |received| (of_source(received) >= STATUSES).then_some(()));
        (found, all) = session.inspect(|received| (of_source(received), received.statuses.len() - from));
        if found >= STATUSES {
            break;
        }
    }
    let waited_s = ANSWER_TIMEOUT.as_secs();
    let others = all - found;
    verdict(
        found >= STATUSES,
        format!("{found} valid messages of the driver's source within {waited_s} s, {others} others"),
    )
}

fn follow(session: &mut TestSession) -> Result<Outcome> {
    let (roll, yaw) = session.angles_at(0.6);
    let command = session.command(roll, yaw);
    let (counted, telemetry) = session.send_and_count(&[bytes(&command)?])?;
    conditions(
        &[
            ("the command is accepted", counted.accepted == 1),
            ("telemetry names it, with its angles", shows(&telemetry, &command)),
            (
                "telemetry has the times of its arrival and application",
                telemetry.received_ns > 0 && telemetry.applied_ns > 0,
            ),
        ],
        &evidence(&counted, &telemetry),
    )
}

fn measured(session: &mut TestSession) -> Result<Outcome> {
    let telemetry = session.last();
    if session.capabilities.feedback == Feedback::OpenLoop {
        let empty = telemetry.roll_measured.is_empty() && telemetry.yaw_measured.is_empty();
        return verdict(empty, format!("open loop; {} measured angles", telemetry.roll_measured.len()));
    }
    let resolution_rad = session.capabilities.roll.resolution_rad.max(session.capabilities.yaw.resolution_rad);
    let tolerance_rad = 0.01 + 2.0 * f64::from(resolution_rad);
    let off = |telemetry: &MirrorTelemetry| {
        let roll = telemetry.roll_measured.iter().zip(&telemetry.roll_commanded);
        let pairs = roll.chain(telemetry.yaw_measured.iter().zip(&telemetry.yaw_commanded));
        pairs.map(|(measured, commanded)| f64::from((measured - commanded).abs())).fold(0.0, f64::max)
    };
    let mirrors = session.capabilities.mirrors();
    let full = |telemetry: &MirrorTelemetry| {
        [&telemetry.roll_measured, &telemetry.yaw_measured].iter().all(|angles| angles.len() == mirrors)
    };
    // A bound of 0 is not stated.
    let bound_ms = session.safety.as_ref().map(|safety| safety.validity_max_ms).filter(|bound_ms| *bound_ms > 0);
    let validity_ms = MEASURED_VALIDITY_MS.min(bound_ms.unwrap_or(u32::MAX));
    // Constant angles, such as 0, are near at most one of two targets.
    for share in [0.1, 0.9] {
        let (roll, yaw) = session.angles_at(share);
        // Slow mirrors reach the target while the command is valid.
        let command = MirrorCommand { validity_ms, ..session.command(roll, yaw) };
        let from = session.count();
        session.send(std::slice::from_ref(&command))?;
        let near = session.wait(ANSWER_TIMEOUT.max(Duration::from_millis(u64::from(validity_ms))), |received| {
            let mut shown = received.telemetry[from..].iter().filter(|telemetry| shows(telemetry, &command));
            shown.any(|telemetry| full(telemetry) && off(telemetry) < tolerance_rad).then_some(())
        });
        if near.is_none() {
            let telemetry = session.last();
            let measured = telemetry.roll_measured.len();
            let found = format!("{measured} measured angles, {:.4} rad off at most", off(&telemetry));
            return verdict(false, format!("commanded roll {roll:.3} and yaw {yaw:.3} rad: {found}"));
        }
    }
    verdict(true, format!("{mirrors} measured angles, less than {tolerance_rad:.4} rad off at two commanded angles"))
}

fn undecodable(session: &mut TestSession) -> Result<Outcome> {
    let command = session.command(0.0, 0.0);
    let valid = bytes(&command)?;
    let mut version = valid.clone();
    version[0] = 99;
    let mut trailing = valid.clone();
    trailing.push(0);
    let payloads = [
        version,
        trailing,
        valid[..valid.len() / 2].to_vec(),
        Vec::new(),
        b"garbage".to_vec(),
        bytes(&UserReport::default())?,
        vec![1; 2 << 20],
    ];
    let expected = Counters { rejected: payloads.len() as u64, ..Counters::default() };
    refused(session, &payloads, expected)
}

fn mirror_count(session: &mut TestSession) -> Result<Outcome> {
    let mut more = session.command(0.0, 0.0);
    more.roll.push(0.0);
    more.yaw.push(0.0);
    let none = MirrorCommand { roll: Vec::new(), yaw: Vec::new(), ..session.command(0.0, 0.0) };
    refused(session, &[bytes(&more)?, bytes(&none)?], Counters { rejected: 2, ..Counters::default() })
}

fn not_finite(session: &mut TestSession) -> Result<Outcome> {
    let valid = bytes(&session.command(0.0, 0.0))?;
    // The last four bytes are the yaw of the last mirror.
    let with = |value: f32| [&valid[..valid.len() - 4], &value.to_le_bytes()].concat();
    let payloads = [with(f32::NAN), with(f32::INFINITY), with(f32::NEG_INFINITY)];
    refused(session, &payloads, Counters { rejected: 3, ..Counters::default() })
}

fn old_sequence(session: &mut TestSession) -> Result<Outcome> {
    let (roll, yaw) = session.angles_at(0.55);
    let command = session.command(roll, yaw);
    session.send_and_count(&[bytes(&command)?])?;
    let lower = MirrorCommand { sequence: command.sequence - 1, ..session.command(0.0, 0.0) };
    let again = MirrorCommand { sequence: command.sequence, ..session.command(0.0, 0.0) };
    refused(session, &[bytes(&again)?, bytes(&lower)?], Counters { old_sequence: 2, ..Counters::default() })
}

fn old_epoch(session: &mut TestSession) -> Result<Outcome> {
    session.epoch += 10;
    session.sequence = 0;
    let (roll, yaw) = session.angles_at(0.45);
    let command = session.command(roll, yaw);
    let (taken, telemetry) = session.send_and_count(&[bytes(&command)?])?;
    if taken.accepted != 1 || !shows(&telemetry, &command) {
        return verdict(false, format!("a higher epoch: {}", evidence(&taken, &telemetry)));
    }
    let old = MirrorCommand { epoch: session.epoch - 5, sequence: 1_000_000, ..session.command(0.0, 0.0) };
    refused(session, &[bytes(&old)?], Counters { old_epoch: 1, ..Counters::default() })
}

fn expired(session: &mut TestSession) -> Result<Outcome> {
    if session.capabilities.validity_clock == ValidityClock::Arrival {
        return not_judged("it counts validity from arrival");
    }
    let old = MirrorCommand { time_ns: utc_ns() - 5_000_000_000, ..session.command(0.0, 0.0) };
    refused(session, &[bytes(&old)?], Counters { expired: 1, ..Counters::default() })
}

fn future(session: &mut TestSession) -> Result<Outcome> {
    if session.capabilities.validity_clock == ValidityClock::Arrival {
        return not_judged("it counts validity from arrival");
    }
    let early = MirrorCommand { time_ns: utc_ns() + 60_000_000_000 + CLOCK_LEAD_MAX_NS, ..session.command(0.0, 0.0) };
    let (counted, telemetry) = session.send_and_count(&[bytes(&early)?])?;
    let flagged = telemetry.faults & fault::CLOCK != 0;
    let next = session.command(0.0, 0.0);
    let (_, after) = session.send_and_count(&[bytes(&next)?])?;
    let cleared = after.faults & fault::CLOCK == 0;
    conditions(
        &[
            ("counted as expired", counted == Counters { expired: 1, ..Counters::default() }),
            ("the fault bit is set", flagged),
            ("a valid command clears it", cleared),
        ],
        &evidence(&counted, &telemetry),
    )
}

fn limits(session: &mut TestSession) -> Result<Outcome> {
    let (roll, yaw) = (session.capabilities.roll, session.capabilities.yaw);
    let wide = session.command(f64::from(roll.max_rad) + 0.5, f64::from(yaw.min_rad) - 0.5);
    let (counted, telemetry) = session.send_and_count(&[bytes(&wide)?])?;
    let at = |angles: &[f32], end: f32| angles.iter().all(|angle| f64::from((angle - end).abs()) < ROUNDING_RAD);
    let clamped = at(&telemetry.roll_commanded, roll.max_rad) && at(&telemetry.yaw_commanded, yaw.min_rad);
    let counts = counted == Counters { accepted: 1, clipped: 1, ..Counters::default() };
    let first = |angles: &[f32]| angles.first().map_or("no angle".to_owned(), |angle| format!("{angle:.3}"));
    verdict(
        clamped && counts,
        format!(
            "{}; {} and {} rad for {:.3} and {:.3}",
            evidence(&counted, &telemetry),
            first(&telemetry.roll_commanded),
            first(&telemetry.yaw_commanded),
            wide.roll[0],
            wide.yaw[0]
        ),
    )
}

fn silence(session: &mut TestSession) -> Result<Outcome> {
    for _ in 1..SILENCE_ATTEMPTS {
        let (outcome, is_unseen) = one_silence(session)?;
        if !is_unseen {
            return Ok(outcome);
        }
    }
    Ok(one_silence(session)?.0)
}

/// The outcome of one silence, and whether a pause of a busy machine has hidden it.
fn one_silence(session: &mut TestSession) -> Result<(Outcome, bool)> {
    let (roll, yaw) = session.angles_at(0.6);
    let command = MirrorCommand { validity_ms: SILENCE_VALIDITY_MS, ..session.command(roll, yaw) };
    let from = session.count();
    let (counted, _) = session.send_and_count(&[bytes(&command)?])?;
    let park_after = Duration::from_millis(u64::from(session.capabilities.park_after_ms));
    let [park_roll, park_yaw] = session.capabilities.park_rad;
    let validity = Duration::from_millis(u64::from(SILENCE_VALIDITY_MS));
    let parked = session.wait(ANSWER_TIMEOUT + validity + park_after, |received| {
        let after = received.telemetry[from..].iter().skip_while(|telemetry| !shows(telemetry, &command));
        after.into_iter().find(|telemetry| telemetry.state == ArrayState::Parked).cloned()
    });
    let (held, moved, longest_ns) = session.inspect(|received| {
        let between = |pair: &[MirrorTelemetry]| pair[1].stamp.time_ns.saturating_sub(pair[0].stamp.time_ns);
        let longest_ns = received.telemetry[from..].windows(2).map(between).max().unwrap_or(0);
        let after = received.telemetry[from..].iter().skip_while(|telemetry| !shows(telemetry, &command));
        let holding: Vec<_> = after.filter(|telemetry| telemetry.state == ArrayState::Holding).collect();
        (holding.len(), holding.iter().any(|telemetry| !aims(telemetry, &command)), longest_ns)
    });
    let at = |angles: &[f32], park: f32| angles.iter().all(|angle| f64::from((angle - park).abs()) < ROUNDING_RAD);
    let at_park = parked
        .as_ref()
        .is_some_and(|telemetry| at(&telemetry.roll_commanded, park_roll) && at(&telemetry.yaw_commanded, park_yaw));
    let is_skipped = held == 0 && parked.is_some() && u128::from(longest_ns) >= park_after.as_nanos();
    let outcome = conditions(
        &[
            ("the command is accepted", counted.accepted == 1),
            ("the array holds after its validity", held > 0),
            ("no mirror moves while it holds", !moved),
            ("it parks", parked.is_some()),
            ("at its park position", at_park),
        ],
        &format!("holding in {held} messages"),
    )?;
    Ok((outcome, is_skipped || counted.expired > 0))
}

fn late(session: &mut TestSession) -> Result<Outcome> {
    if session.last().state == ArrayState::Following {
        return not_judged("the array is still following, so no command can be a resumed one");
    }
    let (roll, yaw) = session.angles_at(0.5);
    let command = session.command(roll, yaw);
    let (counted, telemetry) = session.send_and_count(&[bytes(&command)?])?;
    verdict(counted == Counters { accepted: 1, late: 1, ..Counters::default() }, evidence(&counted, &telemetry))
}

fn flood(session: &mut TestSession) -> Result<Outcome> {
    let before = session.last().counters;
    let (roll, yaw) = session.angles_at(0.5);
    let commands: Vec<_> = (0..FLOOD).map(|_| session.command(roll, yaw)).collect();
    let from = session.count();
    session.send(&commands)?;
    // A device that fails is in the state fault, although the command is accepted.
    let applied = session.telemetry(from, |telemetry| commands.last().is_some_and(|last| shows(telemetry, last)));
    let alive = session.telemetry(session.count(), |_| true).is_some();
    let counted = session.last().counters.accepted - before.accepted;
    conditions(
        &[("the last command is applied", applied.is_some()), ("telemetry continues", alive)],
        &format!("{counted} of {FLOOD} accepted"),
    )
}

fn calibration(session: &mut TestSession) -> Result<Outcome> {
    let mirrors = session.capabilities.mirrors();
    let from = session.count();
    let used = session.calibrate(mirrors, 1.0, 0.0)?;
    let taken = session
        .telemetry(from, |telemetry| telemetry.calibration == used && telemetry.faults & fault::CALIBRATION == 0)
        .is_some();
    let from = session.count();
    session.calibrate(mirrors + 1, 1.0, 0.0)?;
    let flagged =
        |telemetry: &MirrorTelemetry| telemetry.faults & fault::CALIBRATION != 0 && telemetry.calibration == used;
    let size = session.telemetry(from, flagged).is_some();
    let cleared = session.calibrate(mirrors, 1.0, 0.0)?;
    let recovered = session
        .telemetry(from, |telemetry| telemetry.calibration == cleared && telemetry.faults & fault::CALIBRATION == 0);
    let from = session.count();
    session.calibrate(mirrors, 1.0, 10.0)?;
    let far = session
        .telemetry(from, |telemetry| telemetry.faults & fault::CALIBRATION != 0 && telemetry.calibration == cleared);
    let (far, recovered) = (far.is_some(), recovered.is_some());
    session.calibrate(mirrors, 1.0, 0.0)?;
    conditions(
        &[
            ("a valid one is used", taken),
            ("one of another size is refused", size),
            ("a valid one is used again", recovered),
            ("one beyond the hardware is refused", far),
        ],
        "",
    )
}
