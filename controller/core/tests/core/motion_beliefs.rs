//! The belief about the motion of users, from position reports.

use heliostat_channel::Vec3;
use heliostat_core::belief::{Belief, innovations::Innovations};
use heliostat_proto::{Stamp, UserReport, UserState};
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::support::hall;

fn report(tick: u64, users: &[(u32, [f32; 3], [f32; 2])]) -> UserReport {
    let stamp = Stamp { source: 1, sequence: tick, time_ns: tick * 100_000_000 };
    let state = |&(user, position_m, velocity_m_s): &(u32, [f32; 3], [f32; 2])| UserState {
        user,
        position_m,
        velocity_m_s,
        min_rate_bps: 1e6,
    };
    UserReport { stamp, tick, users: users.iter().map(state).collect() }
}

fn belief() -> Belief {
    hall(&[]).2
}

/// The report of user 7, who walks along x at 1 m/s.
fn walk(tick: u64) -> UserReport {
    report(tick, &[(7, [0.1 * tick as f32, 0.0, 0.9], [1.0, 0.0])])
}

/// A belief after ten reports of that walk.
fn walked() -> Belief {
    let mut belief = belief();
    (1..=10).for_each(|tick| belief.handle_users(&walk(tick)));
    belief
}

/// The position after user 7 walked along x at 1 m/s for ten reports, beside these others.
fn after_walk(others: impl Fn(u64) -> Vec<(u32, [f32; 3], [f32; 2])>, first: bool) -> Vec3 {
    let mut belief = belief();
    for tick in 1..=10 {
        let mut users = others(tick);
        let slot = if first { 0 } else { users.len() };
        users.insert(slot, (7, [0.1 * tick as f32, 0.5, 0.9], [1.0, 0.0]));
        belief.handle_users(&report(tick, &users));
    }
    belief.estimate(7, 0.5).expect("a user").position
}

#[test]
fn a_user_is_found_by_number_whatever_the_order_of_the_report() {
    let alone = after_walk(|_| Vec::new(), true);
    assert!((alone - Vec3::new(1.5, 0.5, 0.9)).norm() < 0.05, "{alone:?}");
    let other = |user| (user, [-2.0, 1.0, 1.2], [0.0, 0.4]);
    let come_and_go = |tick| if tick % 3 == 0 { vec![other(3)] } else { vec![other(9), other(3)] };
    // The noise of the reports is learned from all users, so the weights differ a little.
    for first in [true, false] {
        assert!((after_walk(come_and_go, first) - alone).norm() < 1e-3);
    }
}

/// The variance of the place of user 7, who walks along x, is absent from this many reports and then
/// returns at the expected place, as a share of that of the reports: 1 for a new user. The reports
/// are 0.1 s apart.
fn variance_after_absence(absent: u64) -> f64 {
    let mut belief = walked();
    for tick in 11..11 + absent {
        belief.handle_users(&report(tick, &[(3, [0.0; 3], [0.0; 2])]));
        assert_eq!(belief.estimate(7, 0.0), None, "an absent user has no estimate");
    }
    belief.handle_users(&walk(11 + absent));
    share_of_noise(&belief, 7)
}

/// The variance of the place of a user as a share of that of the reports.
fn share_of_noise(belief: &Belief, user: u32) -> f64 {
    belief.estimate(user, 0.0).expect("a user").position_cov_m2[0] / belief.noise()[0].powi(2)
}

#[test]
fn a_user_who_returns_within_a_second_continues_and_later_starts_again() {
    let [never, once, at_last, too_late] = [0, 1, 9, 10].map(variance_after_absence);
    assert!(once < 1.2 * never && at_last < 0.95, "{never} {once} {at_last}");
    assert!((too_late - 1.0).abs() < 1e-3, "{too_late}");
}

#[test]
fn another_user_under_a_number_that_was_absent_is_followed_at_once() {
    for absent in [1, 20] {
        let mut belief = walked();
        (11..11 + absent).for_each(|tick| belief.handle_users(&report(tick, &[])));
        belief.handle_users(&report(11 + absent, &[(7, [-3.0, 2.0, 0.9], [0.0, 0.5])]));
        let back = belief.estimate(7, 0.0).expect("a user").position;
        assert!((back - Vec3::new(-3.0, 2.0, 0.9)).norm() < 0.01, "{absent}: {back:?}");
    }
}

#[test]
fn the_first_report_of_a_user_is_of_no_old_number() {
    let mut belief = belief();
    // Times are UTC.
    belief.handle_users(&report(17_000_000_000, &[(7, [1.0, 0.0, 0.9], [1.0, 0.0])]));
    assert!(belief.estimate(7, 0.0).expect("a user").heading.norm() > 0.9, "the walk counts");
    assert_eq!(belief.innovations().count, 0, "nothing was predicted");
}

#[test]
fn another_user_under_an_old_number_inherits_nothing_but_the_number() {
    let (mut first, mut second) = (walked(), belief());
    let before = first.innovations();
    let certainty = |belief: &Belief| belief.estimate(7, 0.0).expect("a user").heading.norm();
    assert!(certainty(&first) > 0.9);
    // A user who stands shows no heading.
    let jump = report(11, &[(7, [-3.0, 2.0, 1.2], [0.0, 0.0])]);
    first.handle_users(&jump);
    assert_eq!(first.innovations(), before, "no prediction was wrong");
    let height_m = first.estimate(7, 0.0).expect("a user").position.z;
    assert!((height_m - 1.2).abs() < 1e-3, "{height_m}");
    second.handle_users(&report(10, &[]));
    second.handle_users(&jump);
    assert!((certainty(&first) - certainty(&second)).abs() < 0.01, "{} {}", certainty(&first), certainty(&second));
    first.handle_users(&report(12, &[(7, [-3.0, 2.0, 1.2], [0.0, 0.0])]));
    assert_eq!(first.innovations().count, before.count + 1);
}

#[test]
fn absent_users_give_way_to_those_who_are_present() {
    let mut belief = belief();
    let crowd = |users: std::ops::Range<u32>| -> Vec<_> {
        users.map(|user| (user, [0.05 * user as f32, 0.0, 0.9], [0.0, 0.0])).collect()
    };
    (1..=10).for_each(|tick| belief.handle_users(&report(tick, &crowd(0..64))));
    let reports = [report(11, &crowd(4..68)), report(12, &crowd(0..64))];
    let counted = allocation_counter::measure(|| reports.iter().for_each(|report| belief.handle_users(report)));
    assert_eq!(counted.count_total, 0);
    let [remembered, new] = [60, 2].map(|user| share_of_noise(&belief, user));
    assert!(remembered < 0.8 && (new - 1.0).abs() < 1e-3, "{remembered} {new}");
}

#[test]
fn a_tracker_without_velocities_still_shows_the_direction() {
    let mut belief = belief();
    for tick in 1..=20 {
        belief.handle_users(&report(tick, &[(7, [0.08 * tick as f32, 0.0, 0.9], [0.0, 0.0])]));
    }
    let estimate = belief.estimate(7, 0.0).expect("a user");
    assert!((estimate.velocity.x - 0.8).abs() < 0.1, "{estimate:?}");
}

#[test]
fn the_innovations_of_a_straight_walk_have_the_mean_of_two_degrees_of_freedom() {
    let (mut belief, mut rng) = (belief(), rand_chacha::ChaCha8Rng::seed_from_u64(1));
    for tick in 1..=2000_u64 {
        let [dx, dy] = normal(&mut rng, 0.05).map(|part| part as f32);
        let position = [0.5 + dx, dy, 0.9];
        belief.handle_users(&report(tick, &[(7, position, [0.0, 0.0])]));
    }
    let Innovations { count, sum } = belief.innovations();
    assert_eq!(count, 1999, "the first report of a user has no prediction");
    assert!((sum / count as f64 - 2.0).abs() < 0.4, "{}", sum / count as f64);
}

#[test]
fn the_ellipse_of_a_user_who_wanders_holds_the_place() {
    const REPORTS: u64 = 3000;
    let (mut belief, mut rng) = (belief(), rand_chacha::ChaCha8Rng::seed_from_u64(3));
    let [position_m, velocity_m_s] = belief.noise();
    // A walk whose direction swings by 70 degrees to each side and whose speed changes, in small steps.
    let (mut place, mut inside) = ([0.0, 0.0], 0);
    for tick in 1..=REPORTS {
        let mut walked = None;
        for step in 0..20 {
            let time_s = 0.1 * tick as f64 + 0.01 * f64::from(step);
            let (angle, speed) = (1.2 * (1.1 * time_s).sin(), 0.8 + 0.3 * (0.7 * time_s).cos());
            if step == 10 {
                walked = Some(place);
            }
            place = [place[0] + 0.01 * speed * angle.cos(), place[1] + 0.01 * speed * angle.sin()];
            if step == 0 {
                let ([dx, dy], [du, dv]) = (normal(&mut rng, position_m), normal(&mut rng, velocity_m_s));
                let [x, y] = [place[0] + dx, place[1] + dy].map(|part| part as f32);
                let [u, v] = [speed * angle.cos() + du, speed * angle.sin() + dv].map(|part| part as f32);
                belief.handle_users(&report(tick, &[(7, [x, y, 0.9], [u, v])]));
            }
        }
        let estimate = belief.estimate(7, 0.19).expect("a user");
        let [xx, xy, yy] = estimate.position_cov_m2;
        let [dx, dy] = [estimate.position.x - place[0], estimate.position.y - place[1]];
        let squared = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy);
        // The quantile of chi-squared with two degrees of freedom.
        inside += u64::from(squared < 5.991);
        place = walked.expect("the place at the next report");
    }
    let share = inside as f64 / REPORTS as f64;
    assert!(share > 0.9, "{share}");
}

/// A circular normal error with this standard deviation of one axis.
fn normal(rng: &mut rand_chacha::ChaCha8Rng, deviation: f64) -> [f64; 2] {
    let [quantile, turn] = [0; 2].map(|_| uniform(rng));
    let (radius, angle) = (deviation * (-2.0 * (1.0 - quantile).ln()).sqrt(), turn * std::f64::consts::TAU);
    [radius * angle.cos(), radius * angle.sin()]
}

fn uniform(rng: &mut rand_chacha::ChaCha8Rng) -> f64 {
    (rng.next_u64() >> 40) as f64 / (1_u64 << 24) as f64
}

/// The learned noise as a share of the true one, of a position and of a velocity, after each of 900
/// reports of one walking user. There are 30 reports a second, each up to 5 ms early or late. The
/// true noise is twice the assumed one.
fn learned_shares(seed: u64) -> Vec<[f64; 2]> {
    let (mut belief, mut rng) = (belief(), rand_chacha::ChaCha8Rng::seed_from_u64(seed));
    let truth = belief.noise().map(|assumed| 2.0 * assumed);
    let after_report = |tick: u64| {
        let time_s = tick as f64 / 30.0 + 0.01 * (uniform(&mut rng) - 0.5);
        let ([dx, dy], [du, dv]) = (normal(&mut rng, truth[0]), normal(&mut rng, truth[1]));
        let [x, y, u, v] = [0.1 * time_s + dx, 0.5 + dy, 0.1 + du, dv].map(|part| part as f32);
        let mut report = report(tick, &[(7, [x, y, 0.9], [u, v])]);
        report.stamp.time_ns = (time_s * 1e9) as u64;
        belief.handle_users(&report);
        [0, 1].map(|kind| belief.noise()[kind] / truth[kind])
    };
    (1..=900).map(after_report).collect()
}

#[test]
fn the_noise_of_a_tracker_with_jitter_is_learned_within_200_reports() {
    for seed in 0..10 {
        let learned = learned_shares(seed).split_off(199);
        let off = learned.iter().flatten().map(|share| (share - 1.0).abs()).fold(0.0, f64::max);
        assert!(off < 0.2, "seed {seed}: {off}");
    }
}
