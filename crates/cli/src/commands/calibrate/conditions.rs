//! What a calibration takes to hold in a room where it may not.

use heliostat_calibrate::Place;
use heliostat_calibrate::optics::Optics;
use heliostat_calibrate::probes::READINGS_MAX;
use heliostat_calibrate::signal::Signal;
use heliostat_core::belief::conditions::Condition;
use heliostat_scenario::Scenario;

/// What a user of the program can do where the light of single mirrors is too weak.
pub const STRONGER: &str =
    "choose spots nearer to the mirrors, or average more readings for a report and publish reports more often";

/// The conditions that do not hold, for an array and the spots of its calibration.
pub fn conditions(scenario: &Scenario, array: usize, spots: &[Place]) -> Vec<Condition> {
    tilted(scenario).into_iter().chain(weak(scenario, array, spots)).collect()
}

fn tilted(scenario: &Scenario) -> Option<Condition> {
    scenario.has_tilted_receivers().then(|| Condition {
        method: "the calibration with a tilted receiver".to_owned(),
        because: "users.orientation.model = \"measured\"".to_owned(),
        consequence: "put the receiver down level at each spot; that of a simulated user is tilted, so simulate the \
                      calibration with users.orientation.model = \"up\""
            .to_owned(),
    })
}

fn weak(scenario: &Scenario, array: usize, spots: &[Place]) -> Option<Condition> {
    let optics = Optics::new(&scenario.channel_model().ok()?, array)?;
    let stream = &scenario.streams.channel;
    let mirrors = optics.centres.len();
    let signal = Signal::weakest(&optics, stated(spots), stream.gain_variance().sqrt())?;
    let group = signal.group(stream.noise_relative, mirrors);
    if !signal.in_groups(group, stream.noise_relative).is_weak() {
        return None;
    }
    let readings = mirrors * spots.len() * READINGS_MAX as usize;
    let minutes = readings as f64 / stream.rate_hz / 60.0;
    Some(Condition {
        method: "the measurement of single mirrors".to_owned(),
        because: format!(
            "the light of a mirror at spot {} is a gain of {:.1e}, {:.1} times the noise of a reading by \
             streams.channel",
            signal.place + 1,
            signal.gain,
            signal.ratio
        ),
        consequence: format!(
            "few mirrors are located, also in groups of {group}, after up to {readings} readings, about \
             {minutes:.0} min without the walks; {STRONGER}"
        ),
    })
}

/// The spots whose place is stated, by index: x, y and height in m.
fn stated(spots: &[Place]) -> impl Iterator<Item = (usize, [f64; 3])> {
    let place = |spot: &Place| spot.floor_m.map(|[x, y]| [x, y, spot.height_m]);
    spots.iter().enumerate().filter_map(move |(index, spot)| Some((index, place(spot)?)))
}

#[cfg(test)]
mod tests {
    use heliostat_calibrate::places::default_spots;

    use super::*;

    #[test]
    fn light_of_single_mirrors_in_the_noise_is_a_condition_with_the_time_that_it_would_take() {
        let scenario = |noise_gain: f64| {
            let large = ["mirrors.rows=20", "mirrors.columns=20", "mirrors.width_m=0.1", "mirrors.height_m=0.05"];
            let noise = format!("streams.channel.noise_gain={noise_gain:.15}");
            let stream = ["streams.channel.rate_hz=20", "streams.channel.resolution_bits=0", &noise];
            let changes = [&large[..], &stream].concat();
            Scenario::builtin("hall").expect("a scenario").with_overrides(&changes).expect("a valid change")
        };
        let exact = scenario(0.0);
        let spots = default_spots(&exact);
        assert_eq!(conditions(&exact, 0, &spots), []);
        let optics = Optics::new(&exact.channel_model().expect("a room"), 0).expect("one branch");
        let gain = Signal::weakest(&optics, stated(&spots), 1.0).expect("stated spots").gain;
        assert!(gain > 1e-12, "{gain}");
        // Single mirrors suffice, then groups of them.
        assert_eq!(conditions(&scenario(gain / 5.0), 0, &spots), []);
        assert_eq!(conditions(&scenario(gain / 2.0), 0, &spots), []);
        let found = conditions(&scenario(gain / 0.5), 0, &spots);
        let [condition] = found.as_slice() else { panic!("{found:?}") };
        let text = condition.to_string();
        assert!(text.contains("0.5 times the noise of a reading"), "{text}");
        assert!(
            text.contains(
                "groups of 31, after up to 12000 readings, about 10 min without the walks; choose spots nearer"
            ),
            "{text}"
        );
    }
}
