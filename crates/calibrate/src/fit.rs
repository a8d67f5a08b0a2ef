//! The joint estimate of all parameters, with its covariance.
//!
//! The objective is the sum of Huber losses of the readings, of the direct light at each spot, and
//! of the priors. The solver is the Levenberg-Marquardt method of the crate `levenberg-marquardt`
//! with the exact Jacobian of [`optics`](crate::optics). Two additions follow from the light of a
//! mirror, which is zero outside a window of a degree or two:
//!
//! - An offset moves by at most [`STEP_MAX_RAD`] a round, because a mirror that leaves its window
//!   has no gradient that leads back. A round replaces the offset by anchor + c tanh(v).
//! - The noise of a reading grows with its gain, so each round computes it from the gains that
//!   the round before predicts.

use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt};
use nalgebra::{DMatrix, DVector};
use nalgebra_of_solver as solver;
use serde::{Deserialize, Serialize};

use crate::optics::{OFFSET, Optics, QUANTITIES, Quantities, variables};
use crate::parameters::{Layout, Prior, Spot};

/// Largest change of an offset in one round, in rad: 0.3 degrees.
pub const STEP_MAX_RAD: f64 = 0.3 * std::f64::consts::PI / 180.0;

/// Residual in standard deviations beyond which the loss is linear.
const HUBER: f64 = 2.0;

/// Most rounds of a fit.
const ROUNDS: usize = 8;

/// Most evaluations of a round, in units of the number of parameters plus one, as the solver counts.
const PATIENCE: usize = 1;

/// Relative change of the objective and of the variables that ends a round.
const TOLERANCE: f64 = 1e-3;

/// Change in units of the priors' spreads below which a fit has converged.
const CONVERGED: f64 = 0.01;

/// Error of the smooth model at the edge of a light, as a share of the mirror's largest gain.
pub const EDGE_ERROR: f64 = 0.07;

/// Error of the direct gain's model, relative.
const DIRECT_ERROR: f64 = 0.02;

/// One reading: the gain at a spot while one mirror was turned to it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reading {
    /// Index of the spot.
    pub spot: usize,
    /// Index of the mirror.
    pub mirror: usize,
    /// Commanded roll and yaw in rad.
    pub command: [f64; 2],
    /// Gain above the dark level.
    pub gain: f64,
}

/// The estimate.
#[derive(Clone, Debug)]
pub struct Estimate {
    /// Where each parameter is.
    pub layout: Layout,
    /// The values.
    pub values: Vec<f64>,
    /// Covariance of the values.
    pub covariance: DMatrix<f64>,
    /// Residual of each reading in standard deviations.
    pub residuals: Vec<f64>,
}

/// What a fit is made from.
#[derive(Clone, Copy, Debug)]
pub struct Data<'a> {
    /// The nominal equipment.
    pub optics: &'a Optics,
    /// The prior spreads.
    pub prior: &'a Prior,
    /// The spots.
    pub spots: &'a [Spot],
    /// The readings.
    pub readings: &'a [Reading],
}

impl Data<'_> {
    /// The parameters of these data.
    pub fn layout(&self) -> Layout {
        Layout::new(self.optics.centres.len(), self.optics.leds.len(), self.spots.len(), self.prior.scale > 0.0)
    }

    /// The quantities of a mirror's light at a spot.
    pub fn quantities(&self, layout: &Layout, values: &[f64], (mirror, spot): (usize, usize)) -> Quantities {
        let spot_of = &self.spots[spot];
        layout.quantities(values, &layout.of_reading((mirror, spot_of.led, spot)), spot_of.height_m)
    }

    /// Standard deviation of a reading with this gain, of a mirror with this largest gain.
    pub fn deviation(&self, spot: usize, gain: f64, peak: f64) -> f64 {
        deviation((self.spots[spot].noise_relative, self.spots[spot].noise_gain), gain, peak)
    }

    /// The largest gain of a mirror at a spot: that at its aim.
    pub fn peak(&self, quantities: &Quantities, (mirror, spot): (usize, usize)) -> f64 {
        let led = self.spots[spot].led;
        let Some(aim) = self.optics.aim((mirror, led), quantities) else { return 0.0 };
        let mut exact = *quantities;
        exact[OFFSET..OFFSET + 4].fill(0.0);
        self.optics.mirror_gain((mirror, led), aim, &exact)
    }
}

/// Standard deviation of a reading with this relative noise and this noise as a gain, where the model
/// gives `gain` and at most `peak`.
pub fn deviation((relative, additive): (f64, f64), gain: f64, peak: f64) -> f64 {
    // In the middle of the light and outside it the smooth model is nearly exact.
    let share = (gain / peak.max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
    let edge = EDGE_ERROR * peak * (0.25 + 3.0 * share * (1.0 - share));
    ((relative * gain).powi(2) + edge.powi(2) + additive.powi(2)).sqrt()
}

/// Fits all parameters, from these values on.
pub fn fit(data: Data<'_>, from: Vec<f64>) -> Estimate {
    let layout = data.layout();
    let prior = layout.prior(data.prior, data.spots);
    let mut values = from;
    for _ in 0..ROUNDS {
        let problem = Problem::new(data, &layout, &prior, &values);
        let (solved, _) = LevenbergMarquardt::new().with_tol(TOLERANCE).with_patience(PATIENCE).minimize(problem);
        let next = solved.values();
        let change =
            next.iter().zip(&values).zip(&prior).map(|((next, last), (_, spread))| (next - last).abs() / spread);
        let change = change.fold(0.0, f64::max);
        values = next;
        if change < CONVERGED {
            break;
        }
    }
    let problem = Problem::new(data, &layout, &prior, &values);
    let (residuals, jacobian) = problem.linear(true);
    // The variables are in units of the priors' spreads.
    let spreads = DVector::from_iterator(prior.len(), prior.iter().map(|(_, spread)| *spread));
    let information = jacobian.transpose() * &jacobian;
    let inverse = information.cholesky().map(|factor| factor.inverse());
    // The priors make the information positive definite; without them there is no covariance.
    let inverse = inverse.unwrap_or_else(|| DMatrix::identity(prior.len(), prior.len()));
    let covariance = DMatrix::from_fn(prior.len(), prior.len(), |row, column| {
        inverse[(row, column)] * spreads[row] * spreads[column]
    });
    let residuals = residuals.iter().take(data.readings.len()).copied().collect();
    Estimate { layout, values, covariance, residuals }
}

/// One round of a fit. Its variables are the changes from the anchor in units of the priors' spreads.
struct Problem<'a> {
    data: Data<'a>,
    layout: &'a Layout,
    prior: &'a [(f64, f64)],
    anchor: Vec<f64>,
    variables: Vec<f64>,
    /// Standard deviation of each reading.
    deviations: Vec<f64>,
    /// Parameters and quantities of each reading.
    pairs: Vec<Vec<(usize, usize)>>,
}

impl<'a> Problem<'a> {
    fn new(data: Data<'a>, layout: &'a Layout, prior: &'a [(f64, f64)], anchor: &[f64]) -> Self {
        let of = |reading: &Reading| (reading.mirror, data.spots[reading.spot].led, reading.spot);
        let pairs: Vec<_> = data.readings.iter().map(|reading| layout.of_reading(of(reading))).collect();
        let deviations = data.readings.iter().map(|reading| {
            let pair = (reading.mirror, reading.spot);
            let quantities = data.quantities(layout, anchor, pair);
            let led = data.spots[reading.spot].led;
            let gain = data.optics.mirror_gain((reading.mirror, led), reading.command, &quantities);
            data.deviation(reading.spot, gain, data.peak(&quantities, pair))
        });
        Self {
            deviations: deviations.collect(),
            data,
            layout,
            prior,
            anchor: anchor.to_vec(),
            variables: vec![0.0; prior.len()],
            pairs,
        }
    }

    /// Whether the parameter is an offset.
    fn is_limited(&self, parameter: usize) -> bool {
        parameter < self.layout.led(0, 0)
    }

    /// The values at the present variables.
    fn values(&self) -> Vec<f64> {
        let value = |(parameter, variable): (usize, &f64)| {
            let change = variable * self.prior[parameter].1;
            let limited =
                if self.is_limited(parameter) { STEP_MAX_RAD * (change / STEP_MAX_RAD).tanh() } else { change };
            self.anchor[parameter] + limited
        };
        self.variables.iter().enumerate().map(value).collect()
    }

    /// Number of residuals: readings, direct gains, priors.
    fn count(&self) -> usize {
        self.data.readings.len() + self.data.spots.len() + self.prior.len()
    }

    /// The residuals without derivatives.
    fn robust(&self) -> Vec<f64> {
        let values = self.values();
        let mut residuals = Vec::with_capacity(self.count());
        for ((reading, pairs), deviation) in self.data.readings.iter().zip(&self.pairs).zip(&self.deviations) {
            let spot = &self.data.spots[reading.spot];
            let quantities = self.layout.quantities(&values, pairs, spot.height_m);
            let gain = self.data.optics.mirror_gain((reading.mirror, spot.led), reading.command, &quantities);
            residuals.push(huber((gain - reading.gain) / deviation).0);
        }
        for (index, spot) in self.data.spots.iter().enumerate() {
            let pairs = self.layout.of_direct((spot.led, index));
            let quantities = self.layout.quantities(&values, &pairs, spot.height_m);
            let deviation = spot.direct_gain * spot.direct_deviation.hypot(DIRECT_ERROR);
            let gain = self.data.optics.direct_gain(spot.led, &quantities);
            let residual = if spot.direct_gain > 0.0 { (gain - spot.direct_gain) / deviation } else { 0.0 };
            residuals.push(huber(residual).0);
        }
        residuals.extend((0..self.prior.len()).map(|parameter| self.prior_residual(&values, parameter)));
        residuals
    }

    /// A prior's residual. The place of a spot is that of the tracker plus the shift.
    fn prior_residual(&self, values: &[f64], parameter: usize) -> f64 {
        let (mean, spread) = self.prior[parameter];
        let shift = self.axis_of_place(parameter).map_or(0.0, |axis| values[self.layout.shift(axis)]);
        (values[parameter] - mean - shift) / spread
    }

    /// The axis of a parameter that is a coordinate of a spot.
    fn axis_of_place(&self, parameter: usize) -> Option<usize> {
        let places = (0..self.layout.spots()).flat_map(|spot| [0, 1].map(|axis| (self.layout.place(spot, axis), axis)));
        places.into_iter().find(|(place, _)| *place == parameter).map(|(_, axis)| axis)
    }

    /// Residuals and Jacobian by the variables. With `plain` the residuals of readings are those
    /// before the loss, and the offsets are not limited.
    fn linear(&self, plain: bool) -> (Vec<f64>, DMatrix<f64>) {
        let values = self.values();
        let mut jacobian = DMatrix::zeros(self.count(), self.prior.len());
        let mut residuals = Vec::with_capacity(self.count());
        let slope = |parameter: usize| {
            let spread = self.prior[parameter].1;
            if plain || !self.is_limited(parameter) {
                return spread;
            }
            spread / (self.variables[parameter] * spread / STEP_MAX_RAD).cosh().powi(2)
        };
        let mut push =
            |residuals: &mut Vec<f64>, residual: f64, gradient: &[f64; QUANTITIES], pairs: &[(usize, usize)]| {
                let (robust, factor) = huber(residual);
                let row = residuals.len();
                residuals.push(if plain { residual } else { robust });
                for (quantity, parameter) in pairs {
                    jacobian[(row, *parameter)] += factor * gradient[*quantity] * slope(*parameter);
                }
            };
        for ((reading, pairs), deviation) in self.data.readings.iter().zip(&self.pairs).zip(&self.deviations) {
            let spot = &self.data.spots[reading.spot];
            let quantities = self.layout.quantities(&values, pairs, spot.height_m);
            let of = (reading.mirror, spot.led);
            let gain = self.data.optics.mirror_gain(of, reading.command, &variables(&quantities));
            let gradient = gradient_of(&gain, 1.0 / deviation);
            push(&mut residuals, (gain.re - reading.gain) / deviation, &gradient, pairs);
        }
        for (index, spot) in self.data.spots.iter().enumerate() {
            let pairs = self.layout.of_direct((spot.led, index));
            let quantities = self.layout.quantities(&values, &pairs, spot.height_m);
            let gain = self.data.optics.direct_gain(spot.led, &variables(&quantities));
            let weight = if spot.direct_gain > 0.0 {
                1.0 / (spot.direct_gain * spot.direct_deviation.hypot(DIRECT_ERROR))
            } else {
                0.0
            };
            let gradient = gradient_of(&gain, weight);
            push(&mut residuals, (gain.re - spot.direct_gain) * weight, &gradient, &pairs);
        }
        for parameter in 0..self.prior.len() {
            let row = residuals.len();
            residuals.push(self.prior_residual(&values, parameter));
            jacobian[(row, parameter)] += slope(parameter) / self.prior[parameter].1;
            if let Some(axis) = self.axis_of_place(parameter) {
                let shift = self.layout.shift(axis);
                jacobian[(row, shift)] -= slope(shift) / self.prior[parameter].1;
            }
        }
        (residuals, jacobian)
    }
}

fn gradient_of(gain: &crate::optics::Dual, weight: f64) -> [f64; QUANTITIES] {
    let derivatives = gain.eps.unwrap_generic(nalgebra::Const::<QUANTITIES>, nalgebra::U1);
    std::array::from_fn(|quantity| derivatives[quantity] * weight)
}

/// The signed root of twice the Huber loss, and its derivative by the residual.
///
/// The sum of its squares is twice the sum of the losses, so that a solver of least squares
/// minimises the Huber loss itself.
fn huber(residual: f64) -> (f64, f64) {
    let size = residual.abs();
    if size <= HUBER {
        return (residual, 1.0);
    }
    let root = (2.0 * HUBER * size - HUBER * HUBER).sqrt();
    (root.copysign(residual), HUBER / root)
}

impl LeastSquaresProblem<f64, solver::Dyn, solver::Dyn> for Problem<'_> {
    type ResidualStorage = solver::VecStorage<f64, solver::Dyn, solver::U1>;
    type JacobianStorage = solver::VecStorage<f64, solver::Dyn, solver::Dyn>;
    type ParameterStorage = solver::VecStorage<f64, solver::Dyn, solver::U1>;

    fn set_params(&mut self, variables: &solver::DVector<f64>) {
        self.variables.copy_from_slice(variables.as_slice());
    }

    fn params(&self) -> solver::DVector<f64> {
        solver::DVector::from_column_slice(&self.variables)
    }

    fn residuals(&self) -> Option<solver::DVector<f64>> {
        Some(solver::DVector::from_vec(self.robust()))
    }

    fn jacobian(&self) -> Option<solver::DMatrix<f64>> {
        let (_, jacobian) = self.linear(false);
        let (rows, columns) = jacobian.shape();
        Some(solver::DMatrix::from_vec(rows, columns, jacobian.as_slice().to_vec()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_huber_root_is_continuous_and_its_derivative_is_its_slope() {
        for residual in [-5.0, -2.1, -1.0, 0.3, 1.9, 2.0, 2.5, 40.0] {
            let step = 1e-6;
            let slope = (huber(residual + step).0 - huber(residual - step).0) / (2.0 * step);
            assert!((slope - huber(residual).1).abs() < 1e-5, "at {residual}: {slope}");
        }
    }
}
