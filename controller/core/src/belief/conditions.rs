//! Where a method of the belief does not apply to a room.

use std::fmt;

use heliostat_channel::ChannelModel;
use heliostat_scenario::{self as scenario, MobilityModel, Scenario};
use serde::Serialize;

use crate::belief::{body::Body, channel_evidence::SPREAD_OF_DIRECT, tilt};

/// A method of the belief that does not apply to a room.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Condition {
    /// The method.
    pub method: &'static str,
    /// The keys of the scenario that exclude it.
    pub because: String,
    /// What the controller does in its place, and what a user of the program can do.
    pub consequence: &'static str,
}

impl fmt::Display for Condition {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{} does not apply: {}: {}", self.method, self.because, self.consequence)
    }
}

/// The methods that do not apply to a valid scenario.
pub fn conditions(scenario: &Scenario, model: &ChannelModel) -> Vec<Condition> {
    let mut found = Vec::new();
    let mut add = |applies: bool, method, because: String, consequence| {
        if !applies {
            found.push(Condition { method, because, consequence });
        }
    };
    if scenario.control.belief != scenario::Belief::Filter {
        let because = format!("control.belief = \"{}\"", scenario.control.belief);
        add(false, "the filter", because, "headings, tilts and obstacles are not inferred; set it to \"filter\"");
        return found;
    }
    add(
        Body::new(&scenario.blockage).is_some(),
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
    let noise = scenario.streams.channel.noise_relative;
    add(
        noise <= SPREAD_OF_DIRECT,
        "the likelihood of measured direct gains",
        format!("streams.channel.noise_relative = {noise}, above {SPREAD_OF_DIRECT}"),
        "gains count as more exact than they are, so serving LEDs and headings can be wrong; average several readings for a report",
    );
    let users = &scenario.users;
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
        let overrides: Vec<String> = overrides.iter().map(|text| (*text).to_owned()).collect();
        let scenario = Scenario::builtin("hall").unwrap().with_overrides(&overrides).unwrap();
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
        ] {
            let found = of(&[change]);
            assert!(found.len() == 1 && found[0].contains(key), "{change}: {found:?}");
        }
        assert_eq!(of(&["control.belief=none", "blockage.bodies=false"]).len(), 1, "no filter, no methods");
    }
}
