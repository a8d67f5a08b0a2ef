//! A standby that loses its link, and with it reports, telemetry and the tokens of the others.

use std::collections::VecDeque;

use heliostat_proto::Stamp;

use super::*;

/// A controller gets nothing for 3 s. When its link returns, the token of the other one is not back yet.
fn cut_off(room: &mut Room, index: usize, other: u64) {
    let controller = &mut room.controllers[index];
    controller.events.extend(controller.tenure.handle_controller(other, false));
    controller.is_alive = false;
    room.run(3 * S);
    room.controllers[index].is_alive = true;
}

#[test]
fn a_standby_whose_link_returns_leaves_the_lead_to_a_leader_that_answers() {
    let mut room = led_room(&[1, 600]);
    cut_off(&mut room, 1, 1);
    room.run(100 * MS);
    room.announce(1, true);
    room.run(S);
    assert_eq!(room.standings(), [Standing::Leading, Standing::Standby]);
    assert_eq!(room.controllers[1].events, [TenureEvent::StoodBy]);
}

#[test]
fn a_standby_whose_link_returns_replaces_a_leader_that_has_ended_at_the_first_unanswered_report() {
    let mut room = led_room(&[1, 600]);
    room.controllers[0].is_alive = false;
    cut_off(&mut room, 1, 1);
    assert_eq!(room.until_accepted(1), 2 * INTERVAL);
    assert!(room.controllers[1].tenure.has_leader_ended());
}

#[test]
fn telemetry_is_absent_when_none_has_come_for_a_second_after_the_return_of_the_link() {
    let mut room = led_room(&[1, 600]);
    room.hang(0, 1);
    assert_eq!(room.standings(), [Standing::Standby, Standing::Leading]);
    cut_off(&mut room, 0, 600);
    let (now, tenure) = (room.now, &mut room.controllers[0].tenure);
    let resumed = (1..300).find(|tick| tenure.permit(now + tick * INTERVAL).0.is_some());
    assert_eq!(resumed, Some(102), "the first report after the pause is that of tick 1");
}

#[test]
fn the_actions_for_absent_reports_hide_no_loss_of_a_link() {
    // The action is due once, or again and again.
    for silences in [&[550_u64][..], &[550, 600, 700, 800, 900, 1000, 1050, 1100, 1200]] {
        let mut room = led_room(&[1, 600]);
        let (now, tenure) = (room.now, &mut room.controllers[1].tenure);
        for after_ms in silences {
            assert_eq!(tenure.permit_in_silence(now + after_ms * MS), (None, None), "{after_ms} ms");
        }
        assert_eq!(tenure.permit(now + 1300 * MS), (None, None), "telemetry is not back yet");
        assert_eq!(tenure.standing(), Standing::Standby);
    }
}

#[test]
fn each_loss_of_a_link_has_its_own_wait_for_telemetry() {
    let mut room = led_room(&[1, 600]);
    let (mut now, mut shown, tenure) = (room.now, room.array.shown, &mut room.controllers[1].tenure);
    for loss in 0..3 {
        now += 3 * S;
        // The reports are too sparse for one to be judged.
        for _ in 0..30 {
            now += 5 * INTERVAL;
            assert_eq!(tenure.permit(now), (None, None), "loss {loss}");
            shown.accepted += 1;
            assert_eq!(tenure.handle_telemetry(now, shown), None);
        }
    }
}

#[test]
fn telemetry_that_is_older_than_the_last_report_is_no_sign_that_none_comes() {
    let mut room = led_room(&[1, 600]);
    let (before, tenure) = (room.now, &mut room.controllers[1].tenure);
    for tick in (1..5).chain(100..200) {
        assert_eq!(tenure.permit(before + tick * INTERVAL), (None, None), "tick {tick}");
    }
}

#[test]
fn a_link_that_is_lost_again_before_telemetry_comes_has_a_wait_of_its_own() {
    let mut room = led_room(&[1, 600]);
    let (start, tenure) = (room.now, &mut room.controllers[1].tenure);
    let answers = |tenure: &mut Tenure, times: std::ops::Range<u64>| {
        times.step_by(10).filter(|at_ms| tenure.permit(start + at_ms * MS) != (None, None)).collect::<Vec<_>>()
    };
    assert_eq!(answers(tenure, 3000..3500), [], "the first return");
    assert_eq!(answers(tenure, 6500..7510), [], "the second one");
    assert_eq!(answers(tenure, 7510..7520), [7510]);
}

#[test]
fn a_link_that_flaps_does_not_put_off_the_end_of_the_wait() {
    let mut room = led_room(&[1, 600]);
    let (start, tenure) = (room.now, &mut room.controllers[1].tenure);
    let resumed = (3000..9000).step_by(600).find(|at_ms| tenure.permit(start + at_ms * MS) != (None, None));
    assert_eq!(resumed, Some(4200), "the first one more than 1 s after the first return");
}

#[test]
fn a_reserve_waits_for_late_telemetry_as_after_the_loss_of_a_link() {
    let mut tenure = Tenure::live(2, INTERVAL).in_reserve(None);
    let granted = (0..300).find(|tick| tenure.permit(NOON + tick * INTERVAL).0.is_some());
    assert_eq!(granted, Some(121), "200 ms for the first telemetry, and more than 1 s after them");
}

/// A sample of telemetry: ms before a report, ms on its way, and ms by which the clock of its driver is behind.
type Sample = [u64; 3];

/// Reports after the last answer of the leader at which a standby takes over, by the samples of another driver before
/// each report.
fn takeover_after(answered: u64, samples: impl Fn(u64) -> Vec<Sample>) -> Option<u64> {
    let mut room = led_room(&[1, 600]);
    let (start, shown, tenure) = (room.now, room.array.shown, &mut room.controllers[1].tenure);
    let mut on_their_way = VecDeque::new();
    let granted = (1..500).find(|tick| {
        let report_ns = start + tick * INTERVAL;
        for [ago_ms, way_ms, behind_ms] in samples(*tick) {
            let sampled_ns = report_ns - ago_ms * MS;
            let accepted = shown.accepted + answered.min(tick - 1);
            let sample = Evidence { source: 7, sampled_ns: sampled_ns - behind_ms * MS, accepted, ..shown };
            on_their_way.push_back((sampled_ns + way_ms * MS, sample));
        }
        while let Some((came_ns, sample)) = on_their_way.pop_front_if(|(came_ns, _)| *came_ns < report_ns) {
            assert_eq!(tenure.handle_telemetry(came_ns, sample), None);
        }
        tenure.permit(report_ns).0.is_some()
    });
    granted.map(|tick| tick - answered)
}

#[test]
fn telemetry_that_waited_on_its_way_shows_no_unanswered_report() {
    // Two samples before each answer. The second one of tick 200 waits until after the report, and the next ones until
    // after the next report.
    let waiting = |tick| match tick {
        200 => vec![[3, 0, 0], [1, 6, 0]],
        201 => vec![[3, 4, 0], [1, 2, 0]],
        _ => vec![[3, 0, 0], [1, 0, 0]],
    };
    assert_eq!(takeover_after(500, waiting), None);
    assert_eq!(takeover_after(300, waiting), Some(2), "a leader that fails later is found as ever");
}

#[test]
fn telemetry_of_one_time_is_as_old_as_its_first_message() {
    // A clock of 10 ms. The second message of tick 200 waits, and the next ones.
    let coarse = |tick| match tick {
        200 => vec![[3, 0, 7], [1, 6, 9]],
        201 => vec![[3, 4, 7], [1, 2, 9]],
        _ => vec![[3, 0, 7], [1, 0, 9]],
    };
    assert_eq!(takeover_after(500, coarse), None);
}

#[test]
fn a_clock_that_stands_still_leaves_arrivals() {
    let mut tenure = Tenure::live(600, INTERVAL).in_reserve(None);
    let shown = |tick: u64| Evidence { epoch: 1, accepted: 1 + tick.min(200), following: true, ..Evidence::default() };
    let granted = (1..500).find(|tick| {
        assert_eq!(tenure.handle_telemetry(NOON + tick * INTERVAL - MS, shown(tick - 1)), None);
        tenure.permit(NOON + tick * INTERVAL).0.is_some()
    });
    assert_eq!(granted, Some(202));
}

#[test]
fn a_difference_of_the_clocks_does_not_delay_a_takeover() {
    for behind_ms in [0, 8, 1000, 3_600_000] {
        for answered in [20, 300] {
            assert_eq!(takeover_after(answered, |_| vec![[1, 0, behind_ms]]), Some(2), "{behind_ms} ms");
        }
    }
    // The clock steps back at tick 200.
    let stepped = |tick| vec![[1, 0, if tick < 200 { 0 } else { 8 }]];
    assert_eq!(takeover_after(210, stepped), Some(3), "telemetry seems late for a second");
    assert_eq!(takeover_after(310, stepped), Some(2));
}

#[test]
fn a_report_that_waited_on_its_way_may_have_been_answered_before() {
    for (answered, expected) in [(500, None), (200, Some(2)), (300, Some(2))] {
        let mut room = led_room(&[1, 600]);
        let (start, shown, tenure) = (room.now, room.array.shown, &mut room.controllers[1].tenure);
        let granted = (1..500).find(|tick| {
            let report_ns = start + tick * INTERVAL;
            let accepted = shown.accepted + answered.min(*tick);
            let show = |tenure: &mut Tenure, after_ms: u64| {
                let sampled_ns = report_ns + after_ms * MS;
                let sample = Evidence { source: 7, sampled_ns, accepted, ..shown };
                assert_eq!(tenure.handle_telemetry(sampled_ns, sample), None);
            };
            // The first telemetry after a report shows the answer. The report of tick 200 comes after it.
            let came_ns = report_ns + if *tick == 200 { 4 * MS } else { 0 };
            if came_ns > report_ns {
                show(tenure, 2);
            }
            tenure.handle_report(came_ns, &Stamp { source: 9, sequence: *tick, time_ns: report_ns });
            let is_granted = tenure.permit(came_ns).0.is_some();
            if !is_granted {
                let shown_ms: &[u64] = if came_ns > report_ns { &[8] } else { &[2, 8] };
                shown_ms.iter().for_each(|after_ms| show(tenure, *after_ms));
            }
            is_granted
        });
        assert_eq!(granted.map(|tick| tick - answered), expected, "{answered} answers");
    }
}
