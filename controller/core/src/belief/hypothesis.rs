//! One hypothesis about the motion of a user since a change point.
//!
//! The floor plane is the complex plane, so that a turn is a product. The state is position and
//! velocity; its errors are circular, so that one variance describes both axes. Over a time t the
//! hypothesis of a turn rate w predicts
//!
//! x' = x + a v, v' = r v with r = exp(i w t) and a = (r - 1) / (i w), or a = t without a turn.
//!
//! A straight path has no process noise: it is exact until the next change point, as the segments
//! of a random waypoint walk are. A user on a curve hardly keeps its turn rate and speed. There the
//! acceleration is white with the spectral density q = [`WANDER_M2_S3`], which adds q t^3 / 3 to
//! the variance of the position, q t^2 / 2 to the covariance and q t to that of the velocity
//! (Bar-Shalom, Li and Kirubarajan, "Estimation with applications to tracking and navigation",
//! section 6.2).

use num_complex::Complex;
use serde::{Deserialize, Serialize};

/// A point or a velocity in the floor plane: x + iy, in m or m/s.
pub(super) type Plane = Complex<f64>;

/// Below this turn rate in rad/s a path is straight.
const STRAIGHT_RAD_S: f64 = 1e-6;

/// Spectral density in m2/s3 of the acceleration along one axis on a curve: of a user who avoids others
/// by accelerations of 0.6 m/s2 that last for half a second.
const WANDER_M2_S3: f64 = 0.4;

/// Means and variances of position and velocity. Variances are those of one axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct State {
    pub position: Plane,
    pub velocity: Plane,
    /// Variance of the position in m2.
    pub position_var: f64,
    /// Half the mean of the position's error times the conjugate of the velocity's, in m2/s.
    pub cross: Plane,
    /// Variance of the velocity in m2/s2.
    pub velocity_var: f64,
}

/// Factors of the prediction over a time.
#[derive(Clone, Copy, Debug)]
struct Step {
    /// Multiplies the velocity to give the displacement, in s.
    reach: Plane,
    /// Multiplies the velocity.
    turn: Plane,
    /// Variance that the velocity gains, in m2/s2.
    wander: f64,
}

impl Step {
    fn new(turn_rate: f64, time_s: f64) -> Self {
        if turn_rate.abs() < STRAIGHT_RAD_S {
            return Self { reach: Plane::new(time_s, 0.0), turn: Plane::new(1.0, 0.0), wander: 0.0 };
        }
        let turn = Plane::from_polar(1.0, turn_rate * time_s);
        Self { reach: (turn - 1.0) / Plane::new(0.0, turn_rate), turn, wander: WANDER_M2_S3 * time_s }
    }
}

impl State {
    /// The state after a time in s, on a path with this turn rate in rad/s.
    pub fn predicted(&self, turn_rate: f64, time_s: f64) -> Self {
        let Step { reach, turn, wander } = Step::new(turn_rate, time_s);
        let spread = reach.norm_sqr() * self.velocity_var + wander * time_s * time_s / 3.0;
        Self {
            position: self.position + reach * self.velocity,
            velocity: turn * self.velocity,
            position_var: self.position_var + 2.0 * (reach.conj() * self.cross).re + spread,
            cross: turn.conj() * (self.cross + reach * self.velocity_var) + 0.5 * wander * time_s,
            velocity_var: self.velocity_var + wander,
        }
    }

    /// Takes a measured position with this variance in m2; returns the logarithm of its likelihood.
    pub fn correct_position(&mut self, measured: Plane, variance: f64) -> f64 {
        let innovation = measured - self.position;
        let total = self.position_var + variance;
        let (gain, velocity_gain) = (self.position_var / total, self.cross.conj() / total);
        self.position += gain * innovation;
        self.velocity += velocity_gain * innovation;
        self.velocity_var = (self.velocity_var - self.cross.norm_sqr() / total).max(0.0);
        self.cross *= 1.0 - gain;
        self.position_var *= 1.0 - gain;
        log_density(innovation, total)
    }

    /// Takes a measured velocity with this variance in m2/s2; returns the logarithm of its
    /// likelihood.
    pub fn correct_velocity(&mut self, measured: Plane, variance: f64) -> f64 {
        let innovation = measured - self.velocity;
        let total = self.velocity_var + variance;
        let (position_gain, gain) = (self.cross / total, self.velocity_var / total);
        self.position += position_gain * innovation;
        self.velocity += gain * innovation;
        self.position_var = (self.position_var - self.cross.norm_sqr() / total).max(0.0);
        self.cross *= 1.0 - gain;
        self.velocity_var *= 1.0 - gain;
        log_density(innovation, total)
    }
}

/// Logarithm of the density of a circular normal error with this variance an axis.
fn log_density(error: Plane, variance: f64) -> f64 {
    -0.5 * error.norm_sqr() / variance - (std::f64::consts::TAU * variance).ln()
}

/// A hypothesis and its weight.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Hypothesis {
    pub state: State,
    /// Turn rate in rad/s; 0 on a straight path.
    pub turn_rate: f64,
    /// Logarithm of the weight.
    pub log_weight: f64,
}

/// Largest absolute value in a sound hypothesis, in its own unit: beyond any room and walk.
const SOUND_MAX: f64 = 1e6;

impl Hypothesis {
    /// Whether all numbers are those of a walk: a recorded state may hold any.
    pub fn is_sound(&self) -> bool {
        let State { position, velocity, position_var, cross, velocity_var } = self.state;
        let numbers = [position.re, position.im, velocity.re, velocity.im, position_var, cross.re, cross.im];
        let others = [velocity_var, self.turn_rate, self.log_weight];
        // Comparisons with NaN are false.
        numbers.iter().chain(&others).all(|number| number.abs() <= SOUND_MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_straight_line_follows_the_least_squares_fit_of_its_reports() {
        // Positions 0, 1.2, 1.8 at 0, 1, 2 s: the fit is 0.1 + 0.9 t.
        let wide = 1e9;
        let mut state = State { position_var: wide, velocity_var: wide, ..State::default() };
        for (index, x) in [0.0, 1.2, 1.8].into_iter().enumerate() {
            if index > 0 {
                state = state.predicted(0.0, 1.0);
            }
            state.correct_position(Plane::new(x, 0.0), 1.0);
        }
        assert!((state.position - Plane::new(1.9, 0.0)).norm() < 1e-6, "{state:?}");
        assert!((state.velocity - Plane::new(0.9, 0.0)).norm() < 1e-6, "{state:?}");
        // Variances of the fit at its end: 5/6 and 1/2.
        assert!((state.position_var - 5.0 / 6.0).abs() < 1e-6 && (state.velocity_var - 0.5).abs() < 1e-6);
    }

    #[test]
    fn a_quarter_of_a_circle_ends_where_the_circle_does() {
        let state = State { position: Plane::new(1.0, 0.0), velocity: Plane::new(0.0, 1.0), ..State::default() };
        let end = state.predicted(1.0, std::f64::consts::FRAC_PI_2);
        assert!((end.position - Plane::new(0.0, 1.0)).norm() < 1e-12);
        assert!((end.velocity - Plane::new(-1.0, 0.0)).norm() < 1e-12);
    }

    #[test]
    fn an_exact_report_replaces_the_estimate() {
        let mut state = State { position_var: 0.04, velocity_var: 0.09, ..State::default() };
        state.correct_position(Plane::new(0.3, -0.2), 0.0);
        state.correct_velocity(Plane::new(1.0, 0.5), 0.0);
        assert_eq!((state.position, state.velocity), (Plane::new(0.3, -0.2), Plane::new(1.0, 0.5)));
        assert_eq!((state.position_var, state.velocity_var), (0.0, 0.0));
    }
}
