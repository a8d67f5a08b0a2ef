//! What the user of `heliostat calibrate` reads.

use anyhow::Result;
use heliostat_calibrate::signal::Signal;
use heliostat_calibrate::{Change, Measured, Outcome, Progress, Session, Stage, Verdict};
use heliostat_proto::gauges::CalibrationProgress;
use heliostat_service::outln;
use heliostat_service::output::note;
use serde_json::json;

use super::args::Args;
use super::conditions::STRONGER;

/// Mirrors that a line names; the others are counted.
const NAMED: usize = 12;

/// A reported position that differs by less, in m, is no new one.
const MOVED_M: f64 = 0.1;

/// Whether a stage is said now: what the mirrors do is said only while this process commands them.
pub fn is_stage_said(stage: Stage, is_commanding: bool) -> bool {
    is_commanding || matches!(stage, Stage::Await(_) | Stage::Ended)
}

/// Says what the holder of the receiver has to do, or what begins.
pub fn stage(session: &Session) {
    let place = session.place().and_then(|place| place.floor_m).unwrap_or_default();
    let [x, y] = place;
    match session.stage() {
        Stage::Await(index) => note(format_args!(
            "carry the receiver to {}, x {x:.2} m, y {y:.2} m, face the mirrors and stand still",
            place_name(index, session.spot_count())
        )),
        Stage::Dark(_) => note("stay: all mirrors are turned away, for the dark readings"),
        Stage::Probe(index) => {
            note(format_args!("stay: the mirrors are probed at spot {}", index + 1));
            let group = session.group();
            if group > 1 {
                note(format_args!(
                    "the light of a mirror here is weaker than three times the noise of a reading: half of a group of \
                     {group} mirrors is lit at a time"
                ));
            }
            if let Some(signal) = session.signal().filter(Signal::is_weak) {
                note(format_args!(
                    "the light of a mirror here is {:.1} times the noise of its readings: few mirrors will be \
                     located, in about {:.0} min; {STRONGER}",
                    signal.ratio,
                    session.progress().remaining_s / 60.0
                ));
            }
        }
        Stage::Locate(index) => note(format_args!(
            "stay: few mirrors light spot {}, so the spot is not where the tracker reports it; it is searched",
            index + 1
        )),
        Stage::Verify => note("stay: nominal and calibrated aims are compared"),
        Stage::Ended => note("the readings are complete"),
    }
}

/// Where a receiver stands by its reports, without the noise of the tracker and the points of a walk.
#[derive(Debug, Default)]
pub struct SteadyPosition {
    shown_m: Option<[f64; 2]>,
    last_m: Option<[f64; 2]>,
}

impl SteadyPosition {
    /// The position that was shown, until the receiver stands more than [`MOVED_M`] from it: two calls have then about
    /// the same position.
    fn follow(&mut self, reported_m: Option<[f64; 2]>) -> Option<[f64; 2]> {
        let is_near = |before: Option<[f64; 2]>| {
            let pair = before.zip(reported_m);
            pair.is_some_and(|([x, y], [at_x, at_y])| (at_x - x).hypot(at_y - y) <= MOVED_M)
        };
        let is_new = self.shown_m.is_none() || reported_m.is_none();
        if is_new || (is_near(self.last_m) && !is_near(self.shown_m)) {
            self.shown_m = reported_m;
        }
        self.last_m = reported_m;
        self.shown_m
    }
}

/// What a calibration waits for until the receiver stands where it shall.
pub fn waits_for_receiver(session: &Session, position: &mut SteadyPosition) -> Option<String> {
    let Stage::Await(index) = session.stage() else {
        *position = SteadyPosition::default();
        return None;
    };
    let [x, y] = session.place()?.floor_m?;
    Some(waits(&place_name(index, session.spot_count()), [x, y], position.follow(session.receiver_m())))
}

/// Why the channel reports are of no use, if their gains are those of no light.
pub fn impossible_gains(session: &Session) -> Option<String> {
    let [direct, mirrors] = session.impossible_gains()?;
    Some(format!(
        "the receiver reports the gains {direct} and {mirrors}, which are of no use: expected shares of an LED's light, \
         from -1 to 1; correct its scale"
    ))
}

fn waits(place: &str, [x, y]: [f64; 2], receiver_m: Option<[f64; 2]>) -> String {
    let reported = match receiver_m {
        Some([at_x, at_y]) => format!(
            "the tracker reports it at x {at_x:.1} m, y {at_y:.1} m, {:.1} m from there",
            (at_x - x).hypot(at_y - y)
        ),
        None => "no position report names it".to_owned(),
    };
    format!("waits until the receiver stands still at {place}, x {x:.2} m, y {y:.2} m: {reported}")
}

/// A place of the walk; the last one, after the spots, is that of the verification.
fn place_name(index: usize, spots: usize) -> String {
    if index < spots { format!("spot {} of {spots}", index + 1) } else { "the place of the verification".to_owned() }
}

/// One line of progress.
pub fn progress(progress: &Progress) -> String {
    let Progress { stage, located: (located, mirrors), readings, unused, remaining_s } = *progress;
    // Mirrors are located at each spot again; the readings are those of all spots.
    let at_spot = match stage {
        Stage::Probe(index) => format!("{located} of {mirrors} mirrors located at spot {}, ", index + 1),
        _ => String::new(),
    };
    format!(
        "{at_spot}{readings} readings in all, {unused} reports without use, about {remaining_s:.0} s without the walks"
    )
}

/// Lines that are printed again only when they have changed.
#[derive(Debug, Default)]
pub struct Changing(Vec<String>);

impl Changing {
    /// The lines that differ from those of the last call.
    pub fn changed(&mut self, lines: Vec<String>) -> Vec<String> {
        let before = std::mem::replace(&mut self.0, lines);
        self.0.iter().filter(|line| !before.contains(line)).cloned().collect()
    }
}

/// How far the session is, for the viewers of the room.
pub fn progress_of(progress: &Progress, spots: usize) -> CalibrationProgress {
    let Progress { stage, located: (located, mirrors), remaining_s, .. } = *progress;
    let places = spots + 1;
    let index = match stage {
        Stage::Await(index) | Stage::Dark(index) | Stage::Probe(index) | Stage::Locate(index) => index,
        Stage::Verify | Stage::Ended => places - 1,
    };
    let count = |number: usize| u32::try_from(number).unwrap_or(u32::MAX);
    CalibrationProgress {
        place: count(index + 1),
        places: count(places),
        is_waiting: matches!(stage, Stage::Await(_)),
        is_computing: false,
        located: count(located),
        mirrors: count(mirrors),
        remaining_s,
    }
}

/// The result.
pub fn outcome(args: &Args, outcome: &Outcome, is_written: bool) -> Result<()> {
    if args.json {
        return json(args, outcome, is_written);
    }
    let count = |verdict| outcome.mirrors_with(verdict).len();
    outln!("mirrors        {} of {} calibrated", count(Verdict::Calibrated), outcome.mirrors.len())?;
    for (verdict, advice) in [
        (Verdict::NeedsSpot, "known at the spots only: repeat with another spot, away from these"),
        (Verdict::NotFound, "no light at any spot: stuck, covered, or mounted far off; check them"),
        (Verdict::Inconsistent, "their readings contradict one another: check their drives"),
        (Verdict::Unusable, "the array reports that they do not follow"),
    ] {
        let mirrors = outcome.mirrors_with(verdict);
        if !mirrors.is_empty() {
            outln!("               {} -> {advice}", list(&mirrors))?;
        }
    }
    let known = outcome.mirrors.iter().filter(|mirror| mirror.verdict == Verdict::Calibrated);
    let worst = known.map(|mirror| mirror.pointing_deg[0].max(mirror.pointing_deg[1])).fold(0.0, f64::max);
    outln!(
        "pointing       {worst:.2} degrees, the largest standard deviation of a calibrated mirror elsewhere in the room"
    )?;
    for (index, led) in outcome.leds_m.iter().enumerate() {
        let [x, y, z] = led.each_ref().map(|coordinate| plus_minus(coordinate, 3));
        outln!("LED {index}          x {x}, y {y}, z {z} m")?;
    }
    outln!("semi-angle     {} degrees", plus_minus(&outcome.semi_angle_deg, 1))?;
    outln!("frame          {} m higher than in the scenario", plus_minus(&outcome.raise_m, 3))?;
    let [x, y] = outcome.shift_m.each_ref().map(|shift| plus_minus(shift, 3));
    outln!("tracker        its origin is off by x {x}, y {y} m")?;
    if let Some([position, velocity]) = outcome.tracker_noise {
        outln!(
            "noise          {position:.3} m of a position, {velocity:.3} m/s of a velocity, {:.1} % of a gain",
            100.0 * outcome.channel_noise
        )?;
    }
    outln!(
        "detector       factor {}; reflectivity factor {}",
        plus_minus(&outcome.detector_factor, 3),
        plus_minus(&outcome.reflectivity_factor, 3)
    )?;
    rejected(outcome)?;
    let ratio = outcome.verification.ratio();
    outln!("verification   {} times the light of the nominal aims", plus_minus(&ratio, 3))?;
    outln!("readings       {}", readings(outcome))?;
    if is_written { written(args) } else { Ok(()) }
}

/// The result of a refinement: what has changed, how sure, and whether files are written.
pub fn refinement(args: &Args, outcome: &Outcome, is_written: bool) -> Result<()> {
    if args.json {
        return json(args, outcome, is_written);
    }
    let (measured, all, changed) = (outcome.measured, outcome.mirrors.len(), outcome.changes.len());
    outln!("mirrors        {measured} of {all} compared with the former calibration, {changed} changed")?;
    for Change { mirror, turned_deg } in &outcome.changes {
        match turned_deg {
            Some(turned) => {
                let [roll, yaw] = turned.each_ref().map(|turned| plus_minus(turned, 2));
                outln!("mirror {mirror:<8}turned by roll {roll}, yaw {yaw} degrees")?;
            }
            None => outln!("mirror {mirror:<8}shows no light any more -> stuck, covered, or turned far off; check it")?,
        }
    }
    rejected(outcome)?;
    outln!("readings       {}", readings(outcome))?;
    if is_written {
        outln!("verification   {} times the light of the former aims", plus_minus(&outcome.verification.ratio(), 3))?;
        return written(args);
    }
    outln!("written        nothing: the calibration in use stays as it is")?;
    Ok(())
}

fn json(args: &Args, outcome: &Outcome, is_written: bool) -> Result<()> {
    let [calibration, room] = [&args.out, &args.room_out]
        .map(|file| file.as_ref().filter(|_| is_written).map(|path| path.display().to_string()));
    outln!("{}", json!({ "outcome": outcome, "calibration": calibration, "room": room }))?;
    Ok(())
}

/// The readings, and how many of them are from groups of mirrors.
fn readings(outcome: &Outcome) -> String {
    let grouped = if outcome.grouped > 0 { format!(", {} of them in groups", outcome.grouped) } else { String::new() };
    format!("{}{grouped}", outcome.readings)
}

fn rejected(outcome: &Outcome) -> Result<()> {
    for place in &outcome.rejected_places {
        outln!(
            "spot {}         rejected: most mirrors contradict it -> check its height and the tracker there",
            place + 1
        )?;
    }
    Ok(())
}

fn written(args: &Args) -> Result<()> {
    let files = [&args.out, &args.room_out].into_iter().flatten().map(|path| path.display().to_string());
    outln!("written        {}", files.collect::<Vec<_>>().join(", "))?;
    Ok(())
}

/// The value and the 95 % interval.
pub fn plus_minus(measured: &Measured, digits: usize) -> String {
    let half = heliostat_calibrate::outcome::QUANTILE_95 * measured.deviation;
    format!("{:.digits$} ± {half:.digits$}", measured.value)
}

/// The first indices, and how many more there are.
fn list(mirrors: &[usize]) -> String {
    let named: Vec<String> = mirrors.iter().take(NAMED).map(usize::to_string).collect();
    let more = mirrors.len().saturating_sub(NAMED);
    let rest = if more > 0 { format!(" and {more} more") } else { String::new() };
    let word = if mirrors.len() == 1 { "mirror" } else { "mirrors" };
    format!("{word} {}{rest}", named.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_progress_names_the_spot_of_its_mirrors_and_counts_all_readings() {
        let at = |stage| Progress { stage, located: (0, 100), readings: 948, unused: 12, remaining_s: 41.2 };
        let in_all = "948 readings in all, 12 reports without use, about 41 s without the walks";
        assert_eq!(progress(&at(Stage::Probe(1))), format!("0 of 100 mirrors located at spot 2, {in_all}"));
        assert_eq!(progress(&at(Stage::Await(1))), in_all);
    }

    #[test]
    fn a_wait_names_the_place_and_where_the_receiver_is_reported() {
        assert_eq!(
            waits(&place_name(1, 3), [1.4, 0.5], Some([-1.62, 0.46])),
            "waits until the receiver stands still at spot 2 of 3, x 1.40 m, y 0.50 m: \
             the tracker reports it at x -1.6 m, y 0.5 m, 3.0 m from there"
        );
        let unseen = waits(&place_name(3, 3), [0.0, 0.0], None);
        assert!(unseen.contains("at the place of the verification, x 0.00 m"), "{unseen}");
        assert!(unseen.ends_with("no position report names it"), "{unseen}");
    }

    #[test]
    fn a_reported_position_is_a_new_one_only_when_the_receiver_stands_elsewhere() {
        let mut position = SteadyPosition::default();
        let reported = [[-1.52, 0.84], [-1.46, 0.79], [-1.56, 0.86], [-1.3, 0.84], [-1.25, 0.84]];
        let shown: Vec<_> = reported.into_iter().map(|at| position.follow(Some(at))).collect();
        let [first, moved] = [Some([-1.52, 0.84]), Some([-1.25, 0.84])];
        assert_eq!(shown, [first, first, first, first, moved]);
        for walked in [[-0.5, 0.8], [0.5, 0.8], [1.5, 0.8]] {
            assert_eq!(position.follow(Some(walked)), moved, "a walk has no line of its own");
        }
        assert_eq!(position.follow(None), None, "no report names it any longer");
    }

    #[test]
    fn what_the_mirrors_do_is_said_only_while_they_are_commanded() {
        for stage in [Stage::Dark(0), Stage::Probe(0), Stage::Locate(0), Stage::Verify] {
            assert_eq!([false, true].map(|is_commanding| is_stage_said(stage, is_commanding)), [false, true]);
        }
        assert!(is_stage_said(Stage::Await(0), false) && is_stage_said(Stage::Ended, false));
    }

    #[test]
    fn a_line_is_printed_again_only_when_it_has_changed() {
        let mut shown = Changing::default();
        let mut changed = |lines: &[&str]| shown.changed(lines.iter().map(|line| (*line).to_owned()).collect());
        assert_eq!(changed(&["948 readings", "waits"]), ["948 readings", "waits"]);
        assert_eq!(changed(&["948 readings", "waits"]), [""; 0]);
        assert_eq!(changed(&["949 readings", "waits"]), ["949 readings"]);
        assert_eq!(changed(&["949 readings"]), [""; 0]);
        assert_eq!(changed(&["949 readings", "waits"]), ["waits"], "it waits again");
    }
}
