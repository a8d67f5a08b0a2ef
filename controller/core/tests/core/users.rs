//! Users who come and go: who is served, and what is remembered of whom.

use heliostat_core::{
    core::{Controller, DegradedMode},
    inbox::Message,
    policy::PolicyKind,
};
use heliostat_proto::MirrorCommand;

use crate::support::{Outcome, Room, by_policy, flat, receive, scripted};

/// Users are where they are reported: the filter learns its noise from all users in turn.
const AS_REPORTED: [&str; 1] = ["control.belief=none"];

/// Reports the gains and then the positions of these users.
fn tick(controller: &mut Controller, room: &mut Room, tick: u64, ids: &[u32]) -> Outcome {
    receive(controller, Room::time(tick), Message::Channel(&mut room.gains_of(tick, 1e-6, ids)));
    receive(controller, Room::time(tick), Message::Users(&mut room.positions_of(tick, ids)))
}

fn angles(command: &MirrorCommand) -> (Vec<f32>, Vec<f32>) {
    (command.roll.clone(), command.yaw.clone())
}

#[test]
fn a_user_is_served_by_the_answer_to_the_first_report_that_has_it() {
    // One user on each side of the room: the mirrors turn as soon as the second is the only one.
    let (mut controller, mut room) = by_policy(PolicyKind::FixedPoint, &AS_REPORTED);
    let former = tick(&mut controller, &mut room, 1, &[0]).command();
    let next = tick(&mut controller, &mut room, 2, &[41]).command();
    assert_eq!(controller.observation().ids, [41]);
    let (mut alone, mut other_room) = by_policy(PolicyKind::FixedPoint, &AS_REPORTED);
    let expected = tick(&mut alone, &mut other_room, 2, &[41]).command();
    assert_eq!(angles(&next), angles(&expected));
    assert_ne!(angles(&next), angles(&former));
}

#[test]
fn a_report_without_users_repeats_the_last_angles_and_is_flat_before_any() {
    let (mut controller, mut room) = scripted(&[], |_, out| {
        out.roll.fill(0.125);
        Ok(())
    });
    for (number, ids, roll) in [(1, &[][..], 0.0), (2, &[4][..], 0.125), (3, &[][..], 0.125)] {
        let command = tick(&mut controller, &mut room, number, ids).command();
        assert_eq!((command.answers, command.roll), (number, vec![roll; 9]));
    }
    assert_eq!(controller.counters().degraded(DegradedMode::ChannelMissing), 0);
}

#[test]
fn the_order_of_the_users_in_the_reports_changes_no_command() {
    for kind in [PolicyKind::FixedPoint, PolicyKind::Greedy] {
        let run = |shuffle: bool| -> Vec<(Vec<f32>, Vec<f32>)> {
            let (mut controller, mut room) = by_policy(kind, &AS_REPORTED);
            let mut answer = |tick: u64| {
                let (mut gains, mut users) = (room.gains(tick, 1e-6), room.positions(tick));
                for entry in &mut gains.users {
                    entry.los_gain *= 1.0 + entry.user as f32;
                }
                // The first report gives the users their places.
                if shuffle && tick > 1 {
                    gains.users.rotate_left(tick as usize % 3);
                    users.users.reverse();
                }
                receive(&mut controller, Room::time(tick), Message::Channel(&mut gains));
                angles(&receive(&mut controller, Room::time(tick), Message::Users(&mut users)).command())
            };
            (1..=30).map(&mut answer).collect()
        };
        assert_eq!(run(false), run(true), "{kind:?}");
    }
}

#[test]
fn a_user_without_a_measured_gain_has_the_modelled_one_and_foreign_entries_are_ignored() {
    let (mut controller, mut room) = flat(&["control.belief=none"]);
    receive(&mut controller, Room::time(1), Message::Channel(&mut room.gains_of(1, 1e-3, &[8, 1, 77])));
    receive(&mut controller, Room::time(1), Message::Users(&mut room.positions_of(1, &[1, 2, 8]))).command();
    let gains = controller.observation().scene.los_gain().to_vec();
    let measured = f64::from(1e-3_f32);
    assert_eq!([gains[0], gains[2]], [measured, measured]);
    assert!(gains[1] > 0.0 && gains[1] < 1e-5, "{gains:?}");
    assert_eq!(
        (controller.counters().unmeasured_users, controller.counters().degraded(DegradedMode::ChannelMissing)),
        (1, 0)
    );

    // A report about none of the users is as good as none.
    receive(&mut controller, Room::time(2), Message::Users(&mut room.positions_of(2, &[3]))).command();
    assert_eq!(
        (controller.counters().unmeasured_users, controller.counters().degraded(DegradedMode::ChannelMissing)),
        (1, 1)
    );
}

#[test]
fn users_beyond_the_capacity_of_an_actor_are_counted_and_the_policy_goes_on() {
    let (mut controller, mut room) = by_policy(PolicyKind::Ddpg, &[]);
    for (number, users) in [(1, 3), (2, 6), (3, 5), (4, 4)] {
        let ids: Vec<u32> = (0..users).collect();
        assert_eq!(tick(&mut controller, &mut room, number, &ids).command().roll, [0.25; 9]);
    }
    assert_eq!(controller.counters().unserved_users, 2 + 1);
    assert_eq!(controller.counters().degraded(DegradedMode::PolicyFailed), 0);
}

#[test]
fn a_new_user_does_not_inherit_the_heading_of_the_one_whose_place_it_takes() {
    let (mut controller, mut room) = flat(&[]);
    tick(&mut controller, &mut room, 1, &[0, 1, 2]).command();
    // The number 3 n + k stands where the number k does: one turn further.
    let seen = |controller: &mut Controller, room: &mut Room, number: u64, ids: &[u32]| {
        let mut report = room.positions_of(number, ids);
        report.users.iter_mut().for_each(|user| user.velocity_m_s = [0.0; 2]);
        receive(controller, Room::time(number), Message::Users(&mut report)).command();
        controller.observation().scene.irs_path_clear().to_vec()
    };
    let remembered = seen(&mut controller, &mut room, 2, &[0, 1, 2]);
    let replaced = seen(&mut controller, &mut room, 3, &[300, 301, 302]);
    assert!(replaced.iter().filter(|clear| **clear).count() > remembered.iter().filter(|clear| **clear).count());
    assert!(replaced.iter().all(|clear| *clear), "a user of unknown heading has no body");
}
