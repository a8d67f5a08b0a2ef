//! Plans that found a defect, reduced to what it needs.

use heliostat_simulation::plan::{Attack, DiskAfterCrash, Fault, OptionalReports, RearmBy, Role, Setup, Timed};
use heliostat_simulation::{Outcome, run_plan};

fn at(at_ms: u64, for_ms: u64, fault: Fault) -> Timed {
    Timed { at_ms, for_ms, fault }
}

/// Runs faults in the room of a seed, with changes.
fn holds(seed: u64, change: impl FnOnce(&mut Setup), faults: &[Timed]) -> Outcome {
    // The reports with which the defect was found.
    let mut setup = Setup { reports: OptionalReports::default(), ..Setup::draw(seed) };
    change(&mut setup);
    let outcome = run_plan(&setup, faults);
    if let Some(violation) = &outcome.violation {
        panic!("{violation}\n{setup:?}\n{}", outcome.trace.join("\n"));
    }
    outcome
}

/// The stop that arrived again took the place of the later one, so that the re-arm of the earlier one
/// released the array.
#[test]
fn a_stop_that_arrives_again_does_not_replace_a_later_one() {
    let link = (Role::Operator, Role::Array(0));
    for seed in [336, 565, 596, 1244] {
        let faults = [
            at(2000, 3000, Fault::Duplicate { from: link.0, to: link.1, per_mille: 1000 }),
            at(2000, 3000, Fault::Reorder { from: link.0, to: link.1, ms: 250 }),
            at(2100, 0, Fault::Stop),
            at(2500, 0, Fault::Rearm(RearmBy::Name)),
            at(2600, 0, Fault::Stop),
            at(2620, 0, Fault::Stop),
            at(3200, 0, Fault::Rearm(RearmBy::Name)),
        ];
        holds(seed, |setup| setup.arrays = 1, &faults);
    }
}

/// Each earlier stop of the operator came back after the release of the later one, from a controller that
/// had been cut off.
#[test]
fn the_release_of_a_stop_ends_the_earlier_ones_of_its_sender() {
    let cut_off = |others: &[Role]| others.iter().map(|other| (Role::Controller(0), *other)).collect::<Vec<_>>();
    let everyone = [Role::Tracker, Role::Array(0), Role::Array(1), Role::Controller(1), Role::Operator];
    let faults = [
        at(1905, 930, Fault::Crash { host: Role::Array(0), disk: DiskAfterCrash::Lost }),
        at(2002, 2562, Fault::Partition { pairs: cut_off(&[Role::Array(1)]), holds: false }),
        at(2174, 0, Fault::Stop),
        at(2690, 0, Fault::Stop),
        at(3512, 0, Fault::Stop),
        at(4208, 5861, Fault::Partition { pairs: cut_off(&everyone), holds: false }),
        at(5547, 0, Fault::Stop),
    ];
    holds(20027, |setup| (setup.arrays, setup.controllers) = (2, 2), &faults);
}

/// A controller whose epoch was above the followed one already fell back to an epoch by UTC, below it.
#[test]
fn a_new_epoch_is_above_the_followed_one_also_where_the_own_one_is() {
    let (from, to) = (Role::Controller(0), Role::Array(0));
    let faults = [
        at(2000, 30, Fault::Attack(Attack::HigherEpoch)),
        at(5000, 3000, Fault::Loss { from, to, per_mille: 1000 }),
        at(5000, 3000, Fault::Attack(Attack::NotANumber)),
    ];
    holds(1, |setup| (setup.arrays, setup.controllers) = (1, 1), &faults);
}

/// Between the safety report and the stop report of a stop, the replay withheld a command that the
/// controller gave.
#[test]
fn a_replay_from_a_state_repeats_the_command_beside_a_stop() {
    holds(5_000_829, |_| {}, &[at(2240, 0, Fault::Stop)]);
}

/// The replay took a forged report, which the controller had refused, for the real one with its number.
#[test]
fn a_replay_repeats_the_real_one_of_two_reports_with_one_number() {
    let faults = [
        at(1535, 92, Fault::Crash { host: Role::Array(0), disk: DiskAfterCrash::Kept }),
        at(3284, 264, Fault::Attack(Attack::OutsideUsers)),
        at(3499, 533, Fault::Freeze { host: Role::Controller(1) }),
    ];
    holds(1_795_656_660_707_793, |_| {}, &faults);
}

/// The check of angles took no time to have passed where the clock of the controller was set back by an hour.
#[test]
fn a_controller_whose_clock_is_set_back_turns_parked_mirrors() {
    let faults = [
        at(2830, 5942, Fault::ClockStep { host: Role::Controller(0), ms: 3_600_000 }),
        at(4458, 6080, Fault::Crash { host: Role::Controller(1), disk: DiskAfterCrash::Kept }),
        at(5317, 1006, Fault::ClockStep { host: Role::Tracker, ms: 3_600_000 }),
    ];
    holds(1_795_656_659_685_390, |_| {}, &faults);
}

/// A record of several stops that was cut off between two of them was read as one of fewer stops.
#[test]
fn a_record_of_several_stops_that_is_cut_off_is_an_unknown_state() {
    let host = Role::Array(0);
    let faults = [
        at(2724, 0, Fault::Stop),
        at(2926, 300, Fault::Crash { host, disk: DiskAfterCrash::Lost }),
        at(5353, 2235, Fault::Attack(Attack::ForeignStop)),
        at(5457, 5242, Fault::Crash { host, disk: DiskAfterCrash::Torn }),
    ];
    holds(9_000_961, |_| {}, &faults);
}

/// The operator released stops for the last time 13 ms before the array, whose connection had waited for a
/// retransmission, reported the one with which it had started.
#[test]
fn an_operator_releases_the_stop_of_an_array_that_reports_it_late() {
    let (host, pairs) = (Role::Array(0), vec![(Role::Array(0), Role::Operator)]);
    let faults = [
        at(4572, 3446, Fault::Partition { pairs, holds: false }),
        at(4736, 2594, Fault::Crash { host, disk: DiskAfterCrash::Torn }),
    ];
    holds(1_795_748_588_036_993, |_| {}, &faults);
}

/// Forged telemetry with the highest epoch of all, and then with its sequence, made the controller take an epoch
/// again under which it had commanded before, and number from 1.
#[test]
fn a_controller_that_returns_to_an_epoch_gives_no_number_twice() {
    let faults =
        [at(2479, 2508, Fault::Attack(Attack::OwnTelemetry)), at(2845, 1189, Fault::Attack(Attack::FarSequence))];
    let reports = OptionalReports { obstacles: false, orientation: true, leds: true };
    let room = |setup: &mut Setup| (setup.reports, setup.arrays, setup.controllers) = (reports, 2, 3);
    holds(1_795_684_090_581_523, room, &faults);
}

/// The controllers missed the end of a calibration that ended before telemetry showed its lead.
#[test]
fn the_lead_of_a_calibration_that_ends_at_once_returns_at_once() {
    for for_ms in [60, 250, 1000] {
        let room = |setup: &mut Setup| setup.controllers = 2;
        holds(1341, room, &[at(2465, for_ms, Fault::Calibrate { array: 0 })]);
    }
}

/// No standby takes the room from a calibration that leads, and the lead returns without a takeover.
#[test]
fn a_calibration_beside_standbys_probes_mirrors_until_it_gives_the_lead_back() {
    let mut probed = 0;
    for seed in 0..5 {
        let room = |setup: &mut Setup| {
            (setup.arrays, setup.controllers, setup.rate_hz) = (1, 3, 100);
            (setup.has_channel, setup.is_reserve) = (true, true);
        };
        let occurred = holds(seed, room, &[at(3000, 5000, Fault::Calibrate { array: 0 })]).occurred;
        for expected in ["calibration:led", "superseded", "resumed"] {
            assert!(occurred.contains(expected), "seed {seed} lacks {expected}: {occurred:?}");
        }
        probed += u64::from(occurred.contains("calibration:probed"));
    }
    // In some seeds the holder of the receiver leaves.
    assert!(probed > 2, "{probed} calibrations have probed a mirror");
}

/// A standby whose link returned after the lease commanded before it had telemetry or the token of the leader again.
#[test]
fn a_standby_whose_link_returns_leaves_the_lead_to_a_leader_that_lost_nothing() {
    let others = [Role::Tracker, Role::Array(0), Role::Controller(0), Role::Operator];
    let pairs: Vec<_> = others.map(|other| (Role::Controller(1), other)).into();
    for (seed, for_ms) in (0..5).flat_map(|seed| [980, 1300, 7000].map(|for_ms| (seed, for_ms))) {
        for repeats_in_silence in [false, true] {
            let room = |setup: &mut Setup| {
                (setup.arrays, setup.controllers, setup.rate_hz, setup.is_reserve) = (1, 2, 100, true);
                setup.repeats_in_silence = repeats_in_silence;
            };
            let cut_off = Fault::Partition { pairs: pairs.clone(), holds: false };
            let occurred = holds(seed, room, &[at(3000, for_ms, cut_off)]).occurred;
            for unexpected in ["took-over", "resumed", "contested"] {
                assert!(!occurred.contains(unexpected), "seed {seed}, {for_ms} ms, {repeats_in_silence}: {occurred:?}");
            }
        }
    }
}

/// Telemetry that showed the answer came before the report to the only other controller, and the next one was sampled
/// before the next answer: a report seemed unanswered, and the controller took the room from the calibration.
#[test]
fn a_calibration_that_answers_before_the_report_arrives_elsewhere_keeps_the_lead() {
    let faults = [at(3607, 2953, Fault::Calibrate { array: 0 })];
    holds(1_795_840_214_469_041, |_| {}, &faults);
}

/// The token of the tracker ended between its last report and the decision of a slow policy.
#[test]
fn a_decision_after_the_end_of_its_tracker_is_replayed_from_a_state() {
    let faults = [
        at(1597, 21, Fault::ReceiversSilent),
        at(1662, 1994, Fault::SlowPolicy { controller: 0, ms: 30 }),
        at(3311, 255, Fault::Crash { host: Role::Tracker, disk: DiskAfterCrash::Kept }),
    ];
    let room = |setup: &mut Setup| setup.reports = OptionalReports { leds: true, ..OptionalReports::default() };
    holds(1_795_840_211_457_411, room, &faults);
}

/// Reports waited for a standby that did not run for a moment. Telemetry had shown their answers before it decided, so
/// that it awaited a further answer, and took over from a leader that had answered each report.
#[test]
fn a_standby_that_pauses_leaves_the_lead_to_a_leader_that_answers_each_report() {
    let others = [Role::Tracker, Role::Array(0), Role::Controller(0)];
    let pairs = others.map(|other| (other, Role::Controller(1))).into();
    // The link of the standby's host returns, and then the standby is late again and again.
    let returns = at(3000, 2000, Fault::Partition { pairs, holds: false });
    let pauses =
        (0..60).map(|index| at(6000 + 233 * index, 5 + index % 41, Fault::Freeze { host: Role::Controller(1) }));
    let faults: Vec<Timed> = std::iter::once(returns).chain(pauses).collect();
    for (seed, (rate_hz, telemetry_hz)) in (0..5).flat_map(|seed| [(20, 100), (10, 20)].map(|rates| (seed, rates))) {
        let room = |setup: &mut Setup| {
            (setup.arrays, setup.controllers, setup.is_reserve, setup.has_ranks) = (1, 2, true, false);
            (setup.rate_hz, setup.telemetry_hz) = (rate_hz, telemetry_hz);
        };
        let occurred = holds(seed, room, &faults).occurred;
        for unexpected in ["took-over", "contested"] {
            assert!(!occurred.contains(unexpected), "seed {seed}, {rate_hz} reports a second: {occurred:?}");
        }
    }
}

/// In a room whose telemetry is as rare as its reports, a standby took the room from a leader that answered one report
/// 20 ms late: telemetry always came 15 ms after a report, and nothing later was judged.
#[test]
fn a_leader_that_is_late_once_keeps_the_lead_where_telemetry_comes_shortly_before_the_next_report() {
    for (seed, (after_ms, is_lost)) in (0..5).flat_map(|seed| [(15, true), (37, false)].map(|case| (seed, case))) {
        let room = |setup: &mut Setup| {
            (setup.arrays, setup.controllers, setup.is_reserve, setup.has_ranks) = (1, 2, true, false);
            (setup.rate_hz, setup.telemetry_hz) = (20, 20);
        };
        // Reports come each 50 ms from the start. Telemetry comes so long after them once the array has paused.
        let faults = [
            at(1990, 10 + after_ms, Fault::Freeze { host: Role::Array(0) }),
            at(6040, 30, Fault::Freeze { host: Role::Controller(0) }),
        ];
        let occurred = holds(seed, room, &faults).occurred;
        assert_eq!(occurred.contains("contested"), is_lost, "seed {seed}, {after_ms} ms: {occurred:?}");
    }
}

/// Rare telemetry came between the time at which a report was due and its arrival, and showed the commands of before. A
/// standby compared the next telemetry with those before them, and took this for an answer of a leader that was frozen.
#[test]
fn telemetry_that_comes_while_a_report_is_on_its_way_delays_no_takeover() {
    let faults = [at(2860, 2500, Fault::Freeze { host: Role::Controller(0) })];
    holds(1_795_884_633_175_214, |_| {}, &faults);
}

/// The first controller, which has no given rank, was back beside the one of rank 2, and had the same rank by its source
/// id: none had rank 1, and a gap of two report intervals was expected.
#[test]
fn standbys_of_one_rank_that_is_not_the_first_take_over_too() {
    let crash = |host| Fault::Crash { host, disk: DiskAfterCrash::Kept };
    let faults = [at(1512, 424, crash(Role::Controller(0))), at(4582, 5331, crash(Role::Controller(1)))];
    let outcome = holds(67_224_025_747_932_474, |_| {}, &faults);
    assert!(outcome.occurred.contains("took-over"), "{:?}", outcome.occurred);
}
