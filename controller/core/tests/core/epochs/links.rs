//! A standby that loses its link, and with it reports, telemetry and the tokens of the others.

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
    room.controllers[0].is_alive = false;
    room.until_accepted(1);
    room.controllers[0].is_alive = true;
    room.run(S);
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
