//! How the users move: the random waypoint walk, or a recording in its place ([`crate::trace`]).
//!
//! A walker goes straight to a point drawn uniformly in the room, at a speed drawn uniformly for that leg, and at once draws the next.
//! The walk starts in its stationary regime (no warm-up) and is exact over any time step: a step may cover many legs.
//! Only the four operations and square roots are used, so the walk is the same on every platform, bit for bit.

use heliostat_channel::Vec3;
use thiserror::Error;

use crate::random::{self, Purpose, RoomRng};
use crate::trace::Trace;

/// Why a walk cannot be made.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum MobilityError {
    /// At zero speed a leg never ends, so the slowest speed must be positive unless nobody moves at all.
    #[error(
        "speeds from {min} to {max} m/s: the slowest must be above 0 and at most the fastest (or both 0: nobody moves)"
    )]
    Speed {
        /// Slowest speed in m/s.
        min: f64,
        /// Fastest speed in m/s.
        max: f64,
    },
}

/// The rectangle in which people walk, centred on the origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Floor {
    /// Extent along x in m.
    pub length_x_m: f64,
    /// Extent along y in m.
    pub length_y_m: f64,
}

impl Floor {
    /// Whether a point lies on the floor.
    pub fn contains(&self, x: f64, y: f64) -> bool {
        x.abs() <= 0.5 * self.length_x_m && y.abs() <= 0.5 * self.length_y_m
    }

    fn draw(&self, rng: &mut RoomRng) -> [f64; 2] {
        [0.5 * self.length_x_m, 0.5 * self.length_y_m].map(|half| random::uniform_in(rng, -half, half))
    }

    fn diagonal(&self) -> f64 {
        (self.length_x_m * self.length_x_m + self.length_y_m * self.length_y_m).sqrt()
    }
}

/// The speeds of the legs, uniform between two bounds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Speeds {
    min: f64,
    max: f64,
}

impl Speeds {
    /// Speeds from `min` to `max` in m/s; both 0 is a room in which everybody stands.
    ///
    /// # Errors
    /// [`MobilityError::Speed`] for a negative, zero, infinite or inverted pair.
    pub fn new(min: f64, max: f64) -> Result<Self, MobilityError> {
        let standing = min == 0.0 && max == 0.0;
        if standing || (min > 0.0 && min <= max && max.is_finite()) {
            Ok(Self { min, max })
        } else {
            Err(MobilityError::Speed { min, max })
        }
    }

    /// Slowest and fastest in m/s.
    pub fn bounds_m_s(&self) -> [f64; 2] {
        [self.min, self.max]
    }

    fn draw(&self, rng: &mut RoomRng) -> f64 {
        random::uniform_in(rng, self.min, self.max)
    }

    /// The speed of the leg that is under way at a random time: a leg lasts as long as 1/v, so the density is uniform times 1/v.
    fn draw_under_way(&self, rng: &mut RoomRng) -> f64 {
        loop {
            let speed = self.draw(rng);
            if random::uniform(rng) * speed <= self.min {
                return speed;
            }
        }
    }
}

/// One user's receiver: where it is, which way its owner faces, and how it moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Walker {
    /// Position of the detector in m, in the room frame.
    pub position: Vec3,
    /// Unit vector on the floor: the way the owner faces; the body stands behind.
    pub direction: [f64; 2],
    /// Velocity on the floor in m/s.
    pub velocity: [f64; 2],
}

impl Walker {
    /// The way the owner faces, in radians from +x towards +y.
    pub fn heading(&self) -> f64 {
        self.direction[1].atan2(self.direction[0])
    }
}

/// A straight leg of the walk.
#[derive(Clone, Copy, Debug)]
struct Leg {
    from: [f64; 2],
    to: [f64; 2],
    length: f64,
    travelled: f64,
    speed: f64,
}

impl Leg {
    fn new(from: [f64; 2], to: [f64; 2], speed: f64) -> Self {
        let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
        Self { from, to, length: (dx * dx + dy * dy).sqrt(), travelled: 0.0, speed }
    }

    /// The leg under way at a random time: long legs are met more often, in proportion to their length, at any point of them.
    fn under_way(floor: &Floor, speeds: &Speeds, rng: &mut RoomRng) -> Self {
        let longest = floor.diagonal();
        loop {
            let mut leg = Self::new(floor.draw(rng), floor.draw(rng), 0.0);
            if random::uniform(rng) * longest < leg.length {
                leg.travelled = random::uniform(rng) * leg.length;
                leg.speed = speeds.draw_under_way(rng);
                return leg;
            }
        }
    }

    fn direction(&self) -> [f64; 2] {
        if self.length > 0.0 {
            [(self.to[0] - self.from[0]) / self.length, (self.to[1] - self.from[1]) / self.length]
        } else {
            [1.0, 0.0]
        }
    }
}

/// The random waypoint walk of one user.
#[derive(Clone, Debug)]
pub struct RandomWaypoint {
    floor: Floor,
    speeds: Speeds,
    leg: Leg,
    rng: RoomRng,
}

impl RandomWaypoint {
    /// A walk in its stationary regime; the generator is the walker's own.
    pub fn new(floor: Floor, speeds: Speeds, mut rng: RoomRng) -> Self {
        let leg = Leg::under_way(&floor, &speeds, &mut rng);
        Self { floor, speeds, leg, rng }
    }

    /// Walks on for `dt_s` seconds, through as many legs as that takes.
    pub fn step(&mut self, dt_s: f64) {
        if self.leg.speed == 0.0 {
            return;
        }
        let mut left = dt_s;
        loop {
            let until_arrival = (self.leg.length - self.leg.travelled) / self.leg.speed;
            if left < until_arrival {
                self.leg.travelled += self.leg.speed * left;
                return;
            }
            left -= until_arrival;
            let next = self.floor.draw(&mut self.rng);
            self.leg = Leg::new(self.leg.to, next, self.speeds.draw(&mut self.rng));
        }
    }

    /// New speeds from now on; the leg under way takes a new one too.
    pub fn set_speeds(&mut self, speeds: Speeds) {
        self.speeds = speeds;
        self.leg.speed = speeds.draw(&mut self.rng);
    }

    fn write(&self, walker: &mut Walker) {
        let share = if self.leg.length > 0.0 { self.leg.travelled / self.leg.length } else { 0.0 };
        // Between the end points, and so inside the room, whatever the rounding.
        let between = |axis: usize| self.leg.from[axis] + share.min(1.0) * (self.leg.to[axis] - self.leg.from[axis]);
        walker.position.x = between(0);
        walker.position.y = between(1);
        walker.direction = self.leg.direction();
        walker.velocity = walker.direction.map(|component| component * self.leg.speed);
    }
}

/// What moves the users.
#[derive(Clone, Debug)]
pub enum Mobility {
    /// Each user walks at random.
    RandomWaypoint(Vec<RandomWaypoint>),
    /// A recording is played.
    Trace(Trace),
}

impl Mobility {
    /// Random walks for `users` people, each with its own random stream, so that one more user leaves the others' walks alone.
    pub fn random_waypoint(floor: Floor, speeds: Speeds, users: usize, seed: u64) -> Self {
        let walks = (0..users)
            .map(|user| RandomWaypoint::new(floor, speeds, random::stream(seed, Purpose::Walk, user as u32)))
            .collect();
        Self::RandomWaypoint(walks)
    }

    /// Moves on by `dt_s` seconds.
    pub fn step(&mut self, dt_s: f64) {
        match self {
            Self::RandomWaypoint(walks) => walks.iter_mut().for_each(|walk| walk.step(dt_s)),
            Self::Trace(trace) => trace.step(dt_s),
        }
    }

    /// Writes where everybody is; heights are left as they are.
    pub fn write(&self, walkers: &mut [Walker]) {
        match self {
            Self::RandomWaypoint(walks) => {
                walks.iter().zip(walkers).for_each(|(walk, walker)| walk.write(walker));
            }
            Self::Trace(trace) => trace.write(walkers),
        }
    }

    /// New walking speeds; a recording keeps its own.
    pub fn set_speeds(&mut self, speeds: Speeds) {
        if let Self::RandomWaypoint(walks) = self {
            walks.iter_mut().for_each(|walk| walk.set_speeds(speeds));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FLOOR: Floor = Floor { length_x_m: 5.0, length_y_m: 5.0 };

    fn walkers(count: usize) -> Vec<Walker> {
        vec![Walker { position: Vec3::zeros(), direction: [1.0, 0.0], velocity: [0.0, 0.0] }; count]
    }

    fn sample(seed: u64, users: usize, after_s: f64) -> Vec<Walker> {
        let mut mobility = Mobility::random_waypoint(FLOOR, Speeds::new(0.1, 2.0).unwrap(), users, seed);
        mobility.step(after_s);
        let mut out = walkers(users);
        mobility.write(&mut out);
        out
    }

    /// Variance of x and the largest gap between its distribution and that of equation (4), F(x) = 1/2 + 3x/(2L) - 2x^3/L^3.
    fn against_equation_4(mut xs: Vec<f64>) -> (f64, f64) {
        xs.sort_by(f64::total_cmp);
        let n = xs.len() as f64;
        let variance = xs.iter().map(|x| x * x).sum::<f64>() / n;
        let gap = xs.iter().enumerate().map(|(i, x)| {
            let equation = 0.5 + 1.5 * x / 5.0 - 2.0 * (x / 5.0).powi(3);
            (equation - (i as f64 + 0.5) / n).abs()
        });
        (variance, gap.fold(0.0, f64::max))
    }

    #[test]
    fn the_stationary_distribution_is_near_equation_4_from_the_first_moment_on() {
        for after_s in [0.0, 40.0] {
            let xs = sample(3, 60_000, after_s).iter().map(|walker| walker.position.x).collect();
            let (variance, gap) = against_equation_4(xs);
            assert!((variance - 1.34).abs() < 0.025, "variance {variance} after {after_s} s; equation (4) says 1.25");
            assert!(gap < 0.03, "largest gap {gap} after {after_s} s");
        }
    }

    #[test]
    fn mean_speed_is_the_stationary_one() {
        // Uniform in [a, b] per leg is log-uniform in time: mean (b - a) / ln(b / a).
        let expected = 1.9 / 20.0_f64.ln();
        for after_s in [0.0, 40.0] {
            let out = sample(4, 40_000, after_s);
            let mean = out.iter().map(|w| w.velocity[0].hypot(w.velocity[1])).sum::<f64>() / out.len() as f64;
            assert!((mean - expected).abs() < 0.01, "{mean} for {expected} after {after_s} s");
        }
    }

    #[test]
    fn one_long_step_ends_where_many_short_ones_do() {
        let long = sample(5, 20, 60.0);
        let mut mobility = Mobility::random_waypoint(FLOOR, Speeds::new(0.1, 2.0).unwrap(), 20, 5);
        for _ in 0..6000 {
            mobility.step(0.01);
        }
        let mut short = walkers(20);
        mobility.write(&mut short);
        for (a, b) in long.iter().zip(&short) {
            assert!((a.position - b.position).norm() < 1e-9, "{:?} {:?}", a.position, b.position);
        }
    }

    #[test]
    fn walkers_stay_in_the_room_and_move_as_their_velocity_says() {
        let mut mobility = Mobility::random_waypoint(FLOOR, Speeds::new(0.1, 2.0).unwrap(), 10, 6);
        let (mut before, mut after) = (walkers(10), walkers(10));
        for _ in 0..5000 {
            mobility.write(&mut before);
            mobility.step(0.02);
            mobility.write(&mut after);
            for (a, b) in before.iter().zip(&after) {
                assert!(FLOOR.contains(b.position.x, b.position.y));
                assert!((b.direction[0].hypot(b.direction[1]) - 1.0).abs() < 1e-12);
                assert!((b.position - a.position).norm() <= 2.0 * 0.02 + 1e-12);
                if a.velocity == b.velocity {
                    let expected = a.position + Vec3::new(a.velocity[0], a.velocity[1], 0.0) * 0.02;
                    assert!((b.position - expected).norm() < 1e-12);
                }
            }
        }
    }

    #[test]
    fn one_more_user_leaves_the_others_alone() {
        assert_eq!(sample(7, 3, 10.0), sample(7, 4, 10.0)[..3]);
    }

    #[test]
    fn speeds_are_checked_and_zero_means_standing() {
        for (min, max) in [(0.0, 1.0), (-1.0, 1.0), (2.0, 1.0), (0.1, f64::INFINITY), (f64::NAN, 1.0)] {
            assert!(Speeds::new(min, max).is_err(), "{min} {max}");
        }
        let mut mobility = Mobility::random_waypoint(FLOOR, Speeds::new(0.0, 0.0).unwrap(), 5, 8);
        let (mut before, mut after) = (walkers(5), walkers(5));
        mobility.write(&mut before);
        mobility.step(100.0);
        mobility.write(&mut after);
        assert_eq!(before, after);
        mobility.set_speeds(Speeds::new(1.0, 1.0).unwrap());
        mobility.step(0.001);
        mobility.write(&mut after);
        assert_ne!(before, after);
    }
}
