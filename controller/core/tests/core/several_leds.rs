//! Rooms with several LEDs: the gain of the serving LED shows what blocks the others.

use heliostat_channel::{ChannelModel, Cylinder, Orientation, Scene, Vec3};
use heliostat_core::{
    belief::Belief,
    inbox::{Inbox, Message},
};
use heliostat_proto::{ChannelReport, LedGain, LedReport, Stamp, UserLeds};
use heliostat_scenario::Scenario;

use crate::support::{self, MS, report_gains};

/// Two LEDs, where the reported positions are exact.
const TWO_LEDS: [&str; 2] = ["led.positions_m=[[-1.25,0,3],[1.25,0,3]]", "streams.positions.noise_m=0.001"];

fn hall(overrides: &[&str]) -> (Scenario, ChannelModel) {
    let (scenario, model, _) = support::hall(&[&TWO_LEDS, overrides].concat());
    (scenario, model)
}

/// The direct gains of users at these places in these orientations past blockers.
fn direct_gains(model: &ChannelModel, held: &[(Vec3, Orientation)], blockers: &[Cylinder]) -> Vec<f64> {
    let (places, held): (Vec<Vec3>, Vec<Orientation>) = held.iter().copied().unzip();
    let mut scene = Scene::new(model, places.len());
    scene.update_turned(model, &places, &held, blockers, &vec![false; places.len()]);
    scene.los_gain().to_vec()
}

/// A belief after ten reports, 100 ms apart, of these places and direct gains.
fn reported(scenario: &Scenario, model: &ChannelModel, places: &[Vec3], gains: &[f64]) -> Belief {
    reported_with(scenario, model, (places, gains), None)
}

/// The same with what the receivers tell about LEDs.
fn reported_with(
    scenario: &Scenario,
    model: &ChannelModel,
    (places, gains): (&[Vec3], &[f64]),
    leds: Option<&LedReport>,
) -> Belief {
    let mut belief = Belief::new(scenario, model, 64);
    let gains: Vec<[f64; 2]> = gains.iter().map(|direct| [*direct, 0.0]).collect();
    (1..=10).for_each(|tick| report_gains(&mut belief, model, tick, places, (&gains, leds)));
    belief
}

#[test]
fn the_gain_of_the_farther_led_shows_that_the_body_blocks_the_nearer_one() {
    let (scenario, model) = hall(&["blockage.obstacles_per_m2=0.0"]);
    let place = Vec3::new(-0.3, 0.0, 0.85);
    let body = scenario.blockage.body().unwrap().behind(&place, &Vec3::x());
    let held = [(place, Orientation::UPRIGHT)];
    let believed = |blockers: &[Cylinder]| {
        let gains = direct_gains(&model, &held, blockers);
        reported(&scenario, &model, &[place], &gains).estimate(0, 0.0).unwrap().heading
    };
    let [nearer_blocked, nearer_clear] = [believed(&[body]), believed(&[])];
    assert!(nearer_blocked.x > 0.8, "the user faces away from the nearer LED: {nearer_blocked:?}");
    assert!(nearer_clear.x < -0.1, "any other heading: {nearer_clear:?}");
}

#[test]
fn the_gain_of_the_farther_led_shows_an_obstacle_before_the_nearer_one() {
    let leds = "led.positions_m=[[0,0.2,3],[0,-2.3,3]]";
    let (scenario, model) = hall(&[leds, "blockage.bodies=false"]);
    let place = Vec3::new(0.0, -0.8, 0.85);
    let obstacle = Cylinder::new(0.0, -0.5, 0.2, 1.75).unwrap();
    let clear = |blockers: &[Cylinder]| {
        let gains = direct_gains(&model, &[(place, Orientation::UPRIGHT)], blockers);
        let belief = reported(&scenario, &model, &[place], &gains);
        // The paths to the mirrors pass the same place.
        let mut columns = vec![1.0; scenario.mirrors.columns()];
        assert!(belief.unobstructed(&place, &mut columns), "the map exists");
        columns.into_iter().fold(1.0, f64::min)
    };
    let [blocked, free] = [clear(&[obstacle]), clear(&[])];
    assert!(blocked < 0.5 && free > 0.95, "{blocked} {free}");
}

#[test]
fn tilted_receivers_are_noticed_under_several_leds() {
    // Low bodies leave the direct paths clear at every heading.
    let (scenario, model) = hall(&["blockage.body_height_m=0.9"]);
    let seats = [Vec3::new(0.2, 1.2, 0.85), Vec3::new(0.3, -1.2, 0.85), Vec3::new(-1.9, 0.5, 0.85)];
    for polar_deg in [41.39_f64, 0.0] {
        // The users face the middle of the room.
        let tilted = |seat: &Vec3| Orientation::from_polar_azimuth(polar_deg.to_radians(), seat.y.atan2(seat.x));
        let held = seats.each_ref().map(|seat| (*seat, tilted(seat)));
        let belief = reported(&scenario, &model, &seats, &direct_gains(&model, &held, &[]));
        let is_tilted = belief.orientation(0, 0.0, (&Vec3::x(), 0.0)) != Orientation::UPRIGHT;
        assert_eq!(is_tilted, polar_deg > 0.0, "a polar angle of {polar_deg} degrees");
    }
}

/// A report of a user's receiver with these gains of each LED.
fn led_report(gains: &[f64]) -> LedReport {
    let gain = |(led, gain): (u32, &f64)| LedGain { user: 0, led, los_gain: *gain as f32 };
    let users = vec![UserLeds { user: 0, serving: None, measures_each: true }];
    LedReport { users, gains: (0..).zip(gains).map(gain).collect(), ..LedReport::default() }
}

#[test]
fn the_gains_of_both_leds_show_the_heading_that_one_of_them_leaves_open() {
    let (scenario, model) = hall(&["blockage.body_height_m=0.9", "blockage.obstacles_per_m2=0.0", "control.tilt={}"]);
    let (place, towards) = (Vec3::new(0.4, 1.1, 0.85), Vec3::new(0.6, 0.8, 0.0));
    let held = Orientation::from_polar_azimuth(41.39_f64.to_radians(), (-towards.y).atan2(-towards.x));
    let mut scene = Scene::new(&model, 1);
    scene.place_turned(&model, &[place], &[held], &[]);
    let gains = [0, 1].map(|led| scene.los_gain_by(&model, &[], 0, led));
    let los = gains[0].max(gains[1]);
    let certainty = |leds: Option<&LedReport>| {
        let belief = reported_with(&scenario, &model, (&[place], &[los]), leds);
        belief.estimate(0, 0.0).unwrap().heading.dot(&towards)
    };
    let [one, both] = [certainty(None), certainty(Some(&led_report(&gains)))];
    assert!(both > 0.9 && one < 0.8, "{one} {both}");
}

#[test]
fn an_led_report_belongs_to_the_channel_report_of_its_time() {
    let mut inbox = Inbox::new(&hall(&[]).0);
    let stamp = |sequence: u64, time_ms: u64| Stamp { source: 1, sequence, time_ns: time_ms * MS };
    for (sequence, led_ms, channel_ms) in [(1, 1000, 1000), (2, 1100, 1200)] {
        let mut leds = LedReport { stamp: stamp(sequence, led_ms), ..led_report(&[1e-6, 2e-6]) };
        let mut channel = ChannelReport { stamp: stamp(sequence, channel_ms), ..ChannelReport::default() };
        inbox.accept(1200 * MS, Message::Leds(&mut leds)).unwrap();
        inbox.accept(1200 * MS, Message::Channel(&mut channel)).unwrap();
        assert_eq!(inbox.leds().is_some(), led_ms == channel_ms);
    }
    let mut unknown = LedReport { stamp: stamp(3, 1200), ..led_report(&[1e-6, 2e-6, 3e-6]) };
    assert!(inbox.accept(1200 * MS, Message::Leds(&mut unknown)).is_err(), "the room has two LEDs");
}
