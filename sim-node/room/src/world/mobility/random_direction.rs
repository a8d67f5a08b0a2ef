//! The random direction model with reflection.
//!
//! A user walks in a direction drawn uniformly, at a speed drawn uniformly, for an exponential
//! time, and then draws again. A wall mirrors the direction. With pauses the user stands after each
//! movement for an exponential time. The direction of a standing user is drawn uniformly.
//!
//! Places and directions that are uniform at the start are uniform at all times, as the source
//! proves, so the walk starts in its stationary regime.
//!
//! Source: Nain, Towsley, Liu and Liu, Properties of random direction models, IEEE INFOCOM 2005.

use heliostat_scenario::RandomDirection as Settings;

use crate::random::{self, RoomRng};
use crate::world::mobility::motion::{Motion, draw_direction, reflect};
use crate::world::mobility::places::draw_point;
use crate::world::mobility::random_waypoint::Waypoints;
use crate::world::mobility::speeds::Speeds;
use crate::world::walker::Floor;

/// What the user does.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    Walking,
    Standing,
}

/// The random direction walk of one user.
#[derive(Clone, Debug)]
pub struct RandomDirection {
    floor: Floor,
    speeds: Speeds,
    travel_time_mean_s: f64,
    pause_mean_s: f64,
    at: [f64; 2],
    direction: [f64; 2],
    speed_m_s: f64,
    phase: Phase,
    /// Time until the phase ends in s.
    left_s: f64,
    rng: RoomRng,
}

impl RandomDirection {
    /// A walk in its stationary regime; the generator belongs to this user.
    pub fn new(settings: &Settings, waypoints: &Waypoints, rng: RoomRng) -> Self {
        let Waypoints { floor, speeds, pause_mean_s } = *waypoints;
        let travel_time_mean_s = settings.travel_time_mean_s;
        let mut walk = Self {
            floor,
            speeds,
            travel_time_mean_s,
            pause_mean_s,
            at: [0.0; 2],
            direction: [1.0, 0.0],
            speed_m_s: 0.0,
            phase: Phase::Walking,
            left_s: 0.0,
            rng,
        };
        walk.at = draw_point(&floor, &mut walk.rng);
        // The rest of an exponential time has the same distribution as the time.
        let is_standing = random::uniform(&mut walk.rng) * (pause_mean_s + travel_time_mean_s) < pause_mean_s;
        walk.begin(if is_standing { Phase::Standing } else { Phase::Walking });
        walk
    }

    /// Walks on for `dt_s` seconds, over as many movements as that takes.
    pub fn step(&mut self, dt_s: f64) {
        if self.speeds.are_zero() {
            return;
        }
        let mut left_s = dt_s;
        while left_s >= self.left_s {
            left_s -= self.left_s;
            self.walk(self.left_s);
            self.begin(match self.phase {
                Phase::Walking if self.pause_mean_s > 0.0 => Phase::Standing,
                _ => Phase::Walking,
            });
        }
        self.walk(left_s);
        self.left_s -= left_s;
    }

    /// Where the user is now.
    pub fn motion(&self) -> Motion {
        let speed_m_s = if self.phase == Phase::Walking { self.speed_m_s } else { 0.0 };
        let velocity = self.direction.map(|component| component * speed_m_s);
        Motion { at: self.at, velocity, facing: self.direction }
    }

    /// New speeds from now on; the movement under way gets a new one too.
    pub fn set_speeds(&mut self, speeds: Speeds) {
        self.speeds = speeds;
        self.speed_m_s = speeds.draw(&mut self.rng);
    }

    fn begin(&mut self, phase: Phase) {
        self.phase = phase;
        self.direction = draw_direction(&mut self.rng);
        let mean_s = match phase {
            Phase::Walking => {
                self.speed_m_s = self.speeds.draw(&mut self.rng);
                self.travel_time_mean_s
            }
            Phase::Standing => self.pause_mean_s,
        };
        self.left_s = random::exponential(&mut self.rng, mean_s);
    }

    fn walk(&mut self, dt_s: f64) {
        if self.phase == Phase::Walking {
            for axis in [0, 1] {
                self.at[axis] += self.direction[axis] * self.speed_m_s * dt_s;
            }
            reflect(&self.floor, &mut self.at, &mut self.direction);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, stream};

    const FLOOR: Floor = Floor { length_x_m: 4.0, length_y_m: 2.0 };

    fn walks(users: u32, pause_mean_s: f64, after_s: f64) -> Vec<Motion> {
        let waypoints = Waypoints { floor: FLOOR, speeds: Speeds::new(0.5, 1.5).unwrap(), pause_mean_s };
        let settings = Settings { travel_time_mean_s: 2.0 };
        let walk = |user| {
            let mut walk = RandomDirection::new(&settings, &waypoints, stream(1, Purpose::Walk, user));
            walk.step(after_s);
            walk.motion()
        };
        (0..users).map(walk).collect()
    }

    /// The largest gap between the distribution of values and the uniform one on [-half, half].
    fn gap_to_uniform(mut values: Vec<f64>, half: f64) -> f64 {
        values.sort_by(f64::total_cmp);
        let n = values.len() as f64;
        let gap = |(index, value): (usize, &f64)| ((value + half) / (2.0 * half) - (index as f64 + 0.5) / n).abs();
        values.iter().enumerate().map(gap).fold(0.0, f64::max)
    }

    #[test]
    fn places_and_directions_are_uniform_at_the_start_and_later() {
        for after_s in [0.0, 1.0, 30.0] {
            let motions = walks(20_000, 0.0, after_s);
            for (axis, half) in [(0, 2.0), (1, 1.0)] {
                let gap = gap_to_uniform(motions.iter().map(|motion| motion.at[axis]).collect(), half);
                // 1.63 / sqrt(n): the 1 % point of the Kolmogorov-Smirnov test.
                assert!(gap < 0.0115, "axis {axis}: {gap} after {after_s} s");
            }
            let headings = motions.iter().map(|motion| motion.facing[1].atan2(motion.facing[0])).collect();
            let gap = gap_to_uniform(headings, std::f64::consts::PI);
            assert!(gap < 0.0115, "{gap} after {after_s} s");
        }
    }

    #[test]
    fn standing_users_have_their_stationary_share() {
        for after_s in [0.0, 20.0] {
            let motions = walks(20_000, 1.0, after_s);
            let standing = motions.iter().filter(|motion| motion.velocity == [0.0; 2]).count();
            let share = standing as f64 / motions.len() as f64;
            assert!((share - 1.0 / 3.0).abs() < 0.012, "{share} after {after_s} s");
        }
    }

    #[test]
    fn a_user_keeps_its_speed_through_a_reflection() {
        let waypoints = Waypoints { floor: FLOOR, speeds: Speeds::new(1.0, 1.0).unwrap(), pause_mean_s: 0.0 };
        let mut walk =
            RandomDirection::new(&Settings { travel_time_mean_s: 1e6 }, &waypoints, stream(3, Purpose::Walk, 0));
        let start = walk.motion();
        let mut mirrored = 0;
        for _ in 0..1000 {
            let before = walk.motion();
            walk.step(0.05);
            let after = walk.motion();
            assert!(FLOOR.contains(after.at[0], after.at[1]));
            assert!((after.velocity[0].hypot(after.velocity[1]) - 1.0).abs() < 1e-12);
            // Only signs change.
            assert_eq!(after.facing.map(f64::abs), start.facing.map(f64::abs));
            mirrored += usize::from(before.facing != after.facing);
        }
        assert!(mirrored > 10, "{mirrored}");
    }
}
