//! The estimated parameters: their order, their prior spreads, and the quantities of one reading.

use heliostat_scenario::{Mismatch, MismatchLevel, Spreads};
use serde::{Deserialize, Serialize};

use crate::optics::{LED, LOG_FACTOR, OFFSET, PLACE, QUANTITIES, Quantities, RAISE, SCALE, SEMI_ANGLE, TILT};

/// Parameters of one spot: x and y of the detector, the slopes of its normal, and a factor.
const PER_SPOT: usize = 5;

/// Standard deviation of the factor of a spot, relative: errors of the model that all mirrors share at
/// a spot, such as a shadow of the hand. Without it the absolute gains would make LEDs and offsets look
/// surer than they are.
const SPOT_FACTOR: f64 = 0.03;

/// Ratio of the mean loss to its standard deviation in a scenario: a loss is the magnitude of a normal value.
const MEAN_LOSS: f64 = 0.798;

/// Prior standard deviations of the differences between the nominal room and the true one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Prior {
    /// Offset of each axis of each mirror in rad.
    pub offset_rad: f64,
    /// Relative error of each axis' scale; 0: the scales are exact and not estimated.
    pub scale: f64,
    /// Each coordinate of an LED in m.
    pub led_m: f64,
    /// Half-power semi-angle, relative.
    pub semi_angle: f64,
    /// Height of LED and mirrors above the tracker's floor in m.
    pub raise_m: f64,
    /// Shift of the tracker's frame along x and y in m.
    pub shift_m: f64,
    /// Received power, relative.
    pub received: f64,
    /// Loss of reflectivity, relative.
    pub reflectivity_loss: f64,
    /// Slope of the detector's normal along x and y.
    pub tilt: f64,
}

/// Least prior spread of each place, so that a quantity that the level keeps exact can still move.
const LEAST_M: f64 = 0.005;

impl Prior {
    /// The spreads of a level of installation; see [`heliostat_scenario::mismatch`].
    pub fn of_level(level: MismatchLevel) -> Self {
        let level = if level == MismatchLevel::None { MismatchLevel::Typical } else { level };
        let spreads: Spreads = Mismatch { level, ..Mismatch::default() }.spreads();
        Self {
            offset_rad: spreads.mirror_deg.to_radians(),
            scale: 0.0,
            led_m: spreads.led_m.max(LEAST_M),
            semi_angle: spreads.semi_angle,
            raise_m: spreads.floor_m.max(LEAST_M),
            shift_m: spreads.floor_m.max(LEAST_M),
            received: spreads.received,
            reflectivity_loss: spreads.reflectivity_loss,
            tilt: spreads.tilt_deg.to_radians().tan(),
        }
    }
}

/// A spot at which the receiver stood: what the tracker and the direct light show.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Spot {
    /// Mean of the reported x and y in m, in the wall frame.
    pub tracked_m: [f64; 2],
    /// Standard deviation of that mean in m.
    pub tracked_deviation_m: f64,
    /// Height of the detector above the floor in m, as entered.
    pub height_m: f64,
    /// Index of the LED that serves the spot.
    pub led: usize,
    /// Mean direct gain; 0 where the direct path is blocked.
    pub direct_gain: f64,
    /// Standard deviation of that mean, relative.
    pub direct_deviation: f64,
    /// Standard deviation of a reading, relative to the gain.
    pub noise_relative: f64,
    /// Standard deviation of a reading without light, as a gain: of a dark one, or of one from a coded group.
    pub noise_gain: f64,
    /// Mirrors of the coded groups from which its readings are; 1: readings of single mirrors.
    #[serde(default = "single", skip_serializing_if = "is_single")]
    pub group: usize,
}

fn single() -> usize {
    1
}

fn is_single(group: &usize) -> bool {
    *group == 1
}

/// Where each parameter is in the vector of all.
#[derive(Clone, Debug, PartialEq)]
pub struct Layout {
    mirrors: usize,
    leds: usize,
    spots: usize,
    has_scales: bool,
}

impl Layout {
    /// The parameters of this number of mirrors, LEDs and spots.
    pub fn new(mirrors: usize, leds: usize, spots: usize, has_scales: bool) -> Self {
        Self { mirrors, leds, spots, has_scales }
    }

    /// Number of parameters.
    pub fn len(&self) -> usize {
        self.scale(0, 0) + if self.has_scales { 2 * self.mirrors } else { 0 }
    }

    /// Always false.
    pub fn is_empty(&self) -> bool {
        false
    }

    /// Number of spots.
    pub fn spots(&self) -> usize {
        self.spots
    }

    /// Offset of an axis of a mirror.
    pub fn offset(&self, mirror: usize, axis: usize) -> usize {
        2 * mirror + axis
    }

    /// A coordinate of an LED.
    pub fn led(&self, led: usize, axis: usize) -> usize {
        2 * self.mirrors + 3 * led + axis
    }

    /// The relative deviation of the semi-angle.
    pub fn semi_angle(&self) -> usize {
        2 * self.mirrors + 3 * self.leds
    }

    /// The height of LED and mirrors.
    pub fn raise(&self) -> usize {
        self.semi_angle() + 1
    }

    /// The logarithm of the detector's factor.
    pub fn log_detector(&self) -> usize {
        self.semi_angle() + 2
    }

    /// The logarithm of the reflectivity's factor.
    pub fn log_reflectivity(&self) -> usize {
        self.semi_angle() + 3
    }

    /// A coordinate of the tracker's shift.
    pub fn shift(&self, axis: usize) -> usize {
        self.semi_angle() + 4 + axis
    }

    /// A coordinate of a spot.
    pub fn place(&self, spot: usize, axis: usize) -> usize {
        self.semi_angle() + 6 + PER_SPOT * spot + axis
    }

    /// A slope of the detector's normal at a spot.
    pub fn tilt(&self, spot: usize, axis: usize) -> usize {
        self.place(spot, 2 + axis)
    }

    /// The logarithm of the factor of a spot on the light of all mirrors.
    pub fn spot_factor(&self, spot: usize) -> usize {
        self.place(spot, 4)
    }

    /// The scale error of an axis of a mirror; only where scales are estimated.
    pub fn scale(&self, mirror: usize, axis: usize) -> usize {
        self.place(self.spots, 0) + 2 * mirror + axis
    }

    /// The parameters on which the quantities of a reading at a spot by way of a mirror depend, with
    /// the index of the quantity of each.
    pub fn of_reading(&self, (mirror, led, spot): (usize, usize, usize)) -> Vec<(usize, usize)> {
        let mut pairs = vec![
            (OFFSET, self.offset(mirror, 0)),
            (OFFSET + 1, self.offset(mirror, 1)),
            (LOG_FACTOR, self.log_reflectivity()),
            (LOG_FACTOR, self.spot_factor(spot)),
        ];
        if self.has_scales {
            pairs.extend([0, 1].map(|axis| (SCALE + axis, self.scale(mirror, axis))));
        }
        pairs.extend(self.of_direct((led, spot)));
        pairs
    }

    /// The same for the direct light.
    pub fn of_direct(&self, (led, spot): (usize, usize)) -> Vec<(usize, usize)> {
        vec![
            (LED, self.led(led, 0)),
            (LED + 1, self.led(led, 1)),
            (LED + 2, self.led(led, 2)),
            (SEMI_ANGLE, self.semi_angle()),
            (RAISE, self.raise()),
            (TILT, self.tilt(spot, 0)),
            (TILT + 1, self.tilt(spot, 1)),
            (PLACE, self.place(spot, 0)),
            (PLACE + 1, self.place(spot, 1)),
            (LOG_FACTOR, self.log_detector()),
        ]
    }

    /// The quantities of a pair of mirror and spot, or of the direct light without a mirror.
    pub fn quantities(&self, values: &[f64], pairs: &[(usize, usize)], height_m: f64) -> Quantities {
        let mut quantities = [0.0; QUANTITIES];
        for (quantity, parameter) in pairs {
            quantities[*quantity] += values[*parameter];
        }
        quantities[PLACE + 2] = height_m;
        quantities
    }

    /// Prior mean and standard deviation of every parameter. Places have none of their own: the
    /// tracker gives them.
    pub fn prior(&self, prior: &Prior, spots: &[Spot]) -> Vec<(f64, f64)> {
        let mut all = vec![(0.0, 1.0); self.len()];
        for mirror in 0..self.mirrors {
            for axis in 0..2 {
                all[self.offset(mirror, axis)] = (0.0, prior.offset_rad);
                if self.has_scales {
                    all[self.scale(mirror, axis)] = (0.0, prior.scale);
                }
            }
        }
        for led in 0..self.leds {
            for axis in 0..3 {
                all[self.led(led, axis)] = (0.0, prior.led_m);
            }
        }
        all[self.semi_angle()] = (0.0, prior.semi_angle);
        all[self.raise()] = (0.0, prior.raise_m);
        all[self.log_detector()] = (0.0, prior.received);
        all[self.log_reflectivity()] = (-MEAN_LOSS * prior.reflectivity_loss, prior.reflectivity_loss);
        for spot in 0..self.spots {
            all[self.spot_factor(spot)] = (0.0, SPOT_FACTOR);
        }
        for axis in 0..2 {
            all[self.shift(axis)] = (0.0, prior.shift_m);
            for (index, spot) in spots.iter().enumerate() {
                all[self.place(index, axis)] = (spot.tracked_m[axis], spot.tracked_deviation_m);
                all[self.tilt(index, axis)] = (0.0, prior.tilt);
            }
        }
        all
    }

    /// For each parameter its index in a layout of another number of spots, if it has one there.
    pub fn known_in(&self, other: &Self) -> Vec<Option<usize>> {
        let (places, scales) = (self.place(self.spots.min(other.spots), 0), self.scale(0, 0));
        let of = |index: usize| match index {
            _ if index < places => Some(index),
            _ if index >= scales && other.has_scales => Some(index - scales + other.scale(0, 0)),
            _ => None,
        };
        (0..self.len()).map(of).collect()
    }

    /// The values of another number of spots, for a layout with one more or fewer.
    pub fn carried(&self, from: &Self, values: &[f64], mut to: Vec<f64>) -> Vec<f64> {
        for (value, known) in to.iter_mut().zip(self.known_in(from)) {
            if let Some(index) = known {
                *value = values[index];
            }
        }
        to
    }
}
