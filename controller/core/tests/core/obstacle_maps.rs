//! The map of unreported obstacles by measured gains over the mirrors: what the reports of a user
//! who stays at a place show.

use heliostat_channel::{ChannelModel, Orientation, Scene, Vec3, decode::aim_at_point, mirrors::MirrorAngles};
use heliostat_proto::MirrorCommand;

use crate::support::{hall, report_gains};

/// Where a user of `hall` stays.
const PLACE: Vec3 = Vec3::new(0.8, -0.6, 0.85);

/// Reports of the user, ten a second.
const REPORTS: u64 = 10;

/// The angles of mirrors that are aimed at the user.
fn aimed(model: &ChannelModel) -> MirrorAngles {
    let mut angles = MirrorAngles::flat(model.mirrors.len());
    aim_at_point(model, &PLACE, &mut angles);
    angles
}

/// The gains of the user, direct and over the mirrors.
fn gains(model: &ChannelModel, held: Orientation) -> [f64; 2] {
    let mut scene = Scene::new(model, 1);
    scene.update_turned(model, &[PLACE], &[held], &[], &[false]);
    let mut reflected = [0.0];
    scene.irs_gain(model, &aimed(model), &mut reflected);
    [scene.los_gain()[0], reflected[0]]
}

/// The least probability, over the columns of mirrors, that no unreported obstacle blocks the path
/// from the user, after reports of gains of a receiver held so, of which `share` arrives by the
/// mirrors.
fn unobstructed(overrides: &[&str], held: Orientation, share: f64) -> f64 {
    let (scenario, model, mut belief) = hall(overrides);
    let [direct, reflected] = gains(&model, held);
    let angles = aimed(&model);
    let [roll, yaw] = [&angles.roll, &angles.yaw].map(|each| each.iter().map(|angle| *angle as f32).collect());
    let command = MirrorCommand { time_ns: 1, validity_ms: 60_000, roll, yaw, ..MirrorCommand::default() };
    belief.handle_command(&command);
    let measured = [[direct, share * reflected]];
    (10..10 + REPORTS).for_each(|tick| report_gains(&mut belief, &model, tick, &[PLACE], (&measured, None)));
    let mut columns = vec![1.0; scenario.mirrors.columns()];
    assert!(belief.unobstructed(&PLACE, &mut columns), "the map exists");
    columns.into_iter().fold(1.0, f64::min)
}

#[test]
fn reports_of_a_user_who_stays_show_less_than_independent_ones() {
    let at = |rate| unobstructed(&["blockage.bodies=false", rate], Orientation::UPRIGHT, 0.3);
    let (correlated, independent) = (at("streams.channel.rate_hz=10"), at("streams.channel.rate_hz=0.1"));
    assert!(independent < 0.5, "reports 10 s apart show an obstacle: {independent}");
    assert!(correlated > 0.85, "those of one second do not: {correlated}");
}

#[test]
fn missing_light_of_a_tilted_receiver_shows_no_obstacle_where_the_angle_explains_it() {
    let independent = "streams.channel.rate_hz=0.1";
    // The true polar angle is 12 degrees larger than the assumed mean.
    let held = Orientation::from_polar_azimuth(53.0_f64.to_radians(), 225.0_f64.to_radians());
    let tilted = unobstructed(&[independent, "control.tilt={}"], held, 0.7);
    assert!(tilted > 0.9, "{tilted}");
    let upright = unobstructed(&[independent, "blockage.bodies=false"], Orientation::UPRIGHT, 0.3);
    assert!(upright < 0.5, "an upright receiver shows one: {upright}");
}
