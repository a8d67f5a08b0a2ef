//! Bounds of the fields of a log, which may come from any file.

use std::collections::BTreeMap;
use std::fmt::{Debug, Display};
use std::ops::RangeInclusive;

use heliostat_channel::Vec3;

use super::refinement::FORMER_PLACE;
use super::stages::TRACKED_MIN_M;
use super::{Log, Session, SetupError};
use crate::code;
use crate::parameters::Layout;

/// How far in m outside of the room a spot can seem to be: by a tracker with another frame, and by a search.
const OUTSIDE_M: f64 = 2.0;

/// Standard deviations of a tracked place in m. Numbers may be rounded on their way through JSON.
const DEVIATION_M: RangeInclusive<f64> = 0.99 * TRACKED_MIN_M..=200.0;

/// Factor between the light of a room and the largest by its nominal equipment: LEDs have other half-power angles.
const BRIGHTER: f64 = 10.0;

/// Standard deviations of a reading without light within which readings are.
const NOISE_DEVIATIONS: f64 = 10.0;

/// How far in rad a command may seem to be outside of the range of the array, by rounding.
const ROUNDED_RAD: f64 = 1e-6;

/// Gains: shares of an LED's light. Noise can make a reading negative.
pub(super) const GAIN: RangeInclusive<f64> = -1.0..=1.0;

/// The light of a mirror: a gain less the dark one, of which the code of a group gives less than twice.
const LIGHT: RangeInclusive<f64> = -4.0..=4.0;

/// Standard deviations of gains.
const GAIN_NOISE: RangeInclusive<f64> = 0.0..=4.0;

/// Standard deviations relative to a gain, which can be small.
const RELATIVE_NOISE: RangeInclusive<f64> = 0.0..=1e9;

/// Angles of mirrors in rad.
const ANGLE_RAD: RangeInclusive<f64> = -std::f64::consts::PI..=std::f64::consts::PI;

/// Most spots, with those of former calibrations: each has parameters of its own in the joint estimate.
const SPOTS_MAX: usize = 256;

/// Most readings of a mirror at one spot: a search and further probes after it give fewer.
const READINGS_MAX: usize = 200;

/// Largest distance of an estimated value from the mean of its prior, in the prior's standard deviations. The
/// estimate of a calibration with another level of installation is within it.
const PLAUSIBLE: f64 = 50.0;

/// Half-power semi-angles in rad, between which the model of an LED is defined.
const SEMI_ANGLE_RAD: [f64; 2] = [0.1_f64.to_radians(), 89.9_f64.to_radians()];

impl Session {
    /// Checks the values of an estimate by the priors of its parameters.
    pub(super) fn check_estimate(&self, layout: &Layout, values: &[f64]) -> Result<(), SetupError> {
        for (parameter, (value, [low, high])) in values.iter().zip(self.plausible(layout)).enumerate() {
            if !(low..=high).contains(value) {
                return Err(SetupError::Field(format!(
                    "estimate[{parameter}] = {value:?}: expected {low:.3} to {high:.3}; without the list \"estimate\" \
                     the estimate begins again"
                )));
            }
        }
        Ok(())
    }

    /// Checks that the room can have the spots, and that its LEDs can give the light.
    pub(super) fn check_light(&self, log: &Log) -> Result<(), SetupError> {
        let floor_m = self.setup.room.floor_m();
        for (index, spot) in log.spots.iter().enumerate() {
            let [x, y] = spot.tracked_m;
            let at = self.optics.array().room_from_wall(&Vec3::new(x, y, 0.0));
            for ((axis, value), within_m) in [("x", at.x), ("y", at.y)].into_iter().zip(&floor_m) {
                let field = format!("the {axis} of spots[{index}].tracked_m in the room");
                within(&field, value, within_m.start() - OUTSIDE_M..=within_m.end() + OUTSIDE_M)?;
            }
            within(&format_args!("spots[{index}].height_m"), spot.height_m, 0.0..=self.setup.room.height_m)?;
            let most = BRIGHTER * self.optics.direct_gain_max(spot.height_m);
            within(&format_args!("spots[{index}].direct_gain"), spot.direct_gain, -most..=most)?;
        }
        let brightest = BRIGHTER * self.optics.mirror_gain_max();
        for (index, reading) in log.readings.iter().enumerate() {
            let most = brightest + NOISE_DEVIATIONS * log.spots[reading.spot].noise_gain;
            within(&format_args!("readings[{index}].gain"), reading.gain, -most..=most)?;
        }
        Ok(())
    }

    /// Checks that the array can turn to the angles of the readings, without those of a former calibration, for which
    /// it had another range.
    pub(super) fn check_commands(&self) -> Result<(), SetupError> {
        let axes = [&self.setup.capabilities.roll, &self.setup.capabilities.yaw];
        let former = self.former_spots();
        for (index, reading) in self.readings.iter().enumerate().filter(|(_, reading)| reading.spot >= former) {
            for (axis, (angle, limits)) in reading.command.into_iter().zip(axes).enumerate() {
                let [low, high] = [limits.min_rad, limits.max_rad].map(f64::from);
                let field = format!("readings[{index}].command[{axis}]");
                within(&field, angle, low - ROUNDED_RAD..=high + ROUNDED_RAD)?;
            }
        }
        Ok(())
    }

    /// The least and the largest value of each parameter. None of them includes a value that is not finite.
    fn plausible(&self, layout: &Layout) -> Vec<[f64; 2]> {
        let spots = &self.spots[..layout.spots().min(self.spots.len())];
        let mut prior = layout.prior(&self.setup.prior, spots);
        for (spot, axis) in (0..spots.len()).flat_map(|spot| [(spot, 0), (spot, 1)]) {
            // A place moves with the tracker's frame.
            prior[layout.place(spot, axis)].1 += self.setup.prior.shift_m;
        }
        let reach = |(mean, spread): (f64, f64)| [mean - PLAUSIBLE * spread, mean + PLAUSIBLE * spread];
        let mut plausible: Vec<[f64; 2]> = prior.into_iter().map(reach).collect();
        let [low, high] = &mut plausible[layout.semi_angle()];
        let [least, most] = SEMI_ANGLE_RAD.map(|angle| angle / self.optics.semi_angle(0.0) - 1.0);
        (*low, *high) = (low.max(least), high.min(most));
        plausible
    }
}

impl Log {
    /// Checks spots and readings for an array of so many mirrors in a room of so many LEDs.
    pub(super) fn check(&self, mirrors: usize, leds: usize) -> Result<(), SetupError> {
        if self.mirrors != mirrors {
            return Err(SetupError::OtherLog { found: self.mirrors, expected: mirrors });
        }
        let spots = self.spots.len();
        within("the number of places", self.places.len(), spots..=spots)?;
        within("the number of spots", spots, 0..=SPOTS_MAX)?;
        for (index, spot) in self.spots.iter().enumerate() {
            let at = |field: &str| format!("spots[{index}].{field}");
            within(&at("tracked_deviation_m"), spot.tracked_deviation_m, DEVIATION_M)?;
            below(&at("led"), spot.led, leds)?;
            within(&at("direct_gain"), spot.direct_gain, GAIN)?;
            within(&at("direct_deviation"), spot.direct_deviation, RELATIVE_NOISE)?;
            within(&at("noise_relative"), spot.noise_relative, RELATIVE_NOISE)?;
            within(&at("noise_gain"), spot.noise_gain, GAIN_NOISE)?;
            if !code::SIZES.contains(&spot.group) {
                return Err(SetupError::Field(format!("{} = {}: expected {:?}", at("group"), spot.group, code::SIZES)));
            }
        }
        for (index, reading) in self.readings.iter().enumerate() {
            below(&format_args!("readings[{index}].spot"), reading.spot, spots)?;
            below(&format_args!("readings[{index}].mirror"), reading.mirror, mirrors)?;
            for angle in reading.command {
                within(&format_args!("readings[{index}].command"), angle, ANGLE_RAD)?;
            }
            within(&format_args!("readings[{index}].gain"), reading.gain, LIGHT)?;
            // A session ends a spot before it begins the next one.
            let earlier = index.checked_sub(1).map_or(0, |index| self.readings[index].spot);
            within(&format_args!("readings[{index}].spot"), reading.spot, earlier..=spots - 1)?;
        }
        self.check_counts()
    }

    /// Checks how many readings each mirror has at each spot: an estimate takes a time in proportion to them.
    fn check_counts(&self) -> Result<(), SetupError> {
        let mut counts = BTreeMap::<(usize, usize), usize>::new();
        for reading in &self.readings {
            *counts.entry((reading.spot, reading.mirror)).or_default() += 1;
        }
        counts.into_iter().try_for_each(|((spot, mirror), count)| {
            within(&format_args!("the number of readings of mirror {mirror} at spot {spot}"), count, 0..=READINGS_MAX)
        })
    }

    /// Checks the places for a walk with so many: the verification comes after the last one. Places follow each other,
    /// and a complete one has a spot.
    pub(super) fn check_places(&self, walk: usize) -> Result<(), SetupError> {
        within("complete", self.complete, 0..=walk)?;
        let mut earlier = 0;
        for (index, place) in self.places.iter().enumerate().filter(|(_, place)| **place != FORMER_PLACE) {
            within(&format_args!("places[{index}]"), *place, earlier..=walk)?;
            earlier = *place;
        }
        match (0..self.complete).find(|place| !self.places.contains(place)) {
            None => Ok(()),
            Some(place) => Err(SetupError::Field(format!(
                "complete = {}, and no spot at place {place}: expected at most {place}",
                self.complete
            ))),
        }
    }
}

/// An index into so many entries.
fn below(field: &dyn Display, found: usize, count: usize) -> Result<(), SetupError> {
    if found < count {
        return Ok(());
    }
    Err(SetupError::Field(format!("{field} = {found}: expected an index below {count}")))
}

/// A value within its bounds. No bound includes a value that is not finite.
fn within<T: PartialOrd + Debug>(
    field: &(impl Display + ?Sized),
    found: T,
    bounds: RangeInclusive<T>,
) -> Result<(), SetupError> {
    if bounds.contains(&found) {
        return Ok(());
    }
    let (low, high) = bounds.into_inner();
    Err(SetupError::Field(format!("{field} = {found:?}: expected {low:?} to {high:?}")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::Reading;
    use crate::parameters::Spot;

    fn log() -> Log {
        let spot = Spot {
            tracked_m: [-1.2, 0.4],
            tracked_deviation_m: 0.003,
            height_m: 0.85,
            led: 0,
            direct_gain: 1e-6,
            direct_deviation: 0.01,
            noise_relative: 0.05,
            noise_gain: 1e-9,
            group: 1,
        };
        let reading = Reading { spot: 2, mirror: 8, command: [0.1, -0.2], gain: -1e-9 };
        Log {
            mirrors: 9,
            complete: 2,
            spots: vec![spot; 3],
            places: vec![0, 1, 3],
            readings: vec![reading; 4],
            ..Log::default()
        }
    }

    fn refusal(change: impl Fn(&mut Log)) -> String {
        let mut log = log();
        change(&mut log);
        log.check(9, 4).and_then(|()| log.check_places(3)).map_or_else(|error| error.to_string(), |()| String::new())
    }

    #[test]
    fn each_field_of_a_log_beyond_its_bound_is_named_with_the_bound() {
        assert_eq!(refusal(|_| {}), "");
        assert_eq!(refusal(|log| log.places = vec![FORMER_PLACE, 0, 1]), "", "of a former calibration");
        type Change<'a> = &'a dyn Fn(&mut Log);
        let cases: [(Change, &str); 17] = [
            (&|log| log.mirrors = 4, "of 4 mirrors: expected 9"),
            (&|log| log.spots[0].led = 99, "spots[0].led = 99: expected an index below 4"),
            (&|log| log.spots[1].tracked_deviation_m = 0.0, "spots[1].tracked_deviation_m = 0.0: expected 0.002"),
            (&|log| log.readings[1].spot = 1, "readings[1].spot = 1: expected 2 to 2"),
            (&|log| log.spots[2].noise_gain = f64::NAN, "spots[2].noise_gain = NaN: expected 0.0 to 4.0"),
            (&|log| log.spots[2].group = 5, "spots[2].group = 5: expected [1, 3, 7, 15, 31]"),
            (&|log| log.readings[3].spot = 9_999_999, "readings[3].spot = 9999999: expected an index below 3"),
            (&|log| log.readings[3].mirror = 1 << 32, "readings[3].mirror = 4294967296: expected an index below 9"),
            (&|log| log.readings[3].gain = -4.1, "readings[3].gain = -4.1: expected -4.0 to 4.0"),
            (&|log| log.readings[3].command[1] = 1e300, "readings[3].command = 1e300: expected -3.14"),
            (&|log| log.spots.clear(), "the number of places = 3: expected 0 to 0"),
            (
                &|log| (log.spots, log.places) = (vec![log.spots[0].clone(); 300], vec![0; 300]),
                "the number of spots = 300: expected 0 to 256",
            ),
            (
                &|log| log.readings = vec![log.readings[0]; 1000],
                "the number of readings of mirror 8 at spot 2 = 1000: expected 0 to 200",
            ),
            (&|log| log.complete = 999, "complete = 999: expected 0 to 3"),
            (&|log| log.places[2] = 7, "places[2] = 7: expected 1 to 3"),
            (&|log| log.places[2] = 0, "places[2] = 0: expected 1 to 3"),
            (&|log| log.complete = 3, "complete = 3, and no spot at place 2: expected at most 2"),
        ];
        for (change, expected) in cases {
            let found = refusal(change);
            assert!(found.contains(expected), "{found:?}, expected {expected:?}");
        }
    }
}
