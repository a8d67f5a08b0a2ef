//! The calibration of simulated rooms in virtual time, judged by the truth.

use std::cell::Cell;

use heliostat_array::calibration_file::CalibrationFile;
use heliostat_calibrate::session::Log;
use heliostat_calibrate::{Stage, Verdict};
use heliostat_channel::MirrorAngles;
use heliostat_core::policy::PolicyKind;
use heliostat_learn::calibrate::live::{
    Run, drive, drive_turned, run, session, walk, with_passer_by, with_receiver, with_spot_error,
};
use heliostat_learn::calibrate::truth::{Errors, judge};
use heliostat_learn::calibrate::{Room, Settings, Study, study};
use heliostat_proto::UserReport;
use heliostat_room::episode::Episode;
use heliostat_scenario::Scenario;

/// A room with rough differences, reports at 20 Hz that are 100 ms old, and one receiver.
fn room(changes: &[&str]) -> Scenario {
    let rates = ["mismatch.level=rough", "streams.channel.rate_hz=20", "streams.positions.rate_hz=20"];
    let rough = Scenario::builtin("hall").unwrap().with_overrides(&rates).unwrap();
    with_receiver(&rough).unwrap().with_overrides(changes).unwrap()
}

/// Calibrates a room, and judges the result.
fn judged(name: &str, scenario: &Scenario, trace: &str, tracker: impl FnMut(&mut UserReport)) -> (Run, Errors) {
    let found = run(scenario, trace, 1, tracker).unwrap();
    let errors = judge(&found.outcome, scenario, 1).unwrap();
    println!("{name}: {} readings, {} reports without use, {errors:?}", found.outcome.readings, found.unused);
    (found, errors)
}

/// The same with the receiver alone, and with the positions as the tracker reports them.
fn judged_alone(name: &str, scenario: &Scenario) -> (Run, Errors) {
    judged(name, scenario, &walk(scenario, ""), unchanged)
}

fn unchanged(_: &mut UserReport) {}

#[test]
fn a_rough_room_is_calibrated_within_the_promised_errors() {
    let (found, errors) = judged_alone("rough", &room(&[]));
    assert!(errors.pointing_deg.iter().all(|error| *error < 0.15), "{errors:?}");
    assert!(errors.led_m < 0.015 && errors.frame_m < 0.01, "{errors:?}");
    assert!(errors.gain > 0.99 && errors.gain > errors.nominal_gain, "{errors:?}");
    assert!(found.outcome.verification.is_improvement() && found.outcome.rejected_places.is_empty());
    let share = errors.covered[0] as f64 / errors.covered[1] as f64;
    assert!((0.9..=1.0).contains(&share), "95 % intervals hold the truth in {share:.3}");
}

#[test]
fn latency_costs_no_report_at_100_reports_a_second() {
    let fast = ["streams.channel.rate_hz=100", "streams.channel.latency_ms=100"];
    let (found, errors) = judged_alone("100 reports/s", &room(&fast));
    assert!(errors.pointing_deg.iter().all(|error| *error < 0.15), "{errors:?}");
    // The mirrors settle within two reports. With a wait for each report a reading would take ten more.
    assert!(found.unused < 2 * found.outcome.readings as u64, "{} of {}", found.unused, found.outcome.readings);
}

#[test]
fn lost_reports_and_a_body_that_passes_do_not_spoil_a_calibration() {
    let lossy = room(&["streams.channel.loss=0.1", "streams.positions.loss=0.1"]);
    let (scenario, trace) = with_passer_by(&lossy).unwrap();
    let (_, errors) = judged("lost reports and a body", &scenario, &trace, unchanged);
    assert!(errors.pointing_deg.iter().all(|error| *error < 0.15), "{errors:?}");
    assert!(errors.gain > 0.985, "{errors:?}");
}

#[test]
fn a_stuck_mirror_is_named_and_gets_no_correction() {
    let (found, errors) = judged_alone("one stuck mirror", &room(&["actuator.stuck_share=0.01"]));
    let named = found.outcome.mirrors_with(Verdict::NotFound);
    assert_eq!(named.len(), 1, "{named:?}");
    let calibration = found.outcome.calibration();
    assert_eq!((calibration.roll.offset_deg[named[0]], calibration.yaw.gain[named[0]]), (0.0, 1.0));
    assert!(errors.pointing_deg.iter().all(|error| *error < 0.15), "{errors:?}");
}

#[test]
fn a_spot_that_the_tracker_reports_in_a_wrong_place_does_not_spoil_a_calibration() {
    let scenario = room(&[]);
    let tracker = with_spot_error(&scenario, 0.3);
    let (found, errors) = judged("a wrong spot", &scenario, &walk(&scenario, ""), tracker);
    assert!(found.searched.contains(&1) || found.outcome.rejected_places == [1], "the second spot is named");
    assert!(errors.pointing_deg.iter().all(|error| *error < 0.2), "{errors:?}");
    assert!(errors.gain > 0.98, "{errors:?}");
}

/// 36 mirrors.
const SMALL: [&str; 2] = ["mirrors.rows=6", "mirrors.columns=6"];

/// The log and the corrections of a calibration of a room, and the same room again.
fn calibrated(scenario: &Scenario) -> (Log, CalibrationFile, Episode) {
    let episode = || Episode::new(scenario, Some(&walk(scenario, "")), 1, 0).unwrap();
    let mut first = episode();
    let mut complete = session(scenario, first.capabilities().next().unwrap()).unwrap();
    drive(&mut complete, &mut first, unchanged, |session| session.stage() == Stage::Ended).unwrap();
    (complete.log(), complete.outcome().unwrap().calibration(), episode())
}

#[test]
fn a_refinement_names_the_mirrors_that_have_turned_and_corrects_them_alone() {
    let scenario = room(&SMALL);
    let (log, corrections, mut again) = calibrated(&scenario);
    let complete = log.readings.len();
    let mut refined = session(&scenario, again.capabilities().next().unwrap()).unwrap();
    refined.refine(log, &corrections).unwrap();
    assert_eq!(refined.stage(), Stage::Await(0));
    // Mirror 7 has turned by 0.8 degrees in roll, mirror 22 by 1 degree in yaw; mirror 33 is stuck.
    let mounts = |angles: &mut MirrorAngles| {
        angles.roll[7] += 0.8_f64.to_radians();
        angles.yaw[22] -= 1.0_f64.to_radians();
        (angles.roll[33], angles.yaw[33]) = (0.5, 0.5);
    };
    let ended = |session: &heliostat_calibrate::Session| session.stage() == Stage::Ended;
    drive_turned(&mut refined, &mut again, unchanged, mounts, ended).unwrap();
    let outcome = refined.outcome().unwrap();
    println!("{} new readings: {:?}", outcome.readings + 40 - complete, outcome.changes);
    let changed: Vec<usize> = outcome.changes.iter().map(|change| change.mirror).collect();
    assert_eq!(changed, [7, 22, 33]);
    assert_eq!((&outcome.changes[2].turned_deg, outcome.mirrors[33].verdict), (&None, Verdict::NotFound));
    assert!(outcome.verification.is_improvement(), "{:?}", outcome.verification.ratio());
    let file = outcome.calibration();
    let [roll, yaw] = [7, 22].map(|mirror| {
        [(&file.roll, &corrections.roll), (&file.yaw, &corrections.yaw)]
            .map(|(new, old)| new.offset_deg[mirror] - old.offset_deg[mirror])
    });
    assert!((roll[0] + 0.8).abs() < 0.2 && roll[1].abs() < 0.3, "{roll:?}");
    assert!(yaw[0].abs() < 0.2 && (yaw[1] - 1.0).abs() < 0.3, "{yaw:?}");
    let others = (0..36).filter(|mirror| !changed.contains(mirror));
    let moved = others.map(|mirror| (file.roll.offset_deg[mirror] - corrections.roll.offset_deg[mirror]).abs());
    assert!(moved.fold(0.0, f64::max) < 0.2, "a mirror that has not turned has another correction");
}

thread_local! {
    /// How many commands were passed.
    static PASSED: Cell<u32> = const { Cell::new(0) };
}

/// Every tenth command comes too late: all mirrors are away still when its light is measured.
fn late(angles: &mut MirrorAngles) {
    PASSED.set(PASSED.get() + 1);
    if PASSED.get().is_multiple_of(10) {
        angles.roll.fill(0.5);
    }
}

#[test]
fn late_commands_at_a_spot_name_no_mirror_that_has_not_turned() {
    let scenario = room(&SMALL);
    let (log, corrections, mut again) = calibrated(&scenario);
    let mut refined = session(&scenario, again.capabilities().next().unwrap()).unwrap();
    refined.refine(log, &corrections).unwrap();
    let mounts = |angles: &mut MirrorAngles| {
        angles.roll[7] += 0.8_f64.to_radians();
        late(angles);
    };
    let next = |session: &heliostat_calibrate::Session| session.stage() == Stage::Await(1);
    drive_turned(&mut refined, &mut again, unchanged, mounts, next).unwrap();
    let changed: Vec<usize> = refined.changes().iter().map(|change| change.mirror).collect();
    assert_eq!(changed, [7]);
}

#[test]
fn a_refinement_of_an_unchanged_room_ends_without_a_change_and_without_a_verification() {
    let scenario = room(&SMALL);
    let (log, corrections, mut again) = calibrated(&scenario);
    let capabilities = again.capabilities().next().unwrap();
    let mut other = corrections.clone();
    other.roll.offset_deg.iter_mut().for_each(|offset| *offset += 0.5);
    let refusal = session(&scenario, capabilities.clone()).unwrap().refine(log.clone(), &other).unwrap_err();
    assert!(refusal.to_string().contains("other corrections than those in use"), "{refusal}");
    let mut refined = session(&scenario, capabilities.clone()).unwrap();
    refined.refine(log.clone(), &corrections).unwrap();
    let busy_s = drive(&mut refined, &mut again, unchanged, |session| session.stage() == Stage::Ended).unwrap();
    let outcome = refined.outcome().unwrap();
    println!("unchanged: {} new readings, {busy_s:.0} s", outcome.readings - log.readings.len());
    assert_eq!(outcome.changes, []);
    assert!(outcome.verification.nominal.is_empty() && outcome.rejected_places.is_empty());
    assert!((1..=36).contains(&outcome.measured), "{}", outcome.measured);
    // The readings of a refinement continue that refinement only, and start the next one.
    let kept = refined.log();
    let refusal = session(&scenario, capabilities.clone()).unwrap().resume(kept.clone()).unwrap_err();
    assert!(refusal.to_string().contains("not of this refinement"), "{refusal}");
    let mut continued = session(&scenario, capabilities.clone()).unwrap();
    continued.refine(log, &corrections).unwrap();
    continued.resume(kept.clone()).unwrap();
    assert_eq!(continued.readings().len(), kept.readings.len());
    // All places are complete, so there is nothing to verify after an interruption either.
    assert_eq!(continued.stage(), Stage::Ended);
    assert_eq!(continued.outcome().unwrap().changes, []);
    session(&scenario, capabilities).unwrap().refine(kept, &outcome.calibration()).unwrap();
}

#[test]
fn a_moved_led_rejects_the_spots_of_a_refinement_and_no_mirror() {
    let scenario = room(&SMALL);
    let (log, corrections, mut again) = calibrated(&scenario);
    let mut refined = session(&scenario, again.capabilities().next().unwrap()).unwrap();
    refined.refine(log, &corrections).unwrap();
    // All mirrors are off by the same angle, as after a move of the LED.
    let mounts = |angles: &mut MirrorAngles| angles.roll.iter_mut().for_each(|roll| *roll += 0.6_f64.to_radians());
    let ended = |session: &heliostat_calibrate::Session| session.stage() == Stage::Ended;
    drive_turned(&mut refined, &mut again, unchanged, mounts, ended).unwrap();
    let outcome = refined.outcome().unwrap();
    assert_eq!((outcome.rejected_places.as_slice(), outcome.changes.len()), (&[0, 1, 2][..], 0));
    // The former calibration still knows its mirrors, but this session has compared none with it.
    assert!(outcome.measured == 0 && !outcome.mirrors_with(Verdict::Calibrated).is_empty());
}

#[test]
fn a_room_as_described_gets_no_calibration() {
    let exact = room(&["mismatch.level=none", "streams.positions.noise_m=0.01"]);
    let found = run(&exact, &walk(&exact, ""), 1, unchanged).unwrap();
    assert!(!found.outcome.verification.is_improvement(), "{:?}", found.outcome.verification.ratio());
}

#[test]
fn a_session_continues_from_its_log() {
    let scenario = room(&[]);
    let mut episode = Episode::new(&scenario, Some(&walk(&scenario, "")), 1, 0).unwrap();
    let capabilities = episode.capabilities().next().unwrap();
    let mut first = session(&scenario, capabilities.clone()).unwrap();
    drive(&mut first, &mut episode, unchanged, |session| session.stage() == Stage::Await(1)).unwrap();
    let log = first.log();
    assert_eq!((log.complete, log.spots.len()), (1, 1));
    let mut second = session(&scenario, capabilities).unwrap();
    second.resume(log.clone()).unwrap();
    assert_eq!((second.stage(), second.readings()), (Stage::Await(1), first.readings()));
    let other = Log { mirrors: 9, ..log };
    assert!(second.resume(other).unwrap_err().to_string().contains("expected 100"));
}

#[test]
fn the_log_holds_a_place_as_complete_before_its_estimate() {
    let scenario = room(&SMALL);
    let mut episode = Episode::new(&scenario, Some(&walk(&scenario, "")), 1, 0).unwrap();
    let capabilities = episode.capabilities().next().unwrap();
    let mut first = session(&scenario, capabilities.clone()).unwrap();
    drive(&mut first, &mut episode, unchanged, heliostat_calibrate::Session::is_estimate_due).unwrap();
    let log = first.log();
    assert_eq!((first.stage(), log.complete), (Stage::Probe(0), 1));
    let mut second = session(&scenario, capabilities).unwrap();
    second.resume(log).unwrap();
    first.run_estimate();
    assert_eq!((first.stage(), second.stage()), (Stage::Await(1), Stage::Await(1)));
    assert_eq!(first.readings(), second.readings());
}

/// A study of a small array, with these changes of the scenario.
fn small_study(changes: &[&str]) -> anyhow::Result<Study> {
    study(&small_settings(changes))
}

fn small_settings(changes: &[&str]) -> Settings {
    let size = ["mismatch.level=rough", "mirrors.rows=4", "mirrors.columns=4"];
    let scenario = Scenario::builtin("hall").unwrap().with_overrides(&[&size[..], changes].concat()).unwrap();
    Settings {
        scenario,
        array: 0,
        seeds: 2,
        episodes: 1,
        policy: PolicyKind::Greedy,
        reports_hz: 20.0,
        has_passer_by: false,
        spot_error_m: 0.0,
    }
}

#[test]
fn a_calibrated_room_has_a_higher_sum_rate_in_closed_loop() {
    let study = small_study(&[]).unwrap();
    let [row] = &study.rows;
    assert!(row.calibrated_ratio.mean > row.assumed_ratio.mean, "{study:?}");
    assert_eq!((row.written, study.rooms.len()), (2, 2), "{study:?}");
}

#[test]
fn a_study_counts_the_rooms_in_which_a_wrong_spot_is_searched_or_rejected() {
    let wrong = Settings { has_passer_by: true, spot_error_m: 0.5, ..small_settings(&[]) };
    let study = study(&wrong).unwrap();
    assert_eq!((study.has_passer_by, study.spot_error_m), (true, 0.5));
    let is_named = |room: &Room| room.searched_spots + room.rejected_spots > 0;
    assert!(study.rooms.iter().all(is_named), "{study:?}");
    assert!(study.rows[0].searched + study.rows[0].rejected >= study.rooms.len(), "{study:?}");
}

#[test]
fn arrivals_are_refused_with_what_a_calibration_needs() {
    let arrivals = ["users.arrivals.rate_per_min=6", "users.arrivals.mean_stay_s=30", "users.arrivals.max_users=9"];
    let refusal = small_study(&arrivals).unwrap_err().to_string();
    assert!(refusal.contains("users.arrivals") && refusal.contains("a fixed number of users"), "{refusal}");
}

#[test]
fn of_a_list_of_minimum_rates_the_carried_receiver_has_the_first() {
    let changes = ["users.count=3", "users.min_rate_mbps=[4.0, 2.0, 1.0]"];
    let listed = Scenario::builtin("hall").unwrap().with_overrides(&changes).unwrap();
    assert_eq!(with_receiver(&listed).unwrap().min_rate_bps(), [4e6]);
}

#[test]
fn a_calibration_ends_although_no_mirror_lights_the_first_place() {
    // The later places then have nothing to agree with.
    let scenario = room(&[]);
    let found = run(&scenario, &walk(&scenario, ""), 85_896_010_399_745, unchanged).expect("an end");
    assert!(!found.outcome.mirrors_with(Verdict::Calibrated).is_empty() || !found.outcome.rejected_places.is_empty());
}
