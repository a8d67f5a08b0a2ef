//! Where a method of the belief does not apply to a room, and other conditions that change a result
//! without an error.

mod ages;
mod range;
mod unused;
mod upright;
mod walks;

use std::fmt;

use heliostat_channel::{ChannelModel, Vec3, los};
use heliostat_scenario::{self as scenario, AssumedTilt, MismatchLevel, MobilityModel, Scenario, UserOrientation};
use serde::Serialize;

pub use unused::unused_keys;

use crate::belief::{channel_evidence::SPREAD_OF_DIRECT, device::AZIMUTH_SPREAD_RAD, tilt};

/// Difference in degrees between an angle of receivers, or its standard deviation, and the assumed one that changes
/// results.
const TILT_DIFFERENCE_DEG: f64 = 5.0;

/// A method that does not apply to a room, or a promise that does not hold in it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Condition {
    /// The method.
    pub method: String,
    /// The keys of the scenario that exclude it.
    pub because: String,
    /// What the controller does in its place, and what a user of the program can do.
    pub consequence: String,
}

impl fmt::Display for Condition {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{} does not apply: {}: {}", self.method, self.because, self.consequence)
    }
}

/// The methods that do not apply to a valid scenario.
pub fn conditions(scenario: &Scenario, model: &ChannelModel) -> Vec<Condition> {
    let mut found: Vec<Condition> = small_range(scenario, model).into_iter().chain(unused_keys(scenario)).collect();
    let mut add = |method: &str, because: Option<String>, consequence: &str| {
        let of = |because| Condition { method: method.into(), because, consequence: consequence.into() };
        found.extend(because.map(of));
    };
    add(
        "any decision",
        ages::refused_positions(scenario),
        "every position report is too old and no command is sent; raise control.report_age_max_ms",
    );
    add(
        "the use of measured gains in each decision",
        ages::gap_between_readings(scenario),
        "decisions between fall back to modelled gains, which know no blocked path; raise control.report_age_max_ms, or the rate",
    );
    add(
        "the use of reported orientations",
        ages::refused_orientations(scenario),
        "every report is too old and refused, so receivers are held as if none were reported; lower the latency, or raise control.report_age_max_ms",
    );
    add(
        "the use of reported orientations in each decision",
        ages::gap_between_orientations(scenario),
        "decisions between take receivers as if no orientation were reported; set control.belief to \"filter\", raise control.report_age_max_ms, or the rate",
    );
    add(
        "a valid command until the next one",
        ages::gap_between_commands(scenario),
        "the array holds the angles of an expired command for the driver's park_after_ms, then parks until the next report; raise control.validity_ms above the time between two reports that arrive",
    );
    let (mismatch, users) = (&scenario.mismatch, &scenario.users);
    let level = || format!("mismatch.level = \"{}\"", mismatch.level.name());
    add(
        "the channel model of belief and policies",
        (mismatch.level != MismatchLevel::None).then(level),
        "they assume the nominal room, and the oracle knows the true one, so ratios are lower; calibrate the mirrors",
    );
    let unknown = mismatch.unknown_leds_m.len();
    let (leds, light) = if unknown == 1 { ("LED", "its light") } else { ("LEDs", "their light") };
    add(
        "the channel model of belief and policies",
        (unknown > 0)
            .then(|| format!("mismatch.unknown_leds_m has {unknown} {leds} that the controller does not know")),
        &format!("{light} counts as another heading or LED, so ratios are lower; name each LED in led.positions_m"),
    );
    if let Some((because, consequence)) = upright::counted_upright(scenario, model) {
        add("the orientation of receivers that users hold", Some(because), consequence);
    }
    add(
        "the assumed tilt of receivers that users hold",
        upright::counted_tilted(scenario),
        "expected gains are those of tilted receivers, so ratios are lower; describe the receivers by users.orientation, or set both angles of control.tilt to 0",
    );
    if scenario.control.belief != scenario::Belief::Filter {
        let because = format!("control.belief = \"{}\"", scenario.control.belief);
        add("the filter", Some(because), "headings, tilts and obstacles are not inferred; set it to \"filter\"");
        return found;
    }
    let forced = scenario.blockage.forced_users;
    add(
        "the cause of a blocked path",
        (forced > 0).then(|| format!("blockage.forced_users = {forced}")),
        "no body or obstacle blocks a forced path, so the gains show headings and obstacles that do not exist, above all with several LEDs; block paths by blockage.bodies and blockage.obstacles_per_m2",
    );
    let is_reported = ages::accepted_orientations(scenario).is_some();
    add(
        "the heading of a standing user by measured gains",
        (!scenario.blockage.bodies && !is_reported).then(|| "blockage.bodies = false".to_owned()),
        "the gains show neither headings nor tilted receivers; report orientations",
    );
    add(
        "the tilt of a receiver by measured gains",
        (!tilt::is_single_open_detector(model) && !is_reported).then(|| format!("receiver: {}", receiver(model))),
        "an expected gain is that at the mean heading; report orientations, or use one detector that faces up with a field of view of 90 degrees",
    );
    let held = if is_reported { Vec::new() } else { users.orientations() };
    let tilted = || held.iter().filter_map(|(key, held)| Some((key.as_str(), (*held)?)));
    let upright = held.iter().find(|(_, held)| held.is_none()).map(|(key, _)| key);
    add(
        "one tilt for the receivers of all users",
        upright.zip(tilted().next()).map(|(upright, (tilted, _))| {
            format!("receivers of some users face up ({upright}), and others are tilted ({tilted})")
        }),
        "all receivers count as tilted or all as facing up, so expected gains of some users are wrong; report orientations",
    );
    let assumed = scenario.control.tilt.unwrap_or_default();
    add(
        "the assumed tilt of receivers that users hold",
        tilted().find_map(|(key, held)| differing_mean(key, held, &assumed)),
        "expected gains are those at the assumed tilt, so ratios are lower; set both angles of control.tilt to those of the users",
    );
    add(
        "the assumed spread of the angles of receivers that users hold",
        tilted().find_map(|(key, held)| wider_spread(key, held)),
        "expected gains and headings count as more certain than they are, so ratios are lower; report orientations",
    );
    let (channel, direct) = (&scenario.streams.channel, largest_direct_gain(scenario, model));
    let noise = channel.noise_relative;
    add(
        "the likelihood of measured direct gains",
        (noise > SPREAD_OF_DIRECT)
            .then(|| format!("streams.channel.noise_relative = {noise}, above {SPREAD_OF_DIRECT}")),
        "gains count as more exact than they are, so serving LEDs and headings can be wrong; average several readings for a report",
    );
    let is_coarse = |gain: f64| direct != 0.0 && gain > SPREAD_OF_DIRECT * direct;
    let above = format!("above {SPREAD_OF_DIRECT} of the direct gain below an LED, {direct:.1e}");
    let (noise_gain, bits, full_scale) = (channel.noise_gain, channel.resolution_bits, channel.full_scale_gain);
    add(
        "the evidence of measured gains",
        is_coarse(noise_gain).then(|| format!("streams.channel.noise_gain = {noise_gain:e}, {above}")),
        "paths within the noise count as blocked, and the others show little of headings and obstacles; average several readings for a report",
    );
    let step = channel.step_gain();
    let steps = || {
        format!(
            "streams.channel.resolution_bits = {bits} and full_scale_gain = {full_scale:e} make steps of {step:.1e}, {above}"
        )
    };
    add(
        "the evidence of measured gains",
        is_coarse(step).then(steps),
        "gains below half a step count as blocked, and the others show little of headings and obstacles; raise resolution_bits, or lower full_scale_gain",
    );
    let below = || {
        format!("streams.channel.full_scale_gain = {full_scale:e}, below the direct gain below an LED, {direct:.1e}")
    };
    add(
        "the evidence of measured gains",
        (bits > 0 && full_scale < direct).then(below),
        "receivers near an LED report full_scale_gain, so headings and serving LEDs can be wrong; raise full_scale_gain",
    );
    add(
        "the heading of a user by the direction of the walk",
        walks::late_heading(scenario),
        "on curves bodies and tilted receivers are elsewhere than the belief takes for certain; lower the lag, or the latency",
    );
    add(
        "the assumed speed of walks",
        walks::too_fast(scenario),
        "the belief follows turns late, or takes a fast user for another one; raise control.walk.speed_m_s to the speed in the room",
    );
    add(
        "the prediction of walks until a command acts",
        walks::too_far_ahead(scenario),
        "the ellipses of the belief are too small, and light misses users who stop or turn; raise the rate of the reports, or lower their latency",
    );
    let varies = walks::models(users).any(|model| model == MobilityModel::GaussMarkov);
    add(
        "the hypotheses about walks",
        varies.then(|| "users.mobility = \"gauss-markov\"".to_owned()),
        "speed and direction change at every report, and the ellipses of the belief are too small",
    );
    found
}

/// The condition of a room in which the range of the mirrors leaves a part of the floor without their light.
pub fn small_range(scenario: &Scenario, model: &ChannelModel) -> Option<Condition> {
    let range::SmallRange { because, advice } = range::too_small(scenario, model)?;
    let consequence = format!("users elsewhere get none; {advice}");
    Some(Condition { method: "light by mirrors on all of the floor".into(), because, consequence })
}

/// A mean tilt of held receivers that is not the assumed one.
fn differing_mean(key: &str, held: &UserOrientation, assumed: &AssumedTilt) -> Option<String> {
    let angles = [
        ("walking", held.walking_polar_mean_deg, assumed.walking_deg),
        ("sitting", held.sitting_polar_mean_deg, assumed.sitting_deg),
    ];
    let (posture, held, assumed) =
        angles.into_iter().find(|(_, held, assumed)| (held - assumed).abs() > TILT_DIFFERENCE_DEG)?;
    Some(format!("{key}.{posture}_polar_mean_deg = {held}, and the belief assumes {assumed} degrees"))
}

/// A standard deviation of the angles of held receivers above the one that the belief assumes.
fn wider_spread(key: &str, held: &UserOrientation) -> Option<String> {
    let angles = [
        ("walking_polar", held.walking_polar_std_deg, tilt::POLAR_SPREAD_RAD),
        ("walking_azimuth", held.walking_azimuth_std_deg, AZIMUTH_SPREAD_RAD),
        ("sitting_polar", held.sitting_polar_std_deg, tilt::POLAR_SPREAD_RAD),
        ("sitting_azimuth", held.sitting_azimuth_std_deg, AZIMUTH_SPREAD_RAD),
    ];
    let mut angles = angles.into_iter().map(|(angle, held, assumed)| (angle, held, assumed.to_degrees()));
    let (angle, held, assumed) = angles.find(|(_, held, assumed)| held - assumed > TILT_DIFFERENCE_DEG)?;
    Some(format!("{key}.{angle}_std_deg = {held}, and the belief assumes {assumed:.1} degrees"))
}

/// The largest direct gain of an upright receiver straight below an LED; 0 where none detects it.
fn largest_direct_gain(scenario: &Scenario, model: &ChannelModel) -> f64 {
    let below = model.leds.iter().map(|led| {
        let detector = Vec3::new(led.position.x, led.position.y, scenario.receiver.height_m);
        los::combined_gain(led, &model.receiver, &detector).unwrap_or(0.0)
    });
    below.fold(0.0, f64::max)
}

/// The branches of a receiver in a few words.
fn receiver(model: &ChannelModel) -> String {
    match &model.receiver.branches[..] {
        [only] if only.normal == Vec3::z() => {
            format!("a field of view of {:.0} degrees", only.fov_semi_angle.to_degrees())
        }
        [_] => "a detector that does not face up".to_owned(),
        branches => format!("{} branches", branches.len()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(overrides: &[&str]) -> Vec<String> {
        let scenario = Scenario::builtin("hall").unwrap().with_overrides(overrides).unwrap();
        let found = conditions(&scenario, &scenario.channel_model().unwrap());
        found.iter().map(ToString::to_string).collect()
    }

    #[test]
    fn each_method_that_does_not_apply_is_named_with_its_key() {
        assert!(of(&[]).is_empty(), "{:?}", of(&[]));
        for (change, key) in [
            ("blockage.bodies=false", "blockage.bodies = false"),
            ("blockage.forced_users=2", "blockage.forced_users = 2"),
            ("receiver.preset=angle-diversity", "7 branches"),
            ("receiver.fov_deg=60", "a field of view of 60 degrees"),
            ("streams.channel.noise_relative=0.2", "streams.channel.noise_relative = 0.2"),
            ("streams.channel.noise_gain=1e-6", "streams.channel.noise_gain = 1e-6, above 0.08 of the direct gain"),
            ("users.mobility=gauss-markov", "gauss-markov"),
            ("streams.positions.latency_ms=2000", "streams.positions.latency_ms = 2000"),
            ("streams.channel.rate_hz=0.5", "readings become 2"),
            ("streams.channel.loss=0.9", "lets 66 % of the readings become older"),
            ("streams.positions.loss=0.5", "lets 6 % of the commands expire"),
            ("users.orientation.walking_polar_mean_deg=0", "walking_polar_mean_deg = 0, and the belief assumes 29.67"),
            (
                "users.orientation.sitting_azimuth_std_deg=60",
                "sitting_azimuth_std_deg = 60, and the belief assumes 7.4 degrees",
            ),
            ("users.orientation.sitting_polar_std_deg=30", "sitting_polar_std_deg = 30, and the belief assumes 7.7"),
            ("control.tilt={}", "without users.orientation every receiver faces up"),
            ("mismatch.level=typical", "mismatch.level = \"typical\""),
            (
                "mismatch.unknown_leds_m=[[1,1,3]]",
                "unknown_leds_m has 1 LED that the controller does not know: its light",
            ),
            ("mismatch.unknown_leds_m=[[1,1,3],[-1,1,3]]", "has 2 LEDs that the controller does not know: their light"),
            ("users.mixture=[{mobility=\"seated\",count=2}]", "users.mobility is another model"),
            ("users.seats_m=[[1,1]]", "no user of users.mobility"),
            ("control.range_deg=12", "control.range_deg = 12.0, within which mirrors reach"),
            ("users.heading_lag_s=1", "users.heading_lag_s = 1: 45.0 degrees behind"),
            ("users.speed_max_m_s=3", "users walk at up to 3.00 m/s"),
            ("streams.positions.latency_ms=450", "latency_ms = 450: a user is predicted 500 ms ahead"),
        ] {
            let found = of(&[change]);
            assert!(found.len() == 1 && found[0].contains(key), "{change}: {found:?}");
        }
        let held = ["users.orientation.walking_polar_mean_deg=0", "control.tilt.walking_deg=0"];
        assert!(of(&held).is_empty(), "{:?}", of(&held));
        for answer in ["streams.orientation.rate_hz=10", "users.orientation.model=up"] {
            let answered = of(&["users.orientation.sitting_polar_std_deg=30", answer]);
            assert!(answered.is_empty(), "{answer}: {answered:?}");
        }
        let converter = |bits: u32, full_scale: f64| {
            let bits = format!("streams.channel.resolution_bits={bits}");
            of(&[&bits, &format!("streams.channel.full_scale_gain={full_scale}")])
        };
        assert!(converter(12, 2e-5).is_empty(), "{:?}", converter(12, 2e-5));
        for ((bits, full_scale), key) in
            [((4, 2e-5), "resolution_bits = 4 and"), ((12, 1e-7), "full_scale_gain = 1e-7")]
        {
            let found = converter(bits, full_scale);
            assert!(found.len() == 1 && found[0].contains(key), "{key}: {found:?}");
        }
        assert_eq!(of(&["mismatch.level=rough", "mismatch.unknown_leds_m=[[1,1,3]]"]).len(), 2);
        assert_eq!(of(&["control.belief=none", "blockage.bodies=false"]).len(), 1, "no filter, no methods");
    }

    #[test]
    fn a_command_that_expires_before_the_next_report_is_a_condition() {
        // A slow user, whose stops move the light little.
        let slow =
            |more: &[&str]| of(&[&["streams.positions.rate_hz=1", "users.speed_max_m_s=0.2"][..], more].concat());
        let found = slow(&[]);
        assert!(found.len() == 1 && found[0].contains("control.validity_ms = 400, and"), "{found:?}");
        assert!(found[0].contains("a command each 1000.0 ms: "), "{found:?}");
        let repeated = slow(&["control.validity_ms=600", "control.when_silent=last-good"]);
        assert!(repeated.is_empty(), "{repeated:?}");
        let long = slow(&["control.validity_ms=1000"]);
        assert!(long.is_empty(), "{long:?}");
        let without_filter = slow(&["control.belief=none"]);
        assert_eq!(without_filter.len(), 2, "{without_filter:?}");
    }

    #[test]
    fn the_direct_gain_below_an_led_is_that_of_equation_1() {
        let scenario = Scenario::builtin("hall").unwrap().with_overrides(&["led.positions_m=[[1,0,3]]"]).unwrap();
        let model = scenario.channel_model().unwrap();
        let (led, distance_m) = (&model.leds[0], 3.0 - scenario.receiver.height_m);
        let expected = (led.lambertian_order() + 1.0) * model.receiver.detector_area_m2 * model.receiver.filter_gain
            / (2.0 * std::f64::consts::PI * distance_m.powi(2));
        let expected = expected * model.receiver.concentrator_gain(&model.receiver.branches[0]);
        // A panel is not a point.
        let found = largest_direct_gain(&scenario, &model);
        assert!((found / expected - 1.0).abs() < 0.05, "{found:e} {expected:e}");
    }

    #[test]
    fn reports_of_orientations_answer_the_conditions_that_advise_them() {
        for change in ["receiver.fov_deg=60", "receiver.preset=angle-diversity", "blockage.bodies=false"] {
            assert!(of(&[change])[0].contains("report orientations"), "{change}");
            let reported = of(&[change, "users.orientation={}", "streams.orientation.rate_hz=10"]);
            assert!(reported.is_empty(), "{change}: {reported:?}");
        }
    }

    #[test]
    fn orientation_reports_that_are_too_old_are_named_and_answer_no_condition() {
        let late = ["streams.orientation.rate_hz=10", "streams.orientation.latency_ms=600"];
        let found = of(&[&["users.orientation={}", "users.mobility=seated"][..], &late].concat());
        assert!(found.len() == 1 && found[0].contains("streams.orientation.latency_ms = 600, above"), "{found:?}");
        let accepted = [&late[..], &["users.mobility=seated", "control.report_age_max_ms=700"]].concat();
        assert!(of(&accepted).is_empty(), "{:?}", of(&accepted));
        let narrow = of(&[&["receiver.fov_deg=60", "users.orientation={}"][..], &late].concat());
        for expected in ["latency_ms = 600", "every receiver counts as facing up", "a field of view of 60 degrees"] {
            assert!(narrow.iter().any(|text| text.contains(expected)), "{expected}: {narrow:?}");
        }
        let rare = ["streams.orientation.rate_hz=1"];
        assert!(of(&rare).is_empty(), "the filter keeps what a report has shown: {:?}", of(&rare));
        let found = of(&["streams.orientation.rate_hz=1", "control.belief=none"]);
        assert!(found.iter().any(|text| text.contains("reports become 1000 ms old")), "{found:?}");
    }

    #[test]
    fn the_orientations_of_the_entries_of_a_mixture_are_those_of_the_conditions() {
        let mixed = |own: &str, more: &[&str]| {
            let entries =
                format!("users.mixture=[{{mobility=\"seated\",count=2{own}}},{{mobility=\"seated\",share=1}}]");
            of(&[&["users.mobility=mixture", &entries][..], more].concat())
        };
        let tilted = ["users.orientation={}"];
        assert!(mixed("", &[]).is_empty() && mixed("", &tilted).is_empty());
        assert!(mixed(",orientation={}", &tilted).is_empty(), "the same angles");
        for (own, more, expected) in [
            (
                ",orientation={}",
                &[][..],
                "face up (users.orientation), and others are tilted (users.mixture.0.orientation)",
            ),
            (
                ",orientation={model=\"up\"}",
                &tilted[..],
                "face up (users.mixture.0.orientation), and others are tilted",
            ),
            (
                ",orientation={sitting_polar_mean_deg=70}",
                &tilted[..],
                "users.mixture.0.orientation.sitting_polar_mean_deg = 70, and the belief assumes 41.39",
            ),
        ] {
            let found = mixed(own, more);
            assert!(found.len() == 1 && found[0].contains(expected), "{own}: {found:?}");
            let reported = mixed(own, &[more, &["streams.orientation.rate_hz=10"]].concat());
            assert!(reported.is_empty(), "{own}: {reported:?}");
        }
        let trace = ["users.trace=walk.csv"];
        let found = mixed(",orientation={model=\"up\"}", &trace);
        assert!(found.iter().any(|text| text.contains("orientation in users.mixture")), "{found:?}");
        let twice = "users.mixture=[{mobility=\"seated\",share=1,orientation={}}]";
        let found = of(&["users.mobility=mixture", twice, "users.orientation.model=up"]);
        assert!(found.len() == 1 && found[0].starts_with("users.orientation does not apply"), "{found:?}");
    }

    #[test]
    fn an_assumed_tilt_is_advised_only_where_it_has_an_effect() {
        let advised = |change: &str| {
            let found = of(&[change, "users.orientation={}"]);
            found.iter().filter(|text| text.contains("control.tilt]")).count()
        };
        assert_eq!(advised("blockage.bodies=false"), 1);
        assert_eq!([advised("receiver.fov_deg=60"), advised("receiver.preset=angle-diversity")], [0, 0]);
    }
}
