//! The rules, one function each, in an order in which none needs a later one.

use std::time::Duration;

use anyhow::Result;
use heliostat_proto::messages::fault;
use heliostat_proto::{
    ArrayState, CLOCK_LEAD_MAX_NS, Counters, Feedback, MirrorCommand, MirrorTelemetry, StopAction, UserReport,
    ValidityClock,
};
use heliostat_service::clock::utc_ns;

use super::player::{PATIENCE, Player, bytes};
use super::{Finding, Verdict};

/// Angles that went through single precision may differ by this, in rad.
const ROUNDING_RAD: f64 = 1e-5;

/// Commands of the flood.
const FLOOD: usize = 300;

/// How long a stop is watched after its sender has left.
const ORPHAN_WATCH: Duration = Duration::from_millis(1500);

/// Kept or broken with the evidence, or not judged and why.
type Outcome = (Verdict, String);

type Rule = (&'static str, &'static str, fn(&mut Player) -> Result<Outcome>);

const RULES: [Rule; 18] = [
    ("capabilities", "announced each second and given on request", capabilities),
    ("telemetry", "at least ten a second, for the whole array, numbered 1 by 1", telemetry),
    ("follow", "a sound command is applied, and told so", follow),
    ("measured", "measured angles only where it measures, and near the commanded ones", measured),
    ("undecodable", "what cannot be decoded is refused as rejected", undecodable),
    ("mirror-count", "a command for another number of mirrors is refused as rejected", mirror_count),
    ("not-finite", "an angle that is not finite is refused as rejected", not_finite),
    ("old-sequence", "a sequence that is not new is refused as old_sequence", old_sequence),
    ("old-epoch", "a lower epoch is refused as old_epoch; a higher one takes over", old_epoch),
    ("expired", "a command past its validity is refused as expired", expired),
    ("future", "a command from the future is refused as expired, with fault bit 32", future),
    ("limits", "angles beyond the limits are clamped and counted as clipped", limits),
    ("silence", "after its validity a command is held, then the array parks", silence),
    ("late", "a command after the silence is followed and counted as late", late),
    ("flood", "a burst of commands leaves the last one applied and telemetry alive", flood),
    ("stop", "a stop is latched; commands are refused as stopped until a later re-arm", stop),
    ("orphaned-stop", "a stop stays latched when its sender has left the room", orphaned_stop),
    ("calibration", "a sound calibration is used; an unsound one is refused with fault bit 16", calibration),
];

/// Tries every rule.
pub fn judge(player: &mut Player) -> Result<Vec<Finding>> {
    RULES
        .into_iter()
        .map(|(rule, asks, judge)| {
            let (verdict, evidence) = judge(player)?;
            Ok(Finding { rule, asks, verdict, evidence })
        })
        .collect()
}

fn verdict(kept: bool, evidence: String) -> Result<Outcome> {
    Ok((if kept { Verdict::Kept } else { Verdict::Broken }, evidence))
}

fn not_judged(why: &str) -> Result<Outcome> {
    Ok((Verdict::NotJudged, why.to_owned()))
}

fn capabilities(player: &mut Player) -> Result<Outcome> {
    let from = player.look(|heard| heard.capabilities.len());
    let announced = player.wait(PATIENCE, |heard| heard.capabilities.get(from).cloned());
    let same = announced.is_some_and(|announced| {
        heliostat_proto::Capabilities { stamp: player.capabilities.stamp, ..announced } == player.capabilities
    });
    let word = |holds: bool| if holds { "yes" } else { "no" };
    verdict(
        same && player.answered,
        format!("announced alike {}, given on request {}", word(same), word(player.answered)),
    )
}

fn telemetry(player: &mut Player) -> Result<Outcome> {
    let from = player.count();
    let many = player.wait(PATIENCE, |heard| (heard.telemetry.len() >= from + 10).then_some(()));
    let mirrors = player.capabilities.mirrors();
    let (heard, whole, gaps, unsound) = player.look(|heard| {
        let recent = &heard.telemetry[from..];
        let gap = |pair: &&[MirrorTelemetry]| pair[1].stamp.sequence != pair[0].stamp.sequence + 1;
        let whole = recent.iter().all(|told| told.check_mirrors(mirrors).is_ok());
        (recent.len(), whole, recent.windows(2).filter(gap).count(), heard.unsound.len())
    });
    let span_ns = player.look(|heard| match &heard.telemetry[from..] {
        [first, .., last] => last.stamp.time_ns.saturating_sub(first.stamp.time_ns),
        _ => 0,
    });
    let rate_hz = (heard.saturating_sub(1)) as f64 / (span_ns as f64 * 1e-9).max(1e-9);
    let kept = many.is_some() && whole && gaps == 0 && unsound == 0 && rate_hz >= 9.0;
    verdict(kept, format!("{heard} messages at {rate_hz:.1} Hz, {gaps} gaps, {unsound} undecodable"))
}

fn follow(player: &mut Player) -> Result<Outcome> {
    let (roll, yaw) = player.place(0.6);
    let command = player.command(roll, yaw);
    let (counted, told) = player.play(&[bytes(&command)?])?;
    let kept = counted.accepted == 1 && shows(&told, &command) && told.received_ns > 0 && told.applied_ns > 0;
    verdict(kept, evidence(&counted, &told))
}

fn measured(player: &mut Player) -> Result<Outcome> {
    let told = player.last();
    if player.capabilities.feedback == Feedback::OpenLoop {
        let empty = told.roll_measured.is_empty() && told.yaw_measured.is_empty();
        return verdict(empty, format!("open loop; {} measured angles", told.roll_measured.len()));
    }
    let resolution_rad = player.capabilities.roll.resolution_rad.max(player.capabilities.yaw.resolution_rad);
    let tolerance_rad = 0.01 + 2.0 * f64::from(resolution_rad);
    let off = |told: &MirrorTelemetry| {
        let roll = told.roll_measured.iter().zip(&told.roll_commanded);
        let pairs = roll.chain(told.yaw_measured.iter().zip(&told.yaw_commanded));
        pairs.map(|(measured, commanded)| f64::from((measured - commanded).abs())).fold(0.0, f64::max)
    };
    let full = |told: &MirrorTelemetry| told.roll_measured.len() == told.roll_commanded.len();
    let near = player.telemetry(player.count(), |told| full(told) && off(told) < tolerance_rad);
    let told = player.last();
    verdict(near.is_some(), format!("{} measured angles, {:.4} rad off at most", told.roll_measured.len(), off(&told)))
}

fn undecodable(player: &mut Player) -> Result<Outcome> {
    let command = player.command(0.0, 0.0);
    let sound = bytes(&command)?;
    let mut version = sound.clone();
    version[0] = 99;
    let mut trailing = sound.clone();
    trailing.push(0);
    let payloads = [
        version,
        trailing,
        sound[..sound.len() / 2].to_vec(),
        Vec::new(),
        b"garbage".to_vec(),
        bytes(&UserReport::default())?,
        vec![1; 2 << 20],
    ];
    let wanted = Counters { rejected: payloads.len() as u64, ..Counters::default() };
    refused(player, &payloads, wanted)
}

fn mirror_count(player: &mut Player) -> Result<Outcome> {
    let mut more = player.command(0.0, 0.0);
    more.roll.push(0.0);
    more.yaw.push(0.0);
    let none = MirrorCommand { roll: Vec::new(), yaw: Vec::new(), ..player.command(0.0, 0.0) };
    refused(player, &[bytes(&more)?, bytes(&none)?], Counters { rejected: 2, ..Counters::default() })
}

fn not_finite(player: &mut Player) -> Result<Outcome> {
    let sound = bytes(&player.command(0.0, 0.0))?;
    // The last four bytes are the yaw of the last mirror.
    let with = |value: f32| [&sound[..sound.len() - 4], &value.to_le_bytes()].concat();
    let payloads = [with(f32::NAN), with(f32::INFINITY), with(f32::NEG_INFINITY)];
    refused(player, &payloads, Counters { rejected: 3, ..Counters::default() })
}

fn old_sequence(player: &mut Player) -> Result<Outcome> {
    let (roll, yaw) = player.place(0.55);
    let command = player.command(roll, yaw);
    player.play(&[bytes(&command)?])?;
    let lower = MirrorCommand { sequence: command.sequence - 1, ..player.command(0.0, 0.0) };
    let again = MirrorCommand { sequence: command.sequence, ..player.command(0.0, 0.0) };
    refused(player, &[bytes(&again)?, bytes(&lower)?], Counters { old_sequence: 2, ..Counters::default() })
}

fn old_epoch(player: &mut Player) -> Result<Outcome> {
    player.epoch += 10;
    player.sequence = 0;
    let (roll, yaw) = player.place(0.45);
    let command = player.command(roll, yaw);
    let (taken, told) = player.play(&[bytes(&command)?])?;
    if taken.accepted != 1 || !shows(&told, &command) {
        return verdict(false, format!("a higher epoch: {}", evidence(&taken, &told)));
    }
    let old = MirrorCommand { epoch: player.epoch - 5, sequence: 1_000_000, ..player.command(0.0, 0.0) };
    refused(player, &[bytes(&old)?], Counters { old_epoch: 1, ..Counters::default() })
}

fn expired(player: &mut Player) -> Result<Outcome> {
    if player.capabilities.validity_clock == ValidityClock::Arrival {
        return not_judged("it counts validity from arrival");
    }
    let old = MirrorCommand { time_ns: utc_ns() - 5_000_000_000, ..player.command(0.0, 0.0) };
    refused(player, &[bytes(&old)?], Counters { expired: 1, ..Counters::default() })
}

fn future(player: &mut Player) -> Result<Outcome> {
    if player.capabilities.validity_clock == ValidityClock::Arrival {
        return not_judged("it counts validity from arrival");
    }
    let early = MirrorCommand { time_ns: utc_ns() + 60_000_000_000 + CLOCK_LEAD_MAX_NS, ..player.command(0.0, 0.0) };
    let (counted, told) = player.play(&[bytes(&early)?])?;
    let flagged = told.faults & fault::CLOCK != 0;
    let next = player.command(0.0, 0.0);
    let (_, after) = player.play(&[bytes(&next)?])?;
    let cleared = after.faults & fault::CLOCK == 0;
    let kept = counted == Counters { expired: 1, ..Counters::default() } && flagged && cleared;
    verdict(kept, format!("{}; bit set {flagged}, cleared by a sound command {cleared}", evidence(&counted, &told)))
}

fn limits(player: &mut Player) -> Result<Outcome> {
    let (roll, yaw) = (player.capabilities.roll, player.capabilities.yaw);
    let wide = player.command(f64::from(roll.max_rad) + 0.5, f64::from(yaw.min_rad) - 0.5);
    let (counted, told) = player.play(&[bytes(&wide)?])?;
    let at = |angles: &[f32], end: f32| angles.iter().all(|angle| f64::from((angle - end).abs()) < ROUNDING_RAD);
    let clamped = at(&told.roll_commanded, roll.max_rad) && at(&told.yaw_commanded, yaw.min_rad);
    let counts = counted == Counters { accepted: 1, clipped: 1, ..Counters::default() };
    let (first_roll, first_yaw) = (told.roll_commanded.first(), told.yaw_commanded.first());
    verdict(
        clamped && counts,
        format!(
            "{}; {first_roll:?} and {first_yaw:?} rad for {:.3} and {:.3}",
            evidence(&counted, &told),
            wide.roll[0],
            wide.yaw[0]
        ),
    )
}

fn silence(player: &mut Player) -> Result<Outcome> {
    let (roll, yaw) = player.place(0.6);
    let command = MirrorCommand { validity_ms: 700, ..player.command(roll, yaw) };
    let from = player.count();
    let (counted, _) = player.play(&[bytes(&command)?])?;
    let park_after = Duration::from_millis(u64::from(player.capabilities.park_after_ms));
    let [park_roll, park_yaw] = player.capabilities.park_rad;
    let parked = player.wait(PATIENCE + park_after, |heard| {
        let after = heard.telemetry[from..].iter().skip_while(|told| !shows(told, &command));
        after.into_iter().find(|told| told.state == ArrayState::Parked).cloned()
    });
    let (held, moved) = player.look(|heard| {
        let after = heard.telemetry[from..].iter().skip_while(|told| !shows(told, &command));
        let holding: Vec<_> = after.filter(|told| told.state == ArrayState::Holding).collect();
        (holding.len(), holding.iter().any(|told| !aims(told, &command)))
    });
    let at = |angles: &[f32], park: f32| angles.iter().all(|angle| f64::from((angle - park).abs()) < ROUNDING_RAD);
    let at_park =
        parked.as_ref().is_some_and(|told| at(&told.roll_commanded, park_roll) && at(&told.yaw_commanded, park_yaw));
    verdict(
        counted.accepted == 1 && held > 0 && !moved && at_park,
        format!(
            "told holding {held} times, moved meanwhile {moved}; parked {}, at its park position {at_park}",
            parked.is_some()
        ),
    )
}

fn late(player: &mut Player) -> Result<Outcome> {
    if player.last().state == ArrayState::Following {
        return not_judged("the array never fell silent");
    }
    let (roll, yaw) = player.place(0.5);
    let command = player.command(roll, yaw);
    let (counted, told) = player.play(&[bytes(&command)?])?;
    verdict(counted == Counters { accepted: 1, late: 1, ..Counters::default() }, evidence(&counted, &told))
}

fn flood(player: &mut Player) -> Result<Outcome> {
    let before = player.last().counters;
    let (roll, yaw) = player.place(0.5);
    let commands: Vec<_> = (0..FLOOD).map(|_| player.command(roll, yaw)).collect();
    let from = player.count();
    player.send(&commands)?;
    let last = player.sequence;
    let applied = player.telemetry(from, |told| told.applied_sequence == last);
    let alive = player.telemetry(player.count(), |_| true).is_some();
    let counted = player.last().counters.accepted - before.accepted;
    verdict(applied.is_some() && alive, format!("{counted} of {FLOOD} applied, the last of them {}", applied.is_some()))
}

fn stop(player: &mut Player) -> Result<Outcome> {
    let stopped_ns = utc_ns();
    let from = player.count();
    player.order(StopAction::Stop, stopped_ns)?;
    let Some(told) = player.telemetry(from, |told| told.state == ArrayState::Stopped) else {
        return verdict(false, format!("a stop was sent; state {:?} since", player.last().state));
    };
    let (roll, yaw) = player.place(0.7);
    let command = player.command(roll, yaw);
    let (refused, after) = player.play(&[bytes(&command)?])?;
    let still = after.state == ArrayState::Stopped && after.roll_commanded == told.roll_commanded;
    let latched = refused == Counters { stopped: 1, ..Counters::default() } && still;
    player.order(StopAction::Rearm, stopped_ns - 1)?;
    let command = player.command(roll, yaw);
    let (early, _) = player.play(&[bytes(&command)?])?;
    let ignored = early == Counters { stopped: 1, ..Counters::default() };
    let from = player.count();
    player.order(StopAction::Rearm, utc_ns())?;
    let parked = player.telemetry(from, |told| told.state == ArrayState::Parked).is_some();
    let command = player.command(roll, yaw);
    let (counted, after) = player.play(&[bytes(&command)?])?;
    let follows = counted.accepted == 1 && shows(&after, &command);
    verdict(
        latched && ignored && parked && follows,
        format!(
            "commands refused {latched}, early re-arm ignored {ignored}, parked by a later one {parked}, follows again {follows}"
        ),
    )
}

fn orphaned_stop(player: &mut Player) -> Result<Outcome> {
    if !player.order_and_leave(StopAction::Stop, |told| told.state == ArrayState::Stopped)? {
        return verdict(false, format!("a stop was sent by another; state {:?} since", player.last().state));
    }
    // Long enough to notice that somebody is gone, and for telemetry to tell what came of it.
    let left = player.count();
    let released = player.wait(ORPHAN_WATCH, |heard| {
        heard.telemetry[left..].iter().find(|told| told.state != ArrayState::Stopped).map(|told| told.state)
    });
    let (roll, yaw) = player.place(0.7);
    let command = player.command(roll, yaw);
    let (counted, _) = player.play(&[bytes(&command)?])?;
    let refused = counted == Counters { stopped: 1, ..Counters::default() };
    let from = player.count();
    player.order(StopAction::Rearm, utc_ns())?;
    let parked = player.telemetry(from, |told| told.state == ArrayState::Parked).is_some();
    verdict(
        released.is_none() && refused && parked,
        format!("state left meanwhile {released:?}, command refused {refused}, parked by another's re-arm {parked}"),
    )
}

fn calibration(player: &mut Player) -> Result<Outcome> {
    let mirrors = player.capabilities.mirrors();
    let from = player.count();
    let used = player.calibrate(mirrors, 0.0)?;
    let taken =
        player.telemetry(from, |told| told.calibration == used && told.faults & fault::CALIBRATION == 0).is_some();
    let from = player.count();
    player.calibrate(mirrors + 1, 0.0)?;
    let flagged = |told: &MirrorTelemetry| told.faults & fault::CALIBRATION != 0 && told.calibration == used;
    let size = player.telemetry(from, flagged).is_some();
    let cleared = player.calibrate(mirrors, 0.0)?;
    let recovered = player.telemetry(from, |told| told.calibration == cleared && told.faults & fault::CALIBRATION == 0);
    let from = player.count();
    player.calibrate(mirrors, 10.0)?;
    let far = player.telemetry(from, |told| told.faults & fault::CALIBRATION != 0 && told.calibration == cleared);
    let (far, recovered) = (far.is_some(), recovered.is_some());
    player.calibrate(mirrors, 0.0)?;
    verdict(
        taken && size && recovered && far,
        format!("used {taken}; refused for another size {size}, beyond the hardware {far}; used again {recovered}"),
    )
}

/// Plays payloads that must be refused under `wanted` and change nothing else.
fn refused(player: &mut Player, payloads: &[Vec<u8>], wanted: Counters) -> Result<Outcome> {
    let before = player.last();
    let (counted, after) = player.play(payloads)?;
    let unchanged = after.roll_commanded == before.roll_commanded
        && after.yaw_commanded == before.yaw_commanded
        && (after.epoch, after.applied_sequence) == (before.epoch, before.applied_sequence);
    let evidence = evidence(&counted, &after);
    // Played slowly by a busy machine, the last sound command may run out meanwhile and the mirrors park.
    let unchanged =
        unchanged || (after.state == ArrayState::Parked && after.applied_sequence == before.applied_sequence);
    verdict(counted == wanted && unchanged, format!("{evidence}; mirrors and command unchanged {unchanged}"))
}

/// Whether telemetry names the command and its angles.
fn shows(told: &MirrorTelemetry, command: &MirrorCommand) -> bool {
    let named = (told.epoch, told.applied_sequence, told.answers) == (command.epoch, command.sequence, command.answers);
    named && told.state == ArrayState::Following && aims(told, command)
}

fn aims(told: &MirrorTelemetry, command: &MirrorCommand) -> bool {
    let near = |(one, other): (&f32, &f32)| f64::from((one - other).abs()) < ROUNDING_RAD;
    told.roll_commanded.iter().zip(&command.roll).all(near) && told.yaw_commanded.iter().zip(&command.yaw).all(near)
}

/// The counters that moved, and what telemetry says.
fn evidence(counted: &Counters, told: &MirrorTelemetry) -> String {
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
    let moved: Vec<String> =
        all.iter().filter(|(_, count)| *count > 0).map(|(name, count)| format!("{name} +{count}")).collect();
    let moved = if moved.is_empty() { "no counter moved".to_owned() } else { moved.join(", ") };
    format!("{moved}; {:?} {}/{}", told.state, told.epoch, told.applied_sequence).to_lowercase()
}
