//! One axis of a mirror between two instants: the exact response to a set-point of constant speed.
//!
//! The chain is set-point u -> low-pass z -> second order y, each part optional: z' = w_c (u - z),
//! y'' + 2 d w y' + w^2 y = w^2 z. For u = a + b t both have closed forms: a straight line, a
//! decaying exponential from the low-pass, and the free motion of the second order. So a step of
//! any length is exact.

/// Minimum relative distance between the low-pass and a real pole of the second order, where the
/// closed form divides by 0.
const POLE_DISTANCE: f64 = 1e-4;

/// A second-order response.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SecondOrder {
    /// Natural frequency w in rad/s.
    pub frequency: f64,
    /// Damping ratio d.
    pub damping: f64,
}

/// The linear part of an axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Dynamics {
    low_pass: Option<f64>,
    second_order: Option<SecondOrder>,
    /// Amplitude of y for a unit exponential exp(-w_c t) in z.
    exponential_gain: f64,
}

/// The state of an axis.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct AxisState {
    /// The rate-limited set-point u in rad.
    pub set_point: f64,
    /// Output z of the low-pass in rad.
    pub filtered: f64,
    /// Angle y in rad.
    pub angle: f64,
    /// Speed y' in rad/s.
    pub speed: f64,
}

impl AxisState {
    /// An axis that stands still at `angle`.
    pub fn at_rest(angle: f64) -> Self {
        Self { set_point: angle, filtered: angle, angle, speed: 0.0 }
    }
}

/// The factors of a step of one length, shared by all axes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Propagator {
    duration: f64,
    low_pass_decay: f64,
    /// exp(-d w h) times cos or cosh.
    even: f64,
    /// exp(-d w h) times sin or sinh over its frequency; exp(-w h) h at critical damping.
    odd: f64,
}

impl Dynamics {
    /// A low-pass (cut-off in rad/s) and a second order, both optional.
    ///
    /// A low-pass that coincides with a pole of an overdamped second order is moved by a
    /// ten-thousandth.
    pub fn new(low_pass: Option<f64>, second_order: Option<SecondOrder>) -> Self {
        let Some((cut_off, SecondOrder { frequency, damping })) = low_pass.zip(second_order) else {
            return Self { low_pass, second_order, exponential_gain: 0.0 };
        };
        let characteristic = |w_c: f64| w_c * w_c - 2.0 * damping * frequency * w_c + frequency * frequency;
        let mut moved = cut_off;
        while characteristic(moved).abs() < (POLE_DISTANCE * frequency).powi(2) {
            moved *= 1.0 + 2.0 * POLE_DISTANCE;
        }
        let exponential_gain = frequency * frequency / characteristic(moved);
        Self { low_pass: Some(moved), second_order, exponential_gain }
    }

    /// Whether the angle is the set-point itself.
    pub fn is_instant(&self) -> bool {
        self.low_pass.is_none() && self.second_order.is_none()
    }

    /// The factors of a step of `duration` seconds.
    pub fn propagator(&self, duration: f64) -> Propagator {
        let low_pass_decay = self.low_pass.map_or(0.0, |cut_off| (-cut_off * duration).exp());
        let (even, odd) = self.second_order.map_or((0.0, 0.0), |second_order| second_order.free_motion(duration));
        Propagator { duration, low_pass_decay, even, odd }
    }

    /// Advances an axis by the propagator's duration while its set-point moves at `rate` rad/s.
    pub fn advance(&self, state: &mut AxisState, rate: f64, by: &Propagator) {
        let (start, duration) = (state.set_point, by.duration);
        let end = start + rate * duration;
        state.set_point = end;
        // z is the line u - lag plus the transient that decays with the low-pass.
        let (lag, transient) = match self.low_pass {
            Some(cut_off) => (rate / cut_off, state.filtered - start + rate / cut_off),
            None => (0.0, 0.0),
        };
        let transient_end = transient * by.low_pass_decay;
        state.filtered = end - lag + transient_end;
        let Some(SecondOrder { frequency, damping }) = self.second_order else {
            (state.angle, state.speed) = (state.filtered, 0.0);
            return;
        };
        let line_lag = lag + 2.0 * damping * rate / frequency;
        let cut_off = self.low_pass.unwrap_or(0.0);
        let forced_start = start - line_lag + self.exponential_gain * transient;
        let forced_speed_start = rate - self.exponential_gain * transient * cut_off;
        let (e, v) = (state.angle - forced_start, state.speed - forced_speed_start);
        let drag = damping * frequency;
        state.angle =
            e * (by.even + drag * by.odd) + v * by.odd + end - line_lag + self.exponential_gain * transient_end;
        state.speed = v * (by.even - drag * by.odd) - e * frequency * frequency * by.odd + rate
            - self.exponential_gain * transient_end * cut_off;
    }
}

impl SecondOrder {
    /// exp(-d w h) cos(w_d h) and exp(-d w h) sin(w_d h) / w_d, or their forms at and above
    /// critical damping.
    fn free_motion(&self, duration: f64) -> (f64, f64) {
        let drag = self.damping * self.frequency;
        let under = self.frequency * self.frequency - drag * drag;
        let frequency = under.abs().sqrt();
        if frequency * duration < 1e-6 {
            let decay = (-drag * duration).exp();
            (decay, decay * duration)
        } else if under > 0.0 {
            let (sin, cos) = (frequency * duration).sin_cos();
            let decay = (-drag * duration).exp();
            (decay * cos, decay * sin / frequency)
        } else {
            // A sum of two decays, because cosh alone overflows in a long step.
            let (slow, fast) = ((-(drag - frequency) * duration).exp(), (-(drag + frequency) * duration).exp());
            (0.5 * (slow + fast), 0.5 * (slow - fast) / frequency)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The same equations integrated by classical Runge-Kutta in tiny steps: an independent
    /// implementation.
    fn integrate(dynamics: &Dynamics, state: &AxisState, rate: f64, duration: f64) -> AxisState {
        let cut_off = dynamics.low_pass;
        let SecondOrder { frequency, damping } = dynamics.second_order.expect("the test has one");
        let derivative = |u: f64, [z, y, v]: [f64; 3]| {
            let input = if cut_off.is_some() { z } else { u };
            [
                cut_off.map_or(0.0, |w| w * (u - z)),
                v,
                frequency * frequency * (input - y) - 2.0 * damping * frequency * v,
            ]
        };
        let steps = 20_000;
        let h = duration / f64::from(steps);
        let mut x = [state.filtered, state.angle, state.speed];
        for i in 0..steps {
            let u = |s: f64| state.set_point + rate * (f64::from(i) + s) * h;
            let add = |k: [f64; 3], s: f64| [0, 1, 2].map(|i| x[i] + s * h * k[i]);
            let k1 = derivative(u(0.0), x);
            let k2 = derivative(u(0.5), add(k1, 0.5));
            let k3 = derivative(u(0.5), add(k2, 0.5));
            let k4 = derivative(u(1.0), add(k3, 1.0));
            x = [0, 1, 2].map(|i| x[i] + h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]));
        }
        let set_point = state.set_point + rate * duration;
        let filtered = if cut_off.is_some() { x[0] } else { set_point };
        AxisState { set_point, filtered, angle: x[1], speed: x[2] }
    }

    #[test]
    fn the_closed_form_agrees_with_numerical_integration() {
        let start = AxisState { set_point: 0.3, filtered: -0.1, angle: 0.2, speed: 5.0 };
        for low_pass in [None, Some(400.0), Some(2500.0)] {
            for damping in [0.05, 0.7, 1.0, 1.8] {
                for (rate, duration) in [(0.0, 0.002), (30.0, 0.003), (-12.0, 0.02)] {
                    let second_order = SecondOrder { frequency: 900.0, damping };
                    let dynamics = Dynamics::new(low_pass, Some(second_order));
                    let expected = integrate(&dynamics, &start, rate, duration);
                    let mut got = start;
                    dynamics.advance(&mut got, rate, &dynamics.propagator(duration));
                    let case = format!("{low_pass:?} {damping} {rate} {duration}: {got:?} for {expected:?}");
                    assert!((got.angle - expected.angle).abs() < 1e-7, "{case}");
                    assert!((got.speed - expected.speed).abs() < 1e-4, "{case}");
                    assert!((got.filtered - expected.filtered).abs() < 1e-9, "{case}");
                }
            }
        }
    }

    #[test]
    fn a_low_pass_on_a_pole_of_the_second_order_stays_finite() {
        for (frequency, damping) in [(100.0, 1.0), (100.0, 1.25)] {
            let pole = frequency * (damping + f64::sqrt(damping * damping - 1.0));
            let dynamics = Dynamics::new(Some(pole), Some(SecondOrder { frequency, damping }));
            let mut state = AxisState { set_point: 1.0, ..AxisState::default() };
            dynamics.advance(&mut state, 0.0, &dynamics.propagator(0.02));
            assert!(state.angle > 0.0 && state.angle < 1.0, "{state:?}");
            dynamics.advance(&mut state, 0.0, &dynamics.propagator(1e3));
            assert!((state.angle - 1.0).abs() < 1e-9, "{state:?}");
        }
    }
}
