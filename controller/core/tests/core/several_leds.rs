//! Rooms with several LEDs: the gain of the serving LED shows what blocks the others.

use heliostat_channel::{ChannelModel, Cylinder, Orientation, Scene, Vec3};
use heliostat_core::belief::Belief;
use heliostat_proto::{ChannelReport, Stamp, UserChannel, UserReport, UserState};
use heliostat_scenario::Scenario;

use crate::support::MS;

/// Two LEDs, where the reported positions are exact.
const TWO_LEDS: [&str; 2] = ["led.positions_m=[[-1.25,0,3],[1.25,0,3]]", "streams.positions.noise_m=0.001"];

fn hall(overrides: &[&str]) -> Scenario {
    let overrides: Vec<String> = [&TWO_LEDS, overrides].concat().iter().map(|text| (*text).to_owned()).collect();
    Scenario::builtin("hall").unwrap().with_overrides(&overrides).unwrap()
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
    let mut belief = Belief::new(scenario, model, 64);
    for tick in 1..=10 {
        let stamp = Stamp { source: 1, sequence: tick, time_ns: tick * 100 * MS };
        let user = |(user, place): (u32, &Vec3)| {
            let position_m = [place.x as f32, place.y as f32, place.z as f32];
            UserState { user, position_m, ..UserState::default() }
        };
        belief.handle_users(&UserReport { stamp, tick, users: (0..).zip(places).map(user).collect() });
        let entry = |(user, gain): (u32, &f64)| UserChannel { user, los_gain: *gain as f32, ..UserChannel::default() };
        let channel = ChannelReport { stamp, tick, users: (0..).zip(gains).map(entry).collect() };
        belief.handle_channel(model, &channel, &[], &[]);
    }
    belief
}

#[test]
fn the_gain_of_the_farther_led_shows_that_the_body_blocks_the_nearer_one() {
    let scenario = hall(&["blockage.obstacles_per_m2=0.0"]);
    let model = scenario.channel_model().unwrap();
    let (place, blockage) = (Vec3::new(-0.3, 0.0, 0.85), &scenario.blockage);
    let body = Cylinder::new(place.x - blockage.body_offset_m, 0.0, blockage.body_radius_m, blockage.body_height_m);
    let held = [(place, Orientation::UPRIGHT)];
    let believed = |blockers: &[Cylinder]| {
        let gains = direct_gains(&model, &held, blockers);
        reported(&scenario, &model, &[place], &gains).estimate(0, 0.0).unwrap().heading
    };
    let [nearer_blocked, nearer_clear] = [believed(&[body.unwrap()]), believed(&[])];
    assert!(nearer_blocked.x > 0.8, "the user faces away from the nearer LED: {nearer_blocked:?}");
    assert!(nearer_clear.x < -0.1, "any other heading: {nearer_clear:?}");
}

#[test]
fn the_gain_of_the_farther_led_shows_an_obstacle_before_the_nearer_one() {
    let leds = "led.positions_m=[[0,0.2,3],[0,-2.3,3]]";
    let scenario = hall(&[leds, "blockage.bodies=false"]);
    let model = scenario.channel_model().unwrap();
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
    let scenario = hall(&["blockage.body_height_m=0.9"]);
    let model = scenario.channel_model().unwrap();
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
