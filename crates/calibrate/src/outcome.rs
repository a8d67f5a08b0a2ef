//! The result of a session: corrections for the driver, the measured room for the controller, and how
//! sure both are.

use std::collections::BTreeSet;

use heliostat_array::calibration::{GAIN_RANGE, OFFSET_MAX_RAD};
use heliostat_array::calibration_file::{AxisCorrections, CalibrationFile};
use heliostat_channel::Vec3;
use heliostat_scenario::{Mismatch, Scenario};
use serde::Serialize;

use crate::fit::Estimate;
use crate::optics::{LOG_FACTOR, Optics, PLACE, QUANTITIES};
use crate::parameters::Spot;
use crate::session::refinement::FORMER_PLACE;
use crate::session::{Change, aim_deviation};
use crate::stand::median;

/// Half of the sides in m of the square of places for which the pointing is predicted.
const HELD_OUT_M: f64 = 1.5;

/// Places along a side of that square.
const HELD_OUT_SIDE: usize = 3;

/// Predicted error of the pointing in rad above which a mirror needs another spot: 0.3 degrees.
const UNSURE_RAD: f64 = 0.3 * std::f64::consts::PI / 180.0;

/// Two-sided quantile of the normal distribution for 95 %.
pub const QUANTILE_95: f64 = 1.96;

/// A measured quantity.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Measured {
    /// The estimate.
    pub value: f64,
    /// Its standard deviation.
    pub deviation: f64,
}

/// What is known about a mirror.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// Its pointing is known.
    Calibrated,
    /// Its pointing is known at the spots, but not elsewhere: it needs another spot.
    NeedsSpot,
    /// It showed no light at any spot, or the same light at all angles: it is stuck, or off by more
    /// than the search reaches. It has no correction.
    NotFound,
    /// Its readings contradict one another. It has no correction.
    Inconsistent,
    /// The array reports that it does not follow commands. It has no correction.
    Unusable,
}

/// A mirror's result.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Mirror {
    /// The verdict.
    pub verdict: Verdict,
    /// Deviation of roll and yaw from the commanded angles in degrees.
    pub offset_deg: [Measured; 2],
    /// Predicted standard deviation of the pointing at held-out places in degrees: roll and yaw.
    pub pointing_deg: [f64; 2],
}

/// The gains at the place of the verification, with all mirrors aimed at it.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Verification {
    /// With nominal angles.
    pub nominal: Vec<f64>,
    /// With calibrated ones.
    pub calibrated: Vec<f64>,
}

impl Verification {
    pub(crate) fn handle_reading(&mut self, is_calibrated: bool, gain: f64) {
        if is_calibrated { &mut self.calibrated } else { &mut self.nominal }.push(gain);
    }

    pub(crate) fn is_calibrated_next(&self) -> bool {
        self.calibrated.len() < self.nominal.len()
    }

    pub(crate) fn is_complete(&self, readings: usize) -> bool {
        self.nominal.len() >= readings && self.calibrated.len() >= readings
    }

    /// Gain with calibrated angles over that with nominal ones, and the standard error of their
    /// difference relative to the nominal gain.
    pub fn ratio(&self) -> Measured {
        let (nominal, calibrated) = (median(&self.nominal), median(&self.calibrated));
        let variance = |values: &[f64], middle: f64| {
            // The deviation of a median of normal values is that of the mean times sqrt(pi / 2).
            let count = values.len().max(2) as f64;
            let squares: f64 = values.iter().map(|value| (value - middle).powi(2)).sum();
            std::f64::consts::FRAC_PI_2 * squares / (count - 1.0) / count
        };
        let variance = variance(&self.nominal, nominal) + variance(&self.calibrated, calibrated);
        let scale = nominal.max(f64::MIN_POSITIVE);
        Measured { value: calibrated / scale, deviation: variance.sqrt() / scale }
    }

    /// Whether the calibrated aims are better than the nominal ones beyond the noise: the 95 % interval lies above 1.
    pub fn is_improvement(&self) -> bool {
        let Measured { value, deviation } = self.ratio();
        value - QUANTILE_95 * deviation > 1.0
    }
}

/// The result of a session.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Outcome {
    /// One entry for each mirror.
    pub mirrors: Vec<Mirror>,
    /// Position of each LED in the tracker's frame in m.
    pub leds_m: Vec<[Measured; 3]>,
    /// Half-power semi-angle of the LEDs in degrees.
    pub semi_angle_deg: Measured,
    /// Height of LED and mirrors above their nominal height over the tracker's floor, in m.
    pub raise_m: Measured,
    /// Shift of the tracker's frame against that of the mirrors along x and y, in m.
    pub shift_m: [Measured; 2],
    /// Factor of the detector's received power.
    pub detector_factor: Measured,
    /// Factor of the reflectivity.
    pub reflectivity_factor: Measured,
    /// Standard deviation of a reported coordinate in m and of a reported velocity in m/s; `None`
    /// where the receiver stood too short.
    pub tracker_noise: Option<[f64; 2]>,
    /// Standard deviation of a gain, relative.
    pub channel_noise: f64,
    /// Places of the setup that were rejected, because most mirrors contradict them.
    pub rejected_places: Vec<usize>,
    /// Readings of mirrors.
    pub readings: usize,
    /// How many of them are from coded groups of mirrors.
    pub grouped: usize,
    /// Mirrors that this session itself measured: those that showed light at one of its spots, without rejected ones,
    /// and those that have changed. The verdicts of a refinement also rest on the calibration that it started from.
    pub measured: usize,
    /// The verification; in a refinement that of the mirrors that have changed.
    pub verification: Verification,
    /// The mirrors that have changed since the calibration that a refinement started from.
    pub changes: Vec<Change>,
    /// The mirror's roll and yaw in rad relative to their commands; 0 without a correction.
    #[serde(skip)]
    offsets_rad: Vec<[f64; 2]>,
    /// Relative errors of the scales.
    #[serde(skip)]
    scales: Vec<[f64; 2]>,
    #[serde(skip)]
    size: [usize; 2],
}

/// From what an outcome is made.
pub(crate) struct Input<'a> {
    pub optics: &'a Optics,
    pub estimate: &'a Estimate,
    pub spots: &'a [Spot],
    pub places: &'a [usize],
    pub verification: &'a Verification,
    pub rejected: &'a [usize],
    pub changes: &'a [Change],
    pub lit: &'a [(usize, usize)],
    pub bad: &'a [(usize, usize)],
    pub unusable: &'a [u32],
    pub readings: usize,
    pub grouped: usize,
    pub noise: Option<[f64; 2]>,
    pub channel_noise: f64,
}

impl Outcome {
    pub(crate) fn of(input: &Input<'_>) -> Self {
        let Input { optics, estimate, .. } = input;
        let (layout, values) = (&estimate.layout, &estimate.values);
        let measured = |parameter: usize| Measured {
            value: values[parameter],
            deviation: estimate.covariance[(parameter, parameter)].max(0.0).sqrt(),
        };
        let factor = |parameter: usize| {
            let log = measured(parameter);
            Measured { value: log.value.exp(), deviation: log.value.exp() * log.deviation }
        };
        let mirrors: Vec<Mirror> = (0..optics.centres.len()).map(|mirror| mirror_of(input, mirror)).collect();
        let is_corrected = |mirror: usize| matches!(mirrors[mirror].verdict, Verdict::Calibrated | Verdict::NeedsSpot);
        let corrected = |mirror: usize, parameter: [usize; 2]| {
            if is_corrected(mirror) { parameter.map(|parameter| values[parameter]) } else { [0.0; 2] }
        };
        let has_scales = layout.len() > layout.scale(0, 0);
        let scales = (0..mirrors.len()).map(|mirror| {
            if has_scales { corrected(mirror, [0, 1].map(|axis| layout.scale(mirror, axis))) } else { [0.0; 2] }
        });
        let places = input.rejected.iter().map(|spot| input.places[*spot]);
        let mut rejected_places: Vec<usize> = places.filter(|place| *place != FORMER_PLACE).collect();
        rejected_places.sort_unstable();
        rejected_places.dedup();
        let semi_angle = measured(layout.semi_angle());
        let array = optics.array();
        Self {
            leds_m: (0..optics.leds.len()).map(|led| led_of(input, led)).collect(),
            semi_angle_deg: Measured {
                value: optics.semi_angle(semi_angle.value).to_degrees(),
                deviation: optics.semi_angle(0.0).to_degrees() * semi_angle.deviation,
            },
            raise_m: measured(layout.raise()),
            shift_m: shift_of(input),
            detector_factor: factor(layout.log_detector()),
            reflectivity_factor: factor(layout.log_reflectivity()),
            tracker_noise: input.noise,
            channel_noise: input.channel_noise,
            rejected_places,
            readings: input.readings,
            grouped: input.grouped,
            measured: measured_of(input),
            verification: input.verification.clone(),
            changes: input.changes.to_vec(),
            offsets_rad: (0..mirrors.len())
                .map(|mirror| corrected(mirror, [0, 1].map(|axis| layout.offset(mirror, axis))))
                .collect(),
            scales: scales.collect(),
            size: [array.rows(), array.columns()],
            mirrors,
        }
    }

    /// The corrections for the driver.
    ///
    /// A mirror turns to (1 + s) command + e. The command that turns it to an angle is therefore
    /// angle / (1 + s) - e / (1 + s), which is limited to what a driver accepts.
    pub fn calibration(&self) -> CalibrationFile {
        let axis = |axis: usize| {
            let pairs = self.offsets_rad.iter().zip(&self.scales);
            let corrections = pairs.map(|(offset, scale)| {
                let gain = (1.0 / (1.0 + scale[axis])).clamp(GAIN_RANGE[0], GAIN_RANGE[1]);
                let offset = (-offset[axis] * gain).clamp(-OFFSET_MAX_RAD, OFFSET_MAX_RAD);
                (rounded(offset.to_degrees()), rounded(gain))
            });
            let (offset_deg, gain) = corrections.unzip();
            AxisCorrections { offset_deg, gain }
        };
        CalibrationFile { rows: self.size[0], columns: self.size[1], roll: axis(0), yaw: axis(1) }
    }

    /// The scenario with the measured room in place of the nominal one, for the controller.
    ///
    /// The factor of the received power is in the area of the detector. The shift of the tracker's
    /// frame has no key: [`shift_m`](Self::shift_m) is to be removed at the tracker.
    pub fn measured_room(&self, nominal: &Scenario, array: usize) -> Scenario {
        let mut room = nominal.clone();
        let raise = rounded(self.raise_m.value);
        room.room.height_m += raise;
        room.mirrors.arrays_mut().iter_mut().for_each(|array| array.centre_height_m += raise);
        let half = [0.5 * room.room.length_x_m, 0.5 * room.room.length_y_m];
        for (position, measured) in room.led.positions_m.iter_mut().zip(&self.leds_m) {
            *position = measured.map(|coordinate| rounded(coordinate.value));
            for axis in 0..2 {
                position[axis] = position[axis].clamp(-half[axis], half[axis]);
            }
            room.room.height_m = room.room.height_m.max(position[2]);
        }
        room.led.half_power_semi_angle_deg = rounded(self.semi_angle_deg.value).min(89.0);
        room.receiver.area_mm2 = rounded(room.receiver.area_mm2 * self.detector_factor.value);
        if let Some(array) = room.mirrors.arrays_mut().get_mut(array) {
            array.reflectivity = rounded(array.reflectivity * self.reflectivity_factor.value).min(1.0);
        }
        if let Some([position, velocity]) = self.tracker_noise {
            room.streams.positions.noise_m = rounded(position);
            room.streams.positions.velocity_noise_m_s = rounded(velocity);
        }
        room.streams.channel.noise_relative = rounded(self.channel_noise);
        room.mismatch = Mismatch::default();
        room
    }

    /// Indices of the mirrors with a verdict.
    pub fn mirrors_with(&self, verdict: Verdict) -> Vec<usize> {
        let all = self.mirrors.iter().enumerate();
        all.filter(|(_, mirror)| mirror.verdict == verdict).map(|(index, _)| index).collect()
    }
}

/// How many mirrors the session itself measured.
fn measured_of(Input { lit, places, rejected, changes, .. }: &Input<'_>) -> usize {
    let is_own = |spot: &usize| places[*spot] != FORMER_PLACE && !rejected.contains(spot);
    let lit = lit.iter().filter(|(_, spot)| is_own(spot)).map(|(mirror, _)| *mirror);
    lit.chain(changes.iter().map(|change| change.mirror)).collect::<BTreeSet<usize>>().len()
}

fn mirror_of(input: &Input<'_>, mirror: usize) -> Mirror {
    let Input { optics, estimate, spots, .. } = input;
    let layout = &estimate.layout;
    let offset_deg = [0, 1].map(|axis| {
        let parameter = layout.offset(mirror, axis);
        Measured {
            value: estimate.values[parameter].to_degrees(),
            deviation: estimate.covariance[(parameter, parameter)].max(0.0).sqrt().to_degrees(),
        }
    });
    let height_m = spots.first().map_or(0.0, |spot| spot.height_m);
    let step = 2.0 * HELD_OUT_M / (HELD_OUT_SIDE - 1) as f64;
    let mut worst = [0.0_f64; 2];
    for cell in 0..HELD_OUT_SIDE * HELD_OUT_SIDE {
        let place = [cell / HELD_OUT_SIDE, cell % HELD_OUT_SIDE].map(|index| index as f64 * step - HELD_OUT_M);
        let mut quantities = [0.0; QUANTITIES];
        let led = spots.first().map_or(0, |spot| spot.led);
        for (quantity, parameter) in layout.of_reading((mirror, led, 0)) {
            if quantity < PLACE || quantity == LOG_FACTOR {
                quantities[quantity] = estimate.values[parameter];
            }
        }
        quantities[PLACE..PLACE + 3].copy_from_slice(&[place[0], place[1], height_m]);
        let deviation = aim_deviation(optics, estimate, (mirror, led), &quantities, [None; 2]);
        worst = [0, 1].map(|axis| worst[axis].max(deviation[axis]));
    }
    let of_mirror = |pairs: &[(usize, usize)]| pairs.iter().filter(|(of, _)| *of == mirror).count();
    let good = input
        .lit
        .iter()
        .filter(|pair| pair.0 == mirror && !input.bad.contains(pair) && !input.rejected.contains(&pair.1))
        .count();
    let verdict = if input.unusable.contains(&(mirror as u32)) {
        Verdict::Unusable
    } else if of_mirror(input.lit) == 0 {
        Verdict::NotFound
    } else if good == 0 {
        Verdict::Inconsistent
    } else if worst.iter().any(|deviation| *deviation > UNSURE_RAD) {
        Verdict::NeedsSpot
    } else {
        Verdict::Calibrated
    };
    Mirror { verdict, offset_deg, pointing_deg: worst.map(f64::to_degrees) }
}

/// The position of an LED in the room's frame, with the raise.
fn led_of(input: &Input<'_>, led: usize) -> [Measured; 3] {
    let Input { optics, estimate, .. } = input;
    let (layout, values) = (&estimate.layout, &estimate.values);
    let nominal = optics.leds[led];
    let moved = Vec3::new(values[layout.led(led, 0)], values[layout.led(led, 1)], values[layout.led(led, 2)]);
    let raise = values[layout.raise()];
    let at = optics.array().room_from_wall(&(nominal + moved + Vec3::new(0.0, 0.0, raise)));
    // The walls are at right angles: a rotation exchanges x and y, and a deviation has no sign.
    let along = optics.array().room_from_wall(&Vec3::x());
    let order = if along.x.abs() > 0.5 { [0, 1, 2] } else { [1, 0, 2] };
    let variance = |a: usize, b: usize| estimate.covariance[(a, b)];
    let deviations = order.map(|axis| {
        let parameter = layout.led(led, axis);
        let mut sum = variance(parameter, parameter);
        if axis == 2 {
            sum += variance(layout.raise(), layout.raise()) + 2.0 * variance(parameter, layout.raise());
        }
        sum.max(0.0).sqrt()
    });
    [0, 1, 2].map(|axis| Measured { value: at[axis], deviation: deviations[axis] })
}

/// The shift of the tracker's frame in the room's axes. In the estimate a detector is at the reported
/// place plus the shift.
fn shift_of(input: &Input<'_>) -> [Measured; 2] {
    let Input { optics, estimate, .. } = input;
    let [x, y] = [0, 1].map(|axis| estimate.layout.shift(axis));
    let at = optics.array().room_from_wall(&Vec3::new(estimate.values[x], estimate.values[y], 0.0));
    let along = optics.array().room_from_wall(&Vec3::x());
    let order = if along.x.abs() > 0.5 { [x, y] } else { [y, x] };
    let deviation = order.map(|parameter| estimate.covariance[(parameter, parameter)].max(0.0).sqrt());
    [Measured { value: at.x, deviation: deviation[0] }, Measured { value: at.y, deviation: deviation[1] }]
}

/// Rounds to five decimals, far finer than any drive or tape.
fn rounded(value: f64) -> f64 {
    (value * 1e5).round() / 1e5
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_light_within_the_noise_is_no_improvement() {
        let around = |middle: f64| vec![middle - 0.01, middle, middle + 0.01];
        let verified = |middle| Verification { nominal: around(1.0), calibrated: around(middle) };
        assert_eq!([0.99, 1.015, 1.03].map(|middle| verified(middle).is_improvement()), [false, false, true]);
    }
}
