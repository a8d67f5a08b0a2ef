//! Where a method of the belief does not apply to a room, and other conditions that change a result
//! without an error.

use std::fmt;

use heliostat_channel::ChannelModel;
use heliostat_scenario::{self as scenario, MismatchLevel, MobilityModel, OrientationModel, Scenario};
use serde::Serialize;

use crate::belief::{channel_evidence::SPREAD_OF_DIRECT, tilt};

/// Difference in degrees between the mean tilt of receivers and the assumed one that changes results.
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
    let mut found = Vec::new();
    let mut add = |applies: bool, method: &str, because: String, consequence: &str| {
        if !applies {
            found.push(Condition { method: method.into(), because, consequence: consequence.into() });
        }
    };
    let (streams, age_max_ms) = (&scenario.streams, scenario.control.report_age_max_ms);
    let positions_ms = streams.positions.latency_ms;
    add(
        positions_ms <= age_max_ms,
        "any decision",
        format!("streams.positions.latency_ms = {positions_ms}, above control.report_age_max_ms = {age_max_ms}"),
        "every position report is too old and no command is sent; raise control.report_age_max_ms",
    );
    // The age of a reading just before the next one arrives.
    let gains_ms = streams.channel.latency_ms + 1e3 / streams.channel.rate_hz;
    add(
        gains_ms <= age_max_ms,
        "the use of measured gains in each decision",
        format!(
            "streams.channel: readings become {gains_ms:.0} ms old, above control.report_age_max_ms = {age_max_ms}"
        ),
        "decisions between fall back to modelled gains, which know no blocked path; raise control.report_age_max_ms, or the rate",
    );
    let (mismatch, users) = (&scenario.mismatch, &scenario.users);
    add(
        mismatch.level == MismatchLevel::None,
        "the channel model of belief and policies",
        format!("mismatch.level = \"{}\"", mismatch.level.name()),
        "they assume the nominal room, and the oracle knows the true one, so ratios are lower; calibrate the mirrors",
    );
    add(
        mismatch.unknown_leds_m.is_empty(),
        "the channel model of belief and policies",
        format!("LEDs that the controller does not know: {} in mismatch.unknown_leds_m", mismatch.unknown_leds_m.len()),
        "their light counts as another heading or LED, so ratios are lower; name each LED in led.positions_m",
    );
    let is_mixed = users.mobility == MobilityModel::Mixture;
    add(
        users.mixture.is_empty() || is_mixed,
        "users.mixture",
        "users.mobility is another model".to_owned(),
        "all users walk by that model; set users.mobility to \"mixture\"",
    );
    let is_seated = |model: MobilityModel| model == MobilityModel::Seated;
    add(
        users.seats_m.is_empty()
            || is_seated(users.mobility)
            || users.mixture.iter().any(|entry| is_seated(entry.mobility)),
        "users.seats_m",
        "no user of users.mobility or users.mixture is seated".to_owned(),
        "the places have no effect; set users.mobility to \"seated\", or to \"mixture\" with an entry \"seated\" in users.mixture",
    );
    if scenario.control.belief != scenario::Belief::Filter {
        let because = format!("control.belief = \"{}\"", scenario.control.belief);
        add(false, "the filter", because, "headings, tilts and obstacles are not inferred; set it to \"filter\"");
        return found;
    }
    add(
        scenario.blockage.bodies,
        "the heading of a standing user by measured gains",
        "blockage.bodies = false".to_owned(),
        "the gains show neither headings nor tilted receivers; report orientations",
    );
    add(
        tilt::is_single_open_detector(model),
        "the tilt of a receiver by measured gains",
        format!("receiver: {}", receiver(model)),
        "an expected gain is that at the mean heading; report orientations, or use one detector that faces up with a field of view of 90 degrees",
    );
    add(
        scenario.users.orientation.is_none()
            || streams.orientation.is_some()
            || scenario.control.tilt.is_some()
            || (tilt::is_single_open_detector(model) && scenario.blockage.bodies),
        "the orientation of receivers that users hold",
        "users.orientation, without streams.orientation and without control.tilt".to_owned(),
        "every receiver counts as facing up; add the table [control.tilt], or report orientations",
    );
    let assumed = scenario.control.tilt.unwrap_or_default();
    let differing = users.orientation.iter().filter(|_| streams.orientation.is_none()).find_map(|held| {
        let angles = [
            ("walking", held.walking_polar_mean_deg, assumed.walking_deg),
            ("sitting", held.sitting_polar_mean_deg, assumed.sitting_deg),
        ];
        let mut of_model = angles.into_iter().filter(|_| held.model == OrientationModel::Measured);
        of_model.find(|(_, held, assumed)| (held - assumed).abs() > TILT_DIFFERENCE_DEG)
    });
    let because = differing.map(|(posture, held, assumed)| {
        format!("users.orientation.{posture}_polar_mean_deg = {held}, and the belief assumes {assumed} degrees")
    });
    add(
        because.is_none(),
        "the assumed tilt of receivers that users hold",
        because.unwrap_or_default(),
        "expected gains are those at the assumed tilt, so ratios are lower; set both angles of control.tilt to those of the users",
    );
    let noise = scenario.streams.channel.noise_relative;
    add(
        noise <= SPREAD_OF_DIRECT,
        "the likelihood of measured direct gains",
        format!("streams.channel.noise_relative = {noise}, above {SPREAD_OF_DIRECT}"),
        "gains count as more exact than they are, so serving LEDs and headings can be wrong; average several readings for a report",
    );
    let mut models = users.mixture.iter().map(|entry| entry.mobility).chain([users.mobility]);
    add(
        !models.any(|model| model == MobilityModel::GaussMarkov),
        "the hypotheses about walks",
        "users.mobility = \"gauss-markov\"".to_owned(),
        "speed and direction change at every report, and the ellipses of the belief are too small",
    );
    found
}

/// The branches of a receiver in a few words.
fn receiver(model: &ChannelModel) -> String {
    match &model.receiver.branches[..] {
        [only] if only.normal == heliostat_channel::Vec3::z() => {
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
            ("receiver.preset=angle-diversity", "7 branches"),
            ("receiver.fov_deg=60", "a field of view of 60 degrees"),
            ("streams.channel.noise_relative=0.2", "streams.channel.noise_relative = 0.2"),
            ("users.mobility=gauss-markov", "gauss-markov"),
            ("streams.positions.latency_ms=2000", "streams.positions.latency_ms = 2000"),
            ("streams.channel.rate_hz=0.5", "readings become 2"),
            ("users.orientation.walking_polar_mean_deg=0", "walking_polar_mean_deg = 0, and the belief assumes 29.67"),
            ("mismatch.level=typical", "mismatch.level = \"typical\""),
            ("mismatch.unknown_leds_m=[[1,1,3]]", "1 in mismatch.unknown_leds_m"),
            ("users.mixture=[{mobility=\"seated\",count=2}]", "users.mobility is another model"),
            ("users.seats_m=[[1,1]]", "no user of users.mobility"),
        ] {
            let found = of(&[change]);
            assert!(found.len() == 1 && found[0].contains(key), "{change}: {found:?}");
        }
        let held = ["users.orientation.walking_polar_mean_deg=0", "control.tilt.walking_deg=0"];
        assert!(of(&held).is_empty(), "{:?}", of(&held));
        assert_eq!(of(&["mismatch.level=rough", "mismatch.unknown_leds_m=[[1,1,3]]"]).len(), 2);
        assert_eq!(of(&["control.belief=none", "blockage.bodies=false"]).len(), 1, "no filter, no methods");
    }
}
