//! Receivers that users tilt towards their faces: what measured direct gains show.

use heliostat_channel::{ChannelModel, Orientation, Scene, Vec3};
use heliostat_core::belief::Belief;
use heliostat_proto::{OrientationReport, Stamp, UserOrientation};

use crate::support::{self, MS, report_gains};

/// Low bodies, which leave the direct path clear at every heading.
const LOW_BODIES: &str = "blockage.body_height_m=0.9";

/// Users who sit in `hall`, at the same distance from the LED.
const SEATS: [Vec3; 3] = [Vec3::new(1.2, 0.0, 0.85), Vec3::new(0.0, -1.2, 0.85), Vec3::new(-1.2, 0.0, 0.85)];

/// The mean polar angle of a user who sits, in rad.
fn sitting() -> f64 {
    41.39_f64.to_radians()
}

/// The direct gain of receivers at these places in these orientations.
fn direct_gains(model: &ChannelModel, places: &[Vec3], held: &[Orientation]) -> Vec<f64> {
    let mut scene = Scene::new(model, places.len());
    scene.update_turned(model, places, held, &[], &vec![false; places.len()]);
    scene.los_gain().to_vec()
}

/// Reports the places of the users, and then these direct gains.
fn report(belief: &mut Belief, model: &ChannelModel, gains: &[f64], tick: u64) {
    let gains: Vec<[f64; 2]> = gains.iter().map(|direct| [*direct, 0.0]).collect();
    report_gains(belief, model, tick, &SEATS, (&gains, None));
}

fn headings(belief: &Belief) -> Vec<Vec3> {
    (0..SEATS.len() as u32).map(|user| belief.estimate(user, 0.0).unwrap().heading).collect()
}

fn hall(overrides: &[&str]) -> (ChannelModel, Belief) {
    let (_, model, belief) = support::hall(&[&[LOW_BODIES], overrides].concat());
    (model, belief)
}

/// The receiver of a seated user with this heading.
fn tilted(heading: Vec3) -> Orientation {
    Orientation::from_polar_azimuth(sitting(), (-heading.y).atan2(-heading.x))
}

/// The headings that are believed after ten reports where users hold their receivers so.
fn believed(overrides: &[&str], held: impl Fn(&Vec3) -> Orientation) -> Vec<Vec3> {
    let (model, mut belief) = hall(overrides);
    let gains = direct_gains(&model, &SEATS, &SEATS.each_ref().map(held));
    (1..=10).for_each(|tick| report(&mut belief, &model, &gains, tick));
    headings(&belief)
}

/// The heading of a user who faces the LED.
fn towards_led(seat: &Vec3) -> Vec3 {
    -Vec3::new(seat.x, seat.y, 0.0).normalize()
}

#[test]
fn the_direct_gain_shows_the_heading_of_a_seated_user_who_tilts_the_receiver() {
    let stated = ["control.tilt={}"];
    for (seat, heading) in SEATS.iter().zip(believed(&stated, |seat| tilted(towards_led(seat)))) {
        assert!(heading.dot(&towards_led(seat)) > 0.8, "{seat:?}: {heading:?}");
    }
    for (seat, heading) in SEATS.iter().zip(believed(&stated, |seat| tilted(-towards_led(seat)))) {
        assert!(heading.dot(&towards_led(seat)) < -0.6, "{seat:?}: {heading:?}");
    }
}

#[test]
fn tilted_receivers_are_noticed_where_the_scenario_states_none() {
    for (seat, heading) in SEATS.iter().zip(believed(&[], |seat| tilted(towards_led(seat)))) {
        assert!(heading.dot(&towards_led(seat)) > 0.7, "{seat:?}: {heading:?}");
    }
}

#[test]
fn the_direct_gain_of_upright_receivers_shows_no_heading() {
    for heading in believed(&[], |_| Orientation::UPRIGHT) {
        assert!(heading.norm() < 0.2, "{heading:?}");
    }
}

#[test]
fn a_detector_that_is_tilted_in_its_device_does_not_tilt_the_receivers_of_others() {
    let held = |seat: &Vec3| if *seat == SEATS[0] { tilted(towards_led(seat)) } else { Orientation::UPRIGHT };
    for heading in believed(&[], held) {
        assert!(heading.norm() < 0.2, "{heading:?}");
    }
}

#[test]
fn a_restored_belief_has_the_evidence_of_tilted_receivers() {
    let ((model, mut first), (_, mut second)) = (hall(&[]), hall(&[]));
    let gains = direct_gains(&model, &SEATS, &SEATS.each_ref().map(|seat| tilted(towards_led(seat))));
    report(&mut first, &model, &gains, 1);
    assert!(second.restore(&first.memory()));
    for belief in [&mut first, &mut second] {
        (2..=3).for_each(|tick| report(belief, &model, &gains, tick));
    }
    assert_eq!(headings(&second), headings(&first));
}

/// Reports how the users hold their receivers, `late_ms` after the positions of a tick.
fn report_held(belief: &mut Belief, (tick, late_ms): (u64, u64), held: &[Orientation]) {
    let stamp = Stamp { source: 1, sequence: tick, time_ns: (tick * 100 + late_ms) * MS };
    let entry = |(user, held): (u32, &Orientation)| UserOrientation {
        user,
        quaternion: held.quaternion().map(|part| part as f32),
    };
    belief.handle_orientation(&OrientationReport { stamp, users: (0..).zip(held).map(entry).collect() });
}

/// A belief after ten ticks with orientation reports, where users hold their receivers so.
fn with_reports(held: impl Fn(&Vec3) -> Orientation) -> Belief {
    let (model, mut belief) = hall(&[]);
    let held = SEATS.each_ref().map(held);
    let gains = direct_gains(&model, &SEATS, &held);
    for tick in 1..=10 {
        report(&mut belief, &model, &gains, tick);
        report_held(&mut belief, (tick, 0), &held);
    }
    belief
}

#[test]
fn reported_azimuths_show_the_headings_of_seated_users() {
    // The direct gain is the same at a second heading, on the other side of the direction of the
    // LED.
    let aside = |seat: &Vec3| Vec3::new(-seat.y, seat.x, 0.0).normalize();
    for (seat, heading) in SEATS.iter().zip(headings(&with_reports(|seat| tilted(aside(seat))))) {
        assert!(heading.dot(&aside(seat)) > 0.95, "{seat:?}: {heading:?}");
    }
}

#[test]
fn reports_of_upright_receivers_show_no_headings_and_no_tilt() {
    let belief = with_reports(|_| Orientation::UPRIGHT);
    for (user, heading) in (0..).zip(headings(&belief)) {
        assert!(heading.norm() < 0.2, "{heading:?}");
        assert_eq!(belief.orientation(user, 0.1, (&Vec3::x(), 0.0)), Orientation::UPRIGHT);
    }
}

#[test]
fn an_old_report_of_a_receiver_counts_less_than_the_direction_to_the_face() {
    let mut belief = with_reports(|_| tilted(Vec3::x()));
    // One report shows the first user's receiver upright.
    report_held(&mut belief, (10, 1), &[Orientation::UPRIGHT]);
    let normal = |after_s: f64| belief.orientation(0, after_s, (&Vec3::x(), 0.0)).normal();
    let lean = -tilted(Vec3::x()).normal().x;
    let [at_once, soon, late] = [0.001, 0.1, 2.0].map(|after_s| -normal(after_s).x / lean);
    assert!(at_once < 0.02, "{at_once}");
    assert!((0.4..0.6).contains(&soon), "{soon}");
    assert!((0.99..1.01).contains(&late), "{late}");
}

#[test]
fn a_restored_belief_has_what_reports_have_shown_of_devices() {
    let first = with_reports(|_| tilted(Vec3::x()));
    let (_, mut second) = hall(&[]);
    let held = |belief: &Belief| belief.orientation(0, 1.0, (&Vec3::x(), 0.0));
    assert_ne!(held(&second), held(&first));
    assert!(second.restore(&first.memory()));
    assert_eq!(held(&second), held(&first));
}
