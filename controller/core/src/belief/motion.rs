//! The motion of one user: a weighted bank of hypotheses.
//!
//! Bayesian online change-point detection (Adams and MacKay, 2007): each hypothesis is "moves so
//! since report r". A report adds hypotheses for a change within the last interval, and the
//! likelihood of the reported position and velocity updates all weights. The heaviest
//! eight are kept. The estimate is the mean of the bank.

use heliostat_scenario::Walk;
use serde::{Deserialize, Serialize};

use super::hypothesis::{Hypothesis, Plane, State};

/// Hypotheses that are kept after a report.
const HYPOTHESES: usize = 8;

/// Hypotheses that a report adds, see [`Change`].
const ADDED: usize = 6;

/// A hypothesis with less than this share of the heaviest one's weight is dropped: exp(-14) is
/// about one in a million.
const LOG_WEIGHT_MIN: f64 = -14.0;

/// Standard deviation in m/s of the velocity of a standing user, who shifts a little.
const STANDING_SPEED_M_S: f64 = 0.02;

/// Probability per report that a user is at another place than any motion explains, because the
/// tracker gave an old number to another user.
const JUMP_PROBABILITY: f64 = 1e-6;

/// Standard deviation in m of the place of a new user around the centre of the room. It is large beside
/// the noise of a report, so the first report decides: with noise of 0.1 m, a place 100 m from the
/// centre, the largest distance in a room along an axis, is estimated 1 mm from the reported one.
const ANYWHERE_M: f64 = 30.0;

/// Position and velocity of a report, and the standard deviations of one axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// x and y in m.
    pub position_m: [f64; 2],
    /// Along x and y in m/s; absent where the tracker does not measure it.
    pub velocity_m_s: Option<[f64; 2]>,
    /// Standard deviation of a coordinate in m.
    pub position_noise_m: f64,
    /// Standard deviation of a velocity component in m/s.
    pub velocity_noise_m_s: f64,
}

/// Means and covariance of the position and velocity of a user.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MotionEstimate {
    /// x and y in m.
    pub position_m: [f64; 2],
    /// Along x and y in m/s.
    pub velocity_m_s: [f64; 2],
    /// Covariance of the position in m2: xx, xy, yy.
    pub position_cov_m2: [f64; 3],
    /// Variance of a velocity component in m2/s2.
    pub velocity_var_m2_s2: f64,
}

/// What a user does after a change.
#[derive(Clone, Copy, Debug)]
enum Change {
    /// Walks straight on, in a new direction at a new speed.
    Turn,
    /// Stands still.
    Stand,
    /// Walks on a curve with this turn rate in rad/s, without a change of speed.
    Curve(f64),
    /// Is somewhere else.
    Jump,
}

/// The motion of one user.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Motion {
    bank: [Hypothesis; HYPOTHESES + ADDED],
    kept: usize,
}

impl Motion {
    /// A user of whom nothing is known.
    pub fn new(priors: &Walk) -> Self {
        let mut motion = Self { bank: [Hypothesis::default(); HYPOTHESES + ADDED], kept: 1 };
        motion.bank[0].state = anywhere(priors);
        motion
    }

    /// Takes a report, `elapsed_s` after the last one. True where the best explanation is that the
    /// user is at another place than any motion explains.
    pub fn correct(&mut self, priors: &Walk, elapsed_s: f64, sighting: &Sighting) -> bool {
        self.predict(priors, elapsed_s);
        let [x, y] = sighting.position_m;
        let position_var = sighting.position_noise_m * sighting.position_noise_m;
        let velocity_var = sighting.velocity_noise_m_s * sighting.velocity_noise_m_s;
        for hypothesis in &mut self.bank[..self.kept] {
            let state = &mut hypothesis.state;
            hypothesis.log_weight += state.correct_position(Plane::new(x, y), position_var);
            if let Some([along_x, along_y]) = sighting.velocity_m_s {
                hypothesis.log_weight += state.correct_velocity(Plane::new(along_x, along_y), velocity_var);
            }
        }
        // The jump is the last hypothesis that `predict` adds.
        let (jump, others) = (self.bank[self.kept - 1].log_weight, &self.bank[..self.kept - 1]);
        let jumped = others.iter().all(|hypothesis| hypothesis.log_weight < jump);
        self.keep_heaviest();
        jumped
    }

    /// The estimate `ahead_s` after the last report.
    pub fn estimate(&self, ahead_s: f64) -> MotionEstimate {
        let (mean, [xx, xy, yy]) = self.mixture(ahead_s);
        MotionEstimate {
            position_m: [mean.position.re, mean.position.im],
            velocity_m_s: [mean.velocity.re, mean.velocity.im],
            position_cov_m2: [xx, xy, yy],
            velocity_var_m2_s2: mean.velocity_var,
        }
    }

    /// Whether the hypotheses are those of a motion: a recorded state may hold any.
    pub(super) fn is_sound(&self) -> bool {
        (1..=HYPOTHESES).contains(&self.kept) && self.bank[..self.kept].iter().all(Hypothesis::is_sound)
    }

    /// Moves every hypothesis on, and adds those of a change within the interval.
    fn predict(&mut self, priors: &Walk, elapsed_s: f64) {
        let change = 1.0 - (-priors.changes_per_s * elapsed_s).exp();
        let (before, _) = self.mixture(0.0);
        for hypothesis in &mut self.bank[..self.kept] {
            hypothesis.state = hypothesis.state.predicted(hypothesis.turn_rate, elapsed_s);
            hypothesis.log_weight += (1.0 - change).max(f64::MIN_POSITIVE).ln();
        }
        let curve = priors.turn_rate_deg_per_s.to_radians();
        // The end of a curve counts as a curve without a turn rate.
        let changes = [
            (Change::Turn, 1.0 - priors.standing - priors.curving),
            (Change::Stand, priors.standing),
            (Change::Curve(curve), priors.curving / 3.0),
            (Change::Curve(-curve), priors.curving / 3.0),
            (Change::Curve(0.0), priors.curving / 3.0),
        ];
        for (kind, share) in changes {
            self.add(kind, change * share, (&before, priors, elapsed_s));
        }
        self.add(Change::Jump, JUMP_PROBABILITY, (&before, priors, elapsed_s));
    }

    fn add(&mut self, change: Change, probability: f64, (before, priors, elapsed_s): (&State, &Walk, f64)) {
        if probability <= 0.0 {
            return;
        }
        let (state, turn_rate) = match change {
            Change::Turn => (turned(before, priors.speed_m_s, elapsed_s), 0.0),
            Change::Stand => (turned(before, STANDING_SPEED_M_S, elapsed_s), 0.0),
            Change::Curve(rate) => (before.predicted(rate, elapsed_s), rate),
            Change::Jump => (anywhere(priors), 0.0),
        };
        self.bank[self.kept] = Hypothesis { state, turn_rate, log_weight: probability.ln() };
        self.kept += 1;
    }

    /// Keeps the heaviest hypotheses; the weights then add up to 1.
    fn keep_heaviest(&mut self) {
        self.bank[..self.kept].sort_unstable_by(|one, other| other.log_weight.total_cmp(&one.log_weight));
        let heaviest = self.bank[0].log_weight;
        let heavy = |hypothesis: &Hypothesis| hypothesis.log_weight - heaviest > LOG_WEIGHT_MIN;
        self.kept = self.bank[..self.kept.min(HYPOTHESES)].iter().take_while(|one| heavy(one)).count().max(1);
        let bank = &mut self.bank[..self.kept];
        let total: f64 = bank.iter().map(|hypothesis| (hypothesis.log_weight - heaviest).exp()).sum();
        bank.iter_mut().for_each(|hypothesis| hypothesis.log_weight -= heaviest + total.ln());
    }

    /// Mean state and covariance of the position after a time in s, by the first two moments.
    fn mixture(&self, ahead_s: f64) -> (State, [f64; 3]) {
        let mut states = [(0.0, State::default()); HYPOTHESES];
        let mut mean = State::default();
        for (entry, hypothesis) in states.iter_mut().zip(&self.bank[..self.kept]) {
            let (weight, state) =
                (hypothesis.log_weight.exp(), hypothesis.state.predicted(hypothesis.turn_rate, ahead_s));
            mean.position += weight * state.position;
            mean.velocity += weight * state.velocity;
            *entry = (weight, state);
        }
        let mut covariance = [0.0; 3];
        for (weight, state) in &states[..self.kept] {
            let (off, velocity_off) = (state.position - mean.position, state.velocity - mean.velocity);
            covariance[0] += weight * (state.position_var + off.re * off.re);
            covariance[1] += weight * off.re * off.im;
            covariance[2] += weight * (state.position_var + off.im * off.im);
            mean.cross += *weight * (state.cross + 0.5 * off * velocity_off.conj());
            mean.velocity_var += weight * (state.velocity_var + 0.5 * velocity_off.norm_sqr());
        }
        mean.position_var = 0.5 * (covariance[0] + covariance[2]);
        (mean, covariance)
    }
}

/// A user at an unknown place.
fn anywhere(priors: &Walk) -> State {
    let square = |value: f64| value * value;
    State { position_var: square(ANYWHERE_M), velocity_var: square(priors.speed_m_s), ..State::default() }
}

/// The state at the end of an interval in which the velocity became a new one of zero mean and this
/// standard deviation. The time of the change is uniform over the interval.
fn turned(before: &State, speed_m_s: f64, elapsed_s: f64) -> State {
    let (velocity_var, square_s) = (speed_m_s * speed_m_s, elapsed_s * elapsed_s);
    // The old velocity acts for half of the interval on average; its square for a third.
    let old = elapsed_s * before.cross.re + square_s / 3.0 * before.velocity_var;
    let when = square_s / 24.0 * before.velocity.norm_sqr();
    State {
        position: before.position + 0.5 * elapsed_s * before.velocity,
        velocity: Plane::default(),
        position_var: before.position_var + old + when + square_s / 3.0 * velocity_var,
        cross: Plane::new(0.5 * elapsed_s * velocity_var, 0.0),
        velocity_var,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PRIORS: Walk =
        Walk { changes_per_s: 0.3, speed_m_s: 0.8, standing: 0.1, curving: 0.2, turn_rate_deg_per_s: 45.84 };

    /// Errors that repeat every 16 reports and have mean 0 and standard deviation 1.
    fn error(index: usize) -> [f64; 2] {
        let angle = index as f64 * 2.399963;
        [angle.cos() * std::f64::consts::SQRT_2, angle.sin() * std::f64::consts::SQRT_2]
    }

    fn sighting(position: [f64; 2], velocity: [f64; 2], index: usize) -> Sighting {
        let ([dx, dy], [du, dv]) = (error(index), error(index + 5));
        Sighting {
            position_m: [position[0] + 0.05 * dx, position[1] + 0.05 * dy],
            velocity_m_s: Some([velocity[0] + 0.1 * du, velocity[1] + 0.1 * dv]),
            position_noise_m: 0.05,
            velocity_noise_m_s: 0.1,
        }
    }

    fn distance(estimate: &MotionEstimate, place: [f64; 2]) -> f64 {
        let [x, y] = estimate.position_m;
        (x - place[0]).hypot(y - place[1])
    }

    #[test]
    fn a_straight_walk_is_known_better_than_any_report() {
        let mut motion = Motion::new(&PRIORS);
        for index in 0..30 {
            let at = [0.08 * index as f64, 1.0];
            motion.correct(&PRIORS, 0.1, &sighting(at, [0.8, 0.0], index));
        }
        let ahead = motion.estimate(0.5);
        assert!(distance(&ahead, [0.08 * 29.0 + 0.4, 1.0]) < 0.04, "{ahead:?}");
        assert!(ahead.position_cov_m2[0].sqrt() < 0.05, "{ahead:?}");
    }

    #[test]
    fn a_turn_is_noticed_within_four_reports() {
        let mut motion = Motion::new(&PRIORS);
        for index in 0..30 {
            motion.correct(&PRIORS, 0.1, &sighting([0.1 * index as f64, 0.0], [1.0, 0.0], index));
        }
        for index in 1..5 {
            motion.correct(&PRIORS, 0.1, &sighting([2.9, 0.1 * index as f64], [0.0, 1.0], 30 + index));
        }
        let [along_x, along_y] = motion.estimate(0.0).velocity_m_s;
        assert!(along_x.abs() < 0.25 && (along_y - 1.0).abs() < 0.25, "{along_x} {along_y}");
    }

    #[test]
    fn a_standing_user_is_known_to_stand() {
        let mut motion = Motion::new(&PRIORS);
        for index in 0..40 {
            motion.correct(&PRIORS, 0.1, &sighting([1.0, 2.0], [0.0, 0.0], index));
        }
        let estimate = motion.estimate(1.0);
        assert!(distance(&estimate, [1.0, 2.0]) < 0.03, "{estimate:?}");
    }

    #[test]
    fn a_curve_is_predicted_better_than_by_a_straight_line() {
        let circle = |index: f64| {
            let angle = 0.08 * index;
            ([angle.cos(), angle.sin()], [-0.8 * angle.sin(), 0.8 * angle.cos()])
        };
        let straight = Walk { curving: 0.0, ..PRIORS };
        let miss = |priors: &Walk| {
            let mut motion = Motion::new(priors);
            let mut sum = 0.0;
            for index in 0..100 {
                let (position, velocity) = circle(index as f64);
                motion.correct(priors, 0.1, &sighting(position, velocity, index));
                if index > 20 {
                    sum += distance(&motion.estimate(0.3), circle(index as f64 + 3.0).0);
                }
            }
            sum
        };
        let (curving, straight) = (miss(&PRIORS), miss(&straight));
        assert!(curving < 0.8 * straight, "{curving} against {straight}");
    }

    #[test]
    fn a_report_of_the_same_time_and_a_long_silence_leave_finite_estimates() {
        let mut motion = Motion::new(&PRIORS);
        for (index, elapsed_s) in [0.0, 0.0, 1e-9, 3600.0, 1e9].into_iter().enumerate() {
            motion.correct(&PRIORS, elapsed_s, &sighting([1.0, 1.0], [0.0, 0.0], index));
            let estimate = motion.estimate(0.1);
            assert!(distance(&estimate, [1.0, 1.0]) < 0.3, "{elapsed_s}: {estimate:?}");
            assert!(estimate.position_cov_m2.iter().all(|value| value.is_finite()));
        }
    }
}
