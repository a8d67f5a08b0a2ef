//! The smooth random mobility model: speed and direction change smoothly.
//!
//! At exponential times a user draws a target speed, uniform between the walking speeds, and an
//! acceleration, uniform up to the largest one. The speed changes at this acceleration until it has
//! the target. At other exponential times the user draws a target direction and a turn rate, both
//! uniform, and turns at this rate.
//!
//! In the source, users leave the area or bounce. Here a user turns towards a point drawn uniformly
//! when a wall is near: nearer than the distance to brake plus the turning radius. The user brakes
//! early enough that the point at which it would stop is always on the floor. Near a wall its speed
//! can therefore be below the smallest walking speed. Obstacles have no effect.
//!
//! The walk starts at rest at a place drawn uniformly and is then run for 30 s.
//!
//! Source: Bettstetter, Smooth is better than sharp: a random mobility model for simulation of
//! wireless networks, ACM MSWiM 2001. Its values are for vehicles; the defaults are chosen for
//! users who walk. The model uses the platform's sine, cosine, arctangent and logarithm.

use heliostat_scenario::SmoothRandom as Settings;

use crate::random::{self, RoomRng};
use crate::world::mobility::motion::{GRID_S, Motion, draw_direction, turned};
use crate::world::mobility::places::draw_point;
use crate::world::mobility::random_waypoint::Waypoints;
use crate::world::mobility::speeds::Speeds;
use crate::world::walker::Floor;

/// Time from the start at rest until the walk is used, in s.
const RUN_IN_S: f64 = 30.0;

/// A target, how fast it is approached, and when the next one is drawn.
#[derive(Clone, Copy, Debug)]
struct Target<T> {
    value: T,
    /// Share of the largest acceleration, deceleration or turn rate.
    share: f64,
    left_s: f64,
}

impl<T> Target<T> {
    fn draw(value: T, mean_s: f64, rng: &mut RoomRng) -> Self {
        let share = 1.0 - random::uniform(rng);
        Self { value, share, left_s: random::exponential(rng, mean_s) }
    }
}

/// Speed and direction of a user.
#[derive(Clone, Copy, Debug)]
struct Course {
    speed_m_s: f64,
    direction: [f64; 2],
}

/// The smooth walk of one user.
#[derive(Clone, Debug)]
pub struct SmoothRandom {
    floor: Floor,
    speeds: Speeds,
    settings: Settings,
    /// Largest turn rate in rad/s.
    turn_rate: f64,
    at: [f64; 2],
    course: Course,
    target_speed: Target<f64>,
    target_direction: Target<[f64; 2]>,
    /// Whether the target direction leads away from a wall.
    is_avoiding: bool,
    rng: RoomRng,
}

impl SmoothRandom {
    /// A walk after its run-in; the generator belongs to this user.
    pub fn new(settings: &Settings, waypoints: &Waypoints, mut rng: RoomRng) -> Self {
        let Waypoints { floor, speeds, .. } = *waypoints;
        let direction = draw_direction(&mut rng);
        let mut walk = Self {
            floor,
            speeds,
            settings: settings.clone(),
            turn_rate: settings.turn_rate_deg_per_s.to_radians(),
            at: draw_point(&floor, &mut rng),
            course: Course { speed_m_s: 0.0, direction },
            target_speed: Target { value: 0.0, share: 1.0, left_s: 0.0 },
            target_direction: Target { value: direction, share: 1.0, left_s: 0.0 },
            is_avoiding: false,
            rng,
        };
        for _ in 0..(RUN_IN_S / GRID_S) as usize {
            walk.step();
        }
        walk
    }

    /// Walks on for one step of the grid.
    pub fn step(&mut self) {
        if self.speeds.are_zero() {
            return;
        }
        self.draw_targets();
        let course = self.next_course();
        let half = [0.5 * self.floor.length_x_m, 0.5 * self.floor.length_y_m];
        for axis in [0, 1] {
            let at = self.at[axis] + course.direction[axis] * course.speed_m_s * GRID_S;
            // Rounding must not move the user out of the room.
            self.at[axis] = at.clamp(-half[axis], half[axis]);
        }
        self.course = course;
    }

    /// Where the user is now.
    pub fn motion(&self) -> Motion {
        let Course { speed_m_s, direction } = self.course;
        Motion { at: self.at, velocity: direction.map(|component| component * speed_m_s), facing: direction }
    }

    /// New speeds from now on; the user accelerates to one of them.
    pub fn set_speeds(&mut self, speeds: Speeds) {
        self.speeds = speeds;
        self.target_speed.left_s = 0.0;
        if speeds.are_zero() {
            self.course.speed_m_s = 0.0;
        }
    }

    fn draw_targets(&mut self) {
        self.target_speed.left_s -= GRID_S;
        if self.target_speed.left_s <= 0.0 {
            let value = self.speeds.draw(&mut self.rng);
            self.target_speed = Target::draw(value, self.settings.speed_change_mean_s, &mut self.rng);
        }
        self.target_direction.left_s -= GRID_S;
        if self.target_direction.left_s <= 0.0 && !self.is_avoiding {
            let value = draw_direction(&mut self.rng);
            self.target_direction = Target::draw(value, self.settings.direction_change_mean_s, &mut self.rng);
        }
    }

    /// The speed after one step towards the target speed.
    fn next_speed_m_s(&self) -> f64 {
        let speed_m_s = self.course.speed_m_s;
        let Target { value, share, .. } = self.target_speed;
        if value < speed_m_s {
            return (speed_m_s - share * self.settings.deceleration_m_s2 * GRID_S).max(value);
        }
        // A user who had to stop at a wall starts again without delay.
        let share = if speed_m_s < self.speeds.bounds_m_s()[0] { 1.0 } else { share };
        (speed_m_s + share * self.settings.acceleration_m_s2 * GRID_S).min(value)
    }

    /// The course towards the targets, or one that stops on the floor.
    fn next_course(&mut self) -> Course {
        let Course { speed_m_s, direction } = self.course;
        let most = self.target_direction.share * self.turn_rate * GRID_S;
        let turn = turned(direction, self.target_direction.value, most);
        let planned = Course { speed_m_s: self.next_speed_m_s(), direction: turn };
        let sees_wall = !self.has_floor_ahead(&planned, planned.speed_m_s / self.turn_rate);
        if sees_wall && (!self.is_avoiding || direction == self.target_direction.value) {
            self.turn_into_room();
        }
        self.is_avoiding = sees_wall;
        if self.has_floor_ahead(&planned, 0.0) {
            return planned;
        }
        let braked = (speed_m_s - self.settings.deceleration_m_s2 * GRID_S).max(0.0);
        let turning = Course { speed_m_s: braked, direction: turn };
        // Straight on, the user stops where it would have stopped before.
        if self.has_floor_ahead(&turning, 0.0) { turning } else { Course { speed_m_s: braked, direction } }
    }

    fn turn_into_room(&mut self) {
        let goal = draw_point(&self.floor, &mut self.rng);
        let [x, y] = [goal[0] - self.at[0], goal[1] - self.at[1]];
        let length_m = x.hypot(y);
        if length_m > 0.0 {
            self.target_direction.value = [x / length_m, y / length_m];
            self.target_direction.share = 1.0;
        }
    }

    /// Whether the user, after one step on a course, can brake on the floor, and has `more_m` to
    /// the next wall then.
    fn has_floor_ahead(&self, course: &Course, more_m: f64) -> bool {
        let braking_m = course.speed_m_s * course.speed_m_s / (2.0 * self.settings.deceleration_m_s2);
        let length_m = course.speed_m_s * GRID_S + braking_m + more_m;
        let [x, y] = [0, 1].map(|axis| self.at[axis] + course.direction[axis] * length_m);
        self.floor.contains(x, y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, stream};

    const FLOOR: Floor = Floor { length_x_m: 6.0, length_y_m: 4.0 };

    fn walk(user: u32) -> SmoothRandom {
        let waypoints = Waypoints { floor: FLOOR, speeds: Speeds::new(0.3, 1.8).unwrap(), pause_mean_s: 0.0 };
        SmoothRandom::new(&Settings::default(), &waypoints, stream(4, Purpose::Walk, user))
    }

    fn speed_m_s(motion: &Motion) -> f64 {
        motion.velocity[0].hypot(motion.velocity[1])
    }

    #[test]
    fn acceleration_and_turn_rate_are_bounded_also_at_walls() {
        let (mut at_wall, mut turning) = (0, 0);
        for user in 0..10 {
            let mut walk = walk(user);
            for _ in 0..10_000 {
                let before = walk.motion();
                walk.step();
                let after = walk.motion();
                assert!(FLOOR.contains(after.at[0], after.at[1]), "{after:?}");
                let change = (speed_m_s(&after) - speed_m_s(&before)) / GRID_S;
                assert!((-1.5 - 1e-9..=1.0 + 1e-9).contains(&change), "{change} m/s2");
                let cross = before.facing[0] * after.facing[1] - before.facing[1] * after.facing[0];
                let dot = before.facing[0] * after.facing[0] + before.facing[1] * after.facing[1];
                let rate = cross.atan2(dot).abs() / GRID_S;
                assert!(rate <= 90_f64.to_radians() + 1e-9, "{rate} rad/s");
                turning += usize::from(rate > 0.01);
                at_wall += usize::from(after.at[0].abs() > 2.7 || after.at[1].abs() > 1.7);
            }
        }
        assert!(turning > 20_000 && at_wall > 5_000, "turning {turning}, at a wall {at_wall}");
    }

    #[test]
    fn users_reach_their_target_speeds_and_do_not_stay_at_walls() {
        let (mut sum, mut still, steps, users) = (0.0, 0, 5_000, 40);
        for user in 0..users {
            let mut walk = walk(user);
            for _ in 0..steps {
                walk.step();
                sum += speed_m_s(&walk.motion());
                still += usize::from(speed_m_s(&walk.motion()) < 0.05);
            }
        }
        let all = f64::from(steps * users);
        // Target speeds have the mean 1.05 m/s; users brake at the walls of this room.
        assert!((0.5..1.05).contains(&(sum / all)), "{}", sum / all);
        assert!((still as f64) < 0.1 * all, "{still} of {all}");
    }

    #[test]
    fn users_who_may_not_walk_stand_still() {
        let mut walk = walk(3);
        walk.set_speeds(Speeds::new(0.0, 0.0).unwrap());
        let before = walk.motion();
        walk.step();
        assert_eq!((before, before.velocity), (walk.motion(), [0.0; 2]));
        walk.set_speeds(Speeds::new(1.0, 1.0).unwrap());
        walk.step();
        assert_ne!(before, walk.motion());
    }
}
