//! The Gauss-Markov model with reflection.
//!
//! Speed and direction change at a fixed interval:
//!
//! s(n) = m s(n-1) + (1 - m) s_mean + sqrt(1 - m^2) s_std w(n), and the same for the direction,
//! with memory m and independent standard normal w. The speed s has the autocorrelation m^k over k
//! intervals. Here s_mean is the middle of the two walking speeds and s_std a sixth of their
//! difference. The user walks at s, bounded by the two speeds. Each user has its own mean
//! direction, drawn uniformly. A wall mirrors direction and mean direction; the source turns the
//! mean direction away from a wall instead. Places are uniform at all times.
//!
//! Sources: Liang and Haas, Predictive distance-based mobility management for PCS networks, IEEE
//! INFOCOM 1999; Camp, Boleng and Davies, A survey of mobility models for ad hoc network research,
//! Wireless Communications and Mobile Computing 2, 2002. The model uses the platform's sine, cosine
//! and logarithm.

use std::f64::consts::PI;

use heliostat_scenario::GaussMarkov as Settings;

use crate::random::{self, RoomRng};
use crate::world::mobility::motion::{Motion, reflect};
use crate::world::mobility::places::draw_point;
use crate::world::mobility::random_waypoint::Waypoints;
use crate::world::mobility::speeds::Speeds;
use crate::world::walker::Floor;

/// A Gauss-Markov process with its mean and standard deviation.
#[derive(Clone, Copy, Debug)]
struct Process {
    value: f64,
    mean: f64,
    std: f64,
}

impl Process {
    fn stationary(mean: f64, std: f64, rng: &mut RoomRng) -> Self {
        Self { value: mean + std * random::normal(rng), mean, std }
    }

    fn advance(&mut self, memory: f64, rng: &mut RoomRng) {
        let innovation = (1.0 - memory * memory).sqrt() * self.std * random::normal(rng);
        self.value = memory * self.value + (1.0 - memory) * self.mean + innovation;
    }
}

/// The Gauss-Markov walk of one user.
#[derive(Clone, Debug)]
pub struct GaussMarkov {
    floor: Floor,
    speeds: Speeds,
    memory: f64,
    interval_s: f64,
    at: [f64; 2],
    speed: Process,
    /// Direction in rad from +x towards +y.
    heading: Process,
    /// The direction as a unit vector.
    direction: [f64; 2],
    /// Time until the next change in s.
    left_s: f64,
    rng: RoomRng,
}

impl GaussMarkov {
    /// A walk in its stationary regime; the generator belongs to this user.
    pub fn new(settings: &Settings, waypoints: &Waypoints, mut rng: RoomRng) -> Self {
        let Waypoints { floor, speeds, .. } = *waypoints;
        let at = draw_point(&floor, &mut rng);
        let speed = speed_process(&speeds, &mut rng);
        let mean = random::uniform_in(&mut rng, -PI, PI);
        let heading = Process::stationary(mean, settings.direction_std_deg.to_radians(), &mut rng);
        let left_s = random::uniform(&mut rng) * settings.interval_s;
        Self {
            floor,
            speeds,
            memory: settings.memory,
            interval_s: settings.interval_s,
            at,
            speed,
            heading,
            direction: unit(heading.value),
            left_s,
            rng,
        }
    }

    /// Walks on for `dt_s` seconds, over as many changes as that takes.
    pub fn step(&mut self, dt_s: f64) {
        if self.speeds.are_zero() {
            return;
        }
        let mut left_s = dt_s;
        while left_s >= self.left_s {
            left_s -= self.left_s;
            self.walk(self.left_s);
            self.speed.advance(self.memory, &mut self.rng);
            self.heading.advance(self.memory, &mut self.rng);
            self.direction = unit(self.heading.value);
            self.left_s = self.interval_s;
        }
        self.walk(left_s);
        self.left_s -= left_s;
    }

    /// Where the user is now.
    pub fn motion(&self) -> Motion {
        let speed_m_s = self.speed_m_s();
        Motion { at: self.at, velocity: self.direction.map(|component| component * speed_m_s), facing: self.direction }
    }

    /// New speeds from now on.
    pub fn set_speeds(&mut self, speeds: Speeds) {
        self.speeds = speeds;
        self.speed = speed_process(&speeds, &mut self.rng);
    }

    fn speed_m_s(&self) -> f64 {
        let [min, max] = self.speeds.bounds_m_s();
        self.speed.value.clamp(min, max)
    }

    fn walk(&mut self, dt_s: f64) {
        let length_m = self.speed_m_s() * dt_s;
        for axis in [0, 1] {
            self.at[axis] += self.direction[axis] * length_m;
        }
        let [x, y] = reflect(&self.floor, &mut self.at, &mut self.direction);
        for angle in [&mut self.heading.value, &mut self.heading.mean] {
            *angle = if x { PI - *angle } else { *angle };
            *angle = if y { -*angle } else { *angle };
        }
    }
}

fn speed_process(speeds: &Speeds, rng: &mut RoomRng) -> Process {
    let [min, max] = speeds.bounds_m_s();
    Process::stationary(0.5 * (min + max), (max - min) / 6.0, rng)
}

fn unit(angle: f64) -> [f64; 2] {
    let (sin, cos) = angle.sin_cos();
    [cos, sin]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, stream};

    const FLOOR: Floor = Floor { length_x_m: 5.0, length_y_m: 3.0 };

    fn walk(memory: f64, user: u32) -> GaussMarkov {
        let waypoints = Waypoints { floor: FLOOR, speeds: Speeds::new(0.4, 1.6).unwrap(), pause_mean_s: 0.0 };
        let settings = Settings { memory, interval_s: 0.5, ..Settings::default() };
        GaussMarkov::new(&settings, &waypoints, stream(2, Purpose::Walk, user))
    }

    #[test]
    fn the_speed_has_the_autocorrelation_of_the_memory() {
        for memory in [0.0, 0.5, 0.9] {
            let mut walk = walk(memory, 0);
            let speeds: Vec<f64> = (0..60_000)
                .map(|_| {
                    walk.step(0.5);
                    let [x, y] = walk.motion().velocity;
                    x.hypot(y) - 1.0
                })
                .collect();
            let covariance = |lag: usize| {
                let pairs = speeds.iter().zip(&speeds[lag..]);
                pairs.map(|(a, b)| a * b).sum::<f64>() / (speeds.len() - lag) as f64
            };
            // A sixth of the range of speeds is 0.2 m/s.
            assert!((covariance(0).sqrt() - 0.2).abs() < 0.008, "{}", covariance(0));
            for lag in 1..=4 {
                let (found, expected) = (covariance(lag) / covariance(0), memory.powi(lag as i32));
                assert!((found - expected).abs() < 0.03, "memory {memory}, lag {lag}: {found} for {expected}");
            }
        }
    }

    #[test]
    fn the_direction_stays_near_its_mean_and_both_are_mirrored_at_a_wall() {
        let mut walk = walk(0.9, 1);
        let (mut sum, mut reflections) = (0.0, 0);
        let steps = 50_000;
        for _ in 0..steps {
            let mean = walk.heading.mean;
            walk.step(0.1);
            reflections += usize::from(mean != walk.heading.mean);
            sum += (walk.heading.value - walk.heading.mean).powi(2);
            let [cos, sin] = walk.direction;
            assert!(
                (unit(walk.heading.value)[0] - cos).abs() < 1e-9 && (unit(walk.heading.value)[1] - sin).abs() < 1e-9
            );
        }
        let std_deg = (sum / f64::from(steps)).sqrt().to_degrees();
        assert!((std_deg - 57.3).abs() < 5.0, "{std_deg}");
        assert!(reflections > 500, "{reflections}");
    }

    #[test]
    fn places_are_uniform_at_the_start_and_later() {
        for after_s in [0.0, 25.0] {
            let places = (0..20_000).map(|user| {
                let mut walk = walk(0.75, user);
                walk.step(after_s);
                walk.motion().at
            });
            let squares = places.fold([0.0; 2], |sum, at| {
                assert!(FLOOR.contains(at[0], at[1]));
                [sum[0] + at[0] * at[0], sum[1] + at[1] * at[1]]
            });
            // Uniform: variance L^2 / 12.
            for (square, length_m) in squares.into_iter().zip([5.0, 3.0]) {
                let ratio = square / 20_000.0 * 12.0 / (length_m * length_m);
                assert!((ratio - 1.0).abs() < 0.025, "{ratio} after {after_s} s");
            }
        }
    }
}
