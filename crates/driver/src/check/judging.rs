//! Verdicts and their evidence: what the rules of the check share.

use anyhow::Result;
use heliostat_proto::{ArrayState, Counters, MirrorCommand, MirrorTelemetry};

use super::report::Verdict;
use super::test_session::TestSession;

/// Tolerance for angles that were rounded to single precision, in rad.
pub const ROUNDING_RAD: f64 = 1e-5;

/// The verdict on a rule, and its evidence.
pub type Outcome = (Verdict, String);

/// Kept or broken, with the evidence.
pub fn verdict(kept: bool, evidence: String) -> Result<Outcome> {
    Ok((if kept { Verdict::Kept } else { Verdict::Broken }, evidence))
}

/// Kept if every condition holds: the evidence then names them, otherwise only those that are
/// violated. `observed` follows them where it is not empty.
pub fn conditions(conditions: &[(&str, bool)], observed: &str) -> Result<Outcome> {
    let violated: Vec<&str> = conditions.iter().filter(|(_, holds)| !holds).map(|(name, _)| *name).collect();
    let named = match violated.as_slice() {
        [] => conditions.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", "),
        violated => format!("violated: {}", violated.join("; ")),
    };
    let observed = if observed.is_empty() { String::new() } else { format!(" ({observed})") };
    verdict(violated.is_empty(), format!("{named}{observed}"))
}

/// Not judged, with the reason.
pub fn not_judged(why: &str) -> Result<Outcome> {
    Ok((Verdict::NotJudged, why.to_owned()))
}

/// The outcome of a rule that was judged beside an obstacle, if any: the obstacle can have broken the
/// rule.
pub fn beside(obstacle: Option<&str>, (verdict, evidence): Outcome) -> Outcome {
    match (verdict, obstacle) {
        (Verdict::Broken, Some(obstacle)) => (Verdict::NotJudged, format!("{obstacle} ({evidence})")),
        _ => (verdict, evidence),
    }
}

/// Sends payloads that must be counted as `expected` and must not change anything else.
pub fn refused(session: &mut TestSession, payloads: &[Vec<u8>], expected: Counters) -> Result<Outcome> {
    let before = session.last();
    let (counted, after) = session.send_and_count(payloads)?;
    let unchanged = after.roll_commanded == before.roll_commanded
        && after.yaw_commanded == before.yaw_commanded
        && (after.epoch, after.applied_sequence) == (before.epoch, before.applied_sequence);
    let evidence = evidence(&counted, &after);
    // On a busy machine the validity of the last valid command may end before this, and the mirrors
    // park.
    let unchanged =
        unchanged || (after.state == ArrayState::Parked && after.applied_sequence == before.applied_sequence);
    let counted = counted == expected;
    conditions(&[("counted as required", counted), ("mirrors and command are unchanged", unchanged)], &evidence)
}

/// Whether telemetry reports the command and its angles.
pub fn shows(telemetry: &MirrorTelemetry, command: &MirrorCommand) -> bool {
    let named = (telemetry.epoch, telemetry.applied_sequence, telemetry.answers)
        == (command.epoch, command.sequence, command.answers);
    named && telemetry.state == ArrayState::Following && aims(telemetry, command)
}

/// Whether telemetry reports the angles of the command.
pub fn aims(telemetry: &MirrorTelemetry, command: &MirrorCommand) -> bool {
    let near = |(one, other): (&f32, &f32)| f64::from((one - other).abs()) < ROUNDING_RAD;
    telemetry.roll_commanded.iter().zip(&command.roll).all(near)
        && telemetry.yaw_commanded.iter().zip(&command.yaw).all(near)
}

/// The counters that changed, and the state in the telemetry.
pub fn evidence(counted: &Counters, telemetry: &MirrorTelemetry) -> String {
    let Counters { accepted, clipped, late, rejected, old_epoch, old_sequence, expired, stopped } = *counted;
    let all = [
        ("accepted", accepted),
        ("clipped", clipped),
        ("late", late),
        ("rejected", rejected),
        ("old_epoch", old_epoch),
        ("old_sequence", old_sequence),
        ("expired", expired),
        ("stopped", stopped),
    ];
    let changed: Vec<String> =
        all.iter().filter(|(_, count)| *count > 0).map(|(name, count)| format!("{name} +{count}")).collect();
    let changed = if changed.is_empty() { "no counter changed".to_owned() } else { changed.join(", ") };
    format!("{changed}; {:?} {}/{}", telemetry.state, telemetry.epoch, telemetry.applied_sequence).to_lowercase()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_broken_rule_names_the_conditions_that_are_violated_and_no_other() {
        let both = conditions(&[("it parks", true), ("it follows", true)], "").expect("an outcome");
        assert_eq!(both, (Verdict::Kept, "it parks, it follows".to_owned()));
        let one = conditions(&[("it parks", false), ("it follows", true)], "following 7/1").expect("an outcome");
        assert_eq!(one, (Verdict::Broken, "violated: it parks (following 7/1)".to_owned()));
    }

    #[test]
    fn a_rule_that_is_broken_beside_an_obstacle_is_not_judged() {
        let of = |verdict| (verdict, "violated: it parks".to_owned());
        let hindered = beside(Some("the device did not answer"), of(Verdict::Broken));
        assert_eq!(hindered, (Verdict::NotJudged, "the device did not answer (violated: it parks)".to_owned()));
        for (obstacle, verdict) in [(Some("the device did not answer"), Verdict::Kept), (None, Verdict::Broken)] {
            assert_eq!(beside(obstacle, of(verdict)), of(verdict));
        }
    }
}
