//! What a session can continue from after an interruption.

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::{Session, SetupError, Stage};
use crate::fit::{Estimate, Reading};
use crate::parameters::{Layout, Spot};

/// The spots and readings of a session.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Log {
    /// Number of mirrors.
    pub mirrors: usize,
    /// Places of the setup that are complete.
    pub complete: usize,
    /// The spots.
    pub spots: Vec<Spot>,
    /// The place of the setup of each spot.
    pub places: Vec<usize>,
    /// The readings.
    pub readings: Vec<Reading>,
    /// How many of the spots are of the calibration that a refinement started from; 0 without one.
    #[serde(default)]
    pub former: usize,
    /// Values of the estimate so far, of all its parameters; empty before the first.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub estimate: Vec<f64>,
}

impl Session {
    /// What is known so far.
    pub fn log(&self) -> Log {
        let complete = match self.stage {
            Stage::Await(place) | Stage::Dark(place) | Stage::Probe(place) | Stage::Locate(place) => place,
            Stage::Verify | Stage::Ended => self.setup.spots.len(),
        };
        let complete = self.complete.map_or(complete, |place| place + 1);
        // Values that have no form in a file, or that a session would refuse, are no start.
        let is_usable = |estimate: &&Estimate| self.check_estimate(&estimate.layout, &estimate.values).is_ok();
        let estimate = self.estimate.as_ref().filter(is_usable);
        Log {
            mirrors: self.optics.centres.len(),
            complete: complete.min(self.setup.spots.len()),
            spots: self.spots.clone(),
            places: self.places.clone(),
            readings: self.readings.clone(),
            former: self.former_spots(),
            estimate: estimate.map(|estimate| estimate.values.clone()).unwrap_or_default(),
        }
    }

    /// Continues after the places that a log completes. Its readings at an incomplete place count
    /// too: the receiver does not return to exactly that place, so it stands at a new spot. A refinement
    /// whose places are complete ends at once if no mirror has changed.
    ///
    /// # Errors
    /// [`SetupError::OtherLog`], [`SetupError::OtherFormer`]; [`SetupError::Field`], also for an estimate beyond its priors.
    pub fn resume(&mut self, mut log: Log) -> Result<(), SetupError> {
        if !self.is_refined_in(&log) {
            return Err(SetupError::OtherFormer);
        }
        log.check_places(self.setup.spots.len())?;
        let complete = log.complete;
        let values = std::mem::take(&mut log.estimate);
        self.take(log)?;
        self.check_commands()?;
        if !self.readings.is_empty() {
            self.start_from(values)?;
            self.fit();
        }
        self.go_to(complete);
        Ok(())
    }

    /// The next fit starts from these values, as in the session that was interrupted. A refinement starts from the
    /// former calibration, and values of other parameters are not used.
    fn start_from(&mut self, values: Vec<f64>) -> Result<(), SetupError> {
        let (mirrors, leds) = (self.optics.centres.len(), self.optics.leds.len());
        let has_scales = self.setup.prior.scale > 0.0;
        let mut layouts = (1..=self.spots.len()).map(|spots| Layout::new(mirrors, leds, spots, has_scales));
        let Some(layout) = layouts.find(|layout| layout.len() == values.len()) else { return Ok(()) };
        if !self.is_refinement() {
            self.check_estimate(&layout, &values)?;
            // The fit gives the covariance.
            let covariance = DMatrix::identity(values.len(), values.len());
            self.estimate = Some(self.extended(Some(&Estimate { layout, values, covariance, residuals: Vec::new() })));
        }
        Ok(())
    }

    /// Takes the spots and readings of a log.
    pub(super) fn take(&mut self, log: Log) -> Result<(), SetupError> {
        log.check(self.optics.centres.len(), self.optics.leds.len())?;
        self.check_light(&log)?;
        self.spots = log.spots;
        self.places = log.places;
        self.readings = log.readings;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_room::Room;
    use super::*;
    use crate::optics::OFFSET;

    #[test]
    fn a_session_that_is_continued_starts_its_fit_at_the_estimate_of_the_interrupted_one() {
        let mut room = Room::new(20.0);
        room.step_until(|session| session.readings().len() > 5);
        room.know_offsets();
        let log = room.session.log();
        let mut continued = Room::new(20.0).session;
        continued.take(log.clone()).expect("of the same array");
        continued.start_from(vec![1.0; 3]).expect("not used");
        assert!(continued.estimate.is_none(), "values of other parameters");
        continued.start_from(log.estimate).expect("plausible");
        for (mirror, offset) in room.offsets.iter().enumerate() {
            assert_eq!(continued.quantities((mirror, 0))[OFFSET..OFFSET + 2], *offset, "mirror {mirror}");
        }
    }

    #[test]
    fn an_estimate_beyond_its_priors_is_refused_and_not_written() {
        let mut room = Room::new(20.0);
        room.step_until(|session| session.readings().len() > 5);
        room.know_offsets();
        let log = room.session.log();
        let layout = room.session.estimate.as_ref().expect("known").layout.clone();
        assert_eq!(log.estimate.len(), layout.len());
        let parameters = [layout.offset(3, 1), layout.led(0, 2), layout.semi_angle(), layout.place(0, 0)];
        for (parameter, value) in parameters.into_iter().flat_map(|of| [1e308, -1e9, f64::NAN].map(|value| (of, value)))
        {
            let mut changed = log.clone();
            changed.estimate[parameter] = value;
            let refusal = Room::new(20.0).session.resume(changed).expect_err("refused").to_string();
            let expected = format!("the readings have estimate[{parameter}] = {value:?}: expected ");
            assert!(refusal.starts_with(&expected) && refusal.contains("begins again"), "{refusal}");
        }
        if let Some(estimate) = &mut room.session.estimate {
            estimate.values[layout.semi_angle()] = f64::NAN;
        }
        assert_eq!(room.session.log(), Log { estimate: Vec::new(), ..log });
    }

    #[test]
    fn spots_readings_and_angles_that_the_room_cannot_have_are_refused_by_name() {
        let mut room = Room::new(20.0);
        room.step_until(|session| session.readings().len() > 5);
        let log = room.session.log();
        Room::new(20.0).session.resume(log.clone()).expect("as it was written");
        let refusal = |change: &dyn Fn(&mut Log)| {
            let mut changed = log.clone();
            change(&mut changed);
            Room::new(20.0).session.resume(changed).expect_err("refused").to_string()
        };
        let bright = 11.0 * room.session.optics.mirror_gain_max();
        type Change<'a> = &'a dyn Fn(&mut Log);
        let cases: [(Change, &str); 6] = [
            (&|log| log.spots[0].tracked_m[0] = 5.0, " of spots[0].tracked_m in the room = "),
            (&|log| log.spots[0].height_m = 3.5, "spots[0].height_m = 3.5: expected 0.0 to 3.0"),
            (&|log| log.spots[0].direct_gain = 0.5, "spots[0].direct_gain = 0.5: expected -"),
            (&|log| log.readings[2].gain = bright + log.spots[0].noise_gain * 11.0, "readings[2].gain = "),
            (&|log| log.readings[2].gain = -0.5, "readings[2].gain = -0.5: expected -"),
            (&|log| log.readings[3].command[1] = 1.1, "readings[3].command[1] = 1.1: expected -1.0"),
        ];
        for (change, expected) in cases {
            let found = refusal(change);
            assert!(found.contains(expected), "{found:?}, expected {expected:?}");
        }
    }

    #[test]
    fn a_spot_of_single_mirrors_is_written_and_read_without_a_group() {
        let text = "tracked_m = [-1.2, 0.4]\ntracked_deviation_m = 0.003\nheight_m = 0.85\nled = 0\ndirect_gain = 1e-6\n\
                    direct_deviation = 0.01\nnoise_relative = 0.05\nnoise_gain = 1e-9\n";
        let spot: Spot = toml::from_str(text).expect("a spot");
        assert_eq!(spot.group, 1);
        assert!(!toml::to_string(&spot).expect("text").contains("group"));
        let grouped = Spot { group: 15, ..spot };
        let again: Spot = toml::from_str(&toml::to_string(&grouped).expect("text")).expect("a spot");
        assert_eq!(again, grouped);
    }
}
