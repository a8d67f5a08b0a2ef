//! The social force model: users walk to goals, and keep away from users, walls and obstacles.
//!
//! dv/dt = (v0 e - v) / tau + sum over users of w f + sum over walls and obstacles of g, with the
//! desired speed v0, the direction e of the goal, and |v| at most 1.3 v0.
//!
//! - Another user at distance r, whose next step is s: f = -grad V exp(-b / sigma), where b is the
//!   short semi-axis of the ellipse with focal points at the user and at its next step:
//!   2 b = sqrt((|r| + |r - s|)^2 - |s|^2).
//! - A wall or an obstacle at distance d: g = U / R exp(-d / R), away from its nearest point.
//! - The weight w is 1 for users within the angle of sight, and lower for others.
//!
//! Without fluctuations and attractions of the source. Goals are points drawn uniformly from the
//! free floor. With pauses a user brakes at a goal and stands there for an exponential time, turned
//! to a direction drawn uniformly; no repulsion acts on it. A goal that is not reached in a time
//! that suffices for a detour is replaced.
//!
//! Source: Helbing and Molnar, Social force model for pedestrian dynamics, Physical Review E 51,
//! 1995. The model uses the platform's exponential, cosine and logarithm.

use heliostat_scenario::SocialForce as Settings;

use crate::random::{self, RoomRng};
use crate::world::mobility::motion::{GRID_S, Motion, draw_direction};
use crate::world::mobility::places::{Places, distance_m};
use crate::world::mobility::random_waypoint::Waypoints;
use crate::world::mobility::speeds::Speeds;

/// Largest speed as a multiple of the desired speed, from the source.
const SPEED_MAX: f64 = 1.3;
/// Distance in m at which a goal is reached.
const REACHED_M: f64 = 0.5;
/// Distance of goals from walls and obstacles in m: where their repulsion equals the drive.
const GOAL_CLEARANCE_M: f64 = 0.6;
/// Time for a goal: a multiple of the time on a straight line, and a time in s.
const GOAL_TIME: (f64, f64) = (3.0, 5.0);
/// Speed in m/s below which a user does not turn to its velocity, and in a pause stands still.
const STANDING_M_S: f64 = 0.1;
/// Number of ranges from which on a repulsion counts as zero.
const RANGES_MAX: f64 = 12.0;
/// Least semi-axis in m: the force of a user who walks straight at another one stays finite.
const SEMI_AXIS_MIN_M: f64 = 1e-3;

/// The forces on all users of a room.
#[derive(Clone, Debug)]
pub struct SocialForce {
    settings: Settings,
    /// Cosine of half the angle of sight.
    sight_cos: f64,
}

impl SocialForce {
    /// The forces with these parameters.
    pub fn new(settings: &Settings) -> Self {
        let sight_cos = (0.5 * settings.sight_deg.to_radians()).cos();
        Self { settings: settings.clone(), sight_cos }
    }

    /// Acceleration in m/s2 by one other user, for a user who looks in a direction.
    fn by_user(&self, me: &Motion, look: [f64; 2], other: &Motion) -> [f64; 2] {
        let Settings { user_repulsion_m2_s2, user_range_m, anticipation_s, out_of_sight_weight, .. } = self.settings;
        let r = [0, 1].map(|axis| me.at[axis] - other.at[axis]);
        let s = other.velocity.map(|component| component * anticipation_s);
        let q = [r[0] - s[0], r[1] - s[1]];
        let (r_m, q_m) = (length(r), length(q));
        let sum_m = r_m + q_m;
        let semi_axis_m = 0.5 * (sum_m * sum_m - s[0] * s[0] - s[1] * s[1]).max(0.0).sqrt();
        if semi_axis_m > RANGES_MAX * user_range_m || r_m == 0.0 || q_m == 0.0 {
            return [0.0; 2];
        }
        // The direction of the force is that of the sum of both unit vectors.
        let (by_r, by_q) = (1.0 / r_m, 1.0 / q_m);
        let away = [0, 1].map(|axis| r[axis] * by_r + q[axis] * by_q);
        let ahead = -(look[0] * away[0] + look[1] * away[1]);
        let weight = if ahead >= self.sight_cos * length(away) { 1.0 } else { out_of_sight_weight };
        let strength = user_repulsion_m2_s2 / user_range_m * (-semi_axis_m / user_range_m).exp();
        let factor = weight * strength * sum_m / (4.0 * semi_axis_m.max(SEMI_AXIS_MIN_M));
        away.map(|component| factor * component)
    }

    /// Acceleration in m/s2 by walls and obstacles.
    fn by_room(&self, at: [f64; 2], places: &Places) -> [f64; 2] {
        let half = [0.5 * places.floor.length_x_m, 0.5 * places.floor.length_y_m];
        let mut force = [0, 1].map(|axis| self.of_wall(half[axis] + at[axis]) - self.of_wall(half[axis] - at[axis]));
        for obstacle in &places.obstacles {
            let away = [0, 1].map(|axis| at[axis] - obstacle.at[axis]);
            let axis_m = length(away);
            let strength = self.of_wall(axis_m - obstacle.radius_m);
            if strength > 0.0 && axis_m > 0.0 {
                [0, 1].into_iter().for_each(|axis| force[axis] += strength * away[axis] / axis_m);
            }
        }
        force
    }

    /// Acceleration in m/s2 by a wall at a distance in m.
    fn of_wall(&self, distance_m: f64) -> f64 {
        let Settings { wall_repulsion_m2_s2, wall_range_m, .. } = self.settings;
        let ranges = distance_m / wall_range_m;
        if ranges > RANGES_MAX { 0.0 } else { wall_repulsion_m2_s2 / wall_range_m * (-ranges).exp() }
    }
}

fn length(vector: [f64; 2]) -> f64 {
    (vector[0] * vector[0] + vector[1] * vector[1]).sqrt()
}

/// A user who stands at a goal.
#[derive(Clone, Copy, Debug)]
struct Pause {
    left_s: f64,
    facing: [f64; 2],
}

/// One user who walks to goals.
#[derive(Clone, Debug)]
pub struct Pedestrian {
    pause_mean_s: f64,
    /// The desired speed in m/s before the bounds of the room apply.
    drawn_speed_m_s: f64,
    desired_speed_m_s: f64,
    goal: [f64; 2],
    /// Time until the goal is replaced in s.
    left_s: f64,
    pause: Option<Pause>,
    rng: RoomRng,
}

impl Pedestrian {
    /// A user at a place, on the way to a goal; the generator belongs to this user.
    pub fn new(settings: &Settings, waypoints: &Waypoints, places: &Places, mut rng: RoomRng) -> Self {
        let drawn_speed_m_s = settings.desired_speed_m_s + settings.desired_speed_std_m_s * random::normal(&mut rng);
        let mut user = Self {
            pause_mean_s: waypoints.pause_mean_s,
            drawn_speed_m_s,
            desired_speed_m_s: 0.0,
            goal: places.draw(&mut rng, GOAL_CLEARANCE_M, std::iter::empty(), 0.0),
            left_s: GOAL_TIME.1,
            pause: None,
            rng,
        };
        user.set_speeds(waypoints.speeds);
        user
    }

    /// The motion at the start at a place: towards the goal at the desired speed.
    pub fn start(&self, at: [f64; 2]) -> Motion {
        let facing = direction(at, self.goal).unwrap_or([1.0, 0.0]);
        Motion { at, velocity: facing.map(|component| component * self.desired_speed_m_s), facing }
    }

    /// New bounds of the desired speed.
    pub fn set_speeds(&mut self, speeds: Speeds) {
        let [min, max] = speeds.bounds_m_s();
        self.desired_speed_m_s = self.drawn_speed_m_s.clamp(min, max);
    }

    /// Longest way in one step of the grid in m; 0 for a user who may not walk.
    pub fn reach_m(&self) -> f64 {
        SPEED_MAX * self.desired_speed_m_s * GRID_S
    }

    /// The motion after one step of the grid, before users are kept apart.
    pub fn step<'a>(
        &mut self,
        forces: &SocialForce,
        me: &Motion,
        others: impl Iterator<Item = &'a Motion>,
        places: &Places,
    ) -> Motion {
        if self.desired_speed_m_s == 0.0 {
            return Motion::standing(me.at, me.facing);
        }
        self.choose_goal(me.at, places);
        let force = match self.pause {
            Some(_) => [0.0; 2],
            None => self.repulsion(forces, me, others, places),
        };
        let desired = self.desired_velocity(me);
        let relaxation_s = forces.settings.relaxation_s;
        let velocity = [0, 1].map(|axis| {
            let drive = (desired[axis] - me.velocity[axis]) / relaxation_s;
            me.velocity[axis] + (drive + force[axis]) * GRID_S
        });
        self.moved(me, velocity)
    }

    fn desired_velocity(&self, me: &Motion) -> [f64; 2] {
        let speed_m_s = if self.pause.is_some() { 0.0 } else { self.desired_speed_m_s };
        direction(me.at, self.goal).unwrap_or(me.facing).map(|component| component * speed_m_s)
    }

    fn repulsion<'a>(
        &self,
        forces: &SocialForce,
        me: &Motion,
        others: impl Iterator<Item = &'a Motion>,
        places: &Places,
    ) -> [f64; 2] {
        let look = direction(me.at, self.goal).unwrap_or(me.facing);
        others.fold(forces.by_room(me.at, places), |[x, y], other| {
            let [by_x, by_y] = forces.by_user(me, look, other);
            [x + by_x, y + by_y]
        })
    }

    fn moved(&self, me: &Motion, velocity: [f64; 2]) -> Motion {
        let speed_m_s = length(velocity);
        if speed_m_s < STANDING_M_S {
            return match self.pause {
                Some(pause) => Motion::standing(me.at, pause.facing),
                None => me.moved_by(velocity, me.facing, GRID_S),
            };
        }
        let scale = (SPEED_MAX * self.desired_speed_m_s / speed_m_s).min(1.0);
        let facing = velocity.map(|component| component / speed_m_s);
        me.moved_by(velocity.map(|component| component * scale), facing, GRID_S)
    }

    /// Ends a pause, or begins one at the goal; without pauses draws the next goal there.
    fn choose_goal(&mut self, at: [f64; 2], places: &Places) {
        if let Some(pause) = &mut self.pause {
            pause.left_s -= GRID_S;
            if pause.left_s > 0.0 {
                return;
            }
        } else {
            self.left_s -= GRID_S;
            let is_reached = distance_m(at, self.goal) < REACHED_M;
            if !is_reached && self.left_s > 0.0 {
                return;
            }
            if is_reached && self.pause_mean_s > 0.0 {
                let left_s = random::exponential(&mut self.rng, self.pause_mean_s);
                self.pause = Some(Pause { left_s, facing: draw_direction(&mut self.rng) });
                return;
            }
        }
        self.pause = None;
        self.goal = places.draw(&mut self.rng, GOAL_CLEARANCE_M, std::iter::empty(), 0.0);
        self.left_s = GOAL_TIME.0 * distance_m(at, self.goal) / self.desired_speed_m_s + GOAL_TIME.1;
    }
}

/// The unit vector from one place to another; `None` where they are the same.
fn direction(from: [f64; 2], to: [f64; 2]) -> Option<[f64; 2]> {
    let way = [to[0] - from[0], to[1] - from[1]];
    let length_m = length(way);
    (length_m > 0.0).then(|| way.map(|component| component / length_m))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::walker::Floor;

    fn forces() -> SocialForce {
        SocialForce::new(&Settings::default())
    }

    fn potential(me: [f64; 2], other: &Motion) -> f64 {
        let r = [me[0] - other.at[0], me[1] - other.at[1]];
        let s = other.velocity.map(|component| 2.0 * component);
        let sum = length(r) + length([r[0] - s[0], r[1] - s[1]]);
        2.1 * (-0.5 * (sum * sum - s[0] * s[0] - s[1] * s[1]).sqrt() / 0.3).exp()
    }

    #[test]
    fn the_repulsion_by_a_user_is_the_gradient_of_the_elliptical_potential() {
        let other = Motion { at: [0.2, -0.1], velocity: [0.7, 0.4], facing: [1.0, 0.0] };
        for at in [[1.0, 0.9], [0.4, 0.8], [-0.3, 0.2]] {
            let me = Motion::standing(at, [1.0, 0.0]);
            // Looking against the force: the other user is in sight.
            let step = 1e-6;
            let slope = |axis: usize| {
                let shifted = |by: f64| [0, 1].map(|other| if other == axis { at[other] + by } else { at[other] });
                -(potential(shifted(step), &other) - potential(shifted(-step), &other)) / (2.0 * step)
            };
            let expected = [slope(0), slope(1)];
            let look = expected.map(|component| -component / length(expected));
            let found = forces().by_user(&me, look, &other);
            assert!(length([found[0] - expected[0], found[1] - expected[1]]) < 1e-6, "{found:?} for {expected:?}");
            // Out of sight it counts half.
            let behind = forces().by_user(&me, look.map(|component| -component), &other);
            assert!(length([2.0 * behind[0] - found[0], 2.0 * behind[1] - found[1]]) < 1e-12, "{behind:?}");
        }
    }

    #[test]
    fn walls_and_obstacles_repel_exponentially() {
        let obstacle = heliostat_channel::Cylinder { x_m: 0.0, y_m: 0.0, radius_m: 0.25, height_m: 1.0 };
        let places = Places::new(Floor { length_x_m: 40.0, length_y_m: 40.0 }, &[obstacle]);
        let near_wall = forces().by_room([19.6, 5.0], &places);
        assert!((near_wall[0] + 50.0 * (-2.0_f64).exp()).abs() < 1e-9 && near_wall[1] == 0.0, "{near_wall:?}");
        let near_obstacle = forces().by_room([0.0, -0.65], &places);
        assert!((near_obstacle[1] + 50.0 * (-2.0_f64).exp()).abs() < 1e-9, "{near_obstacle:?}");
        assert_eq!(forces().by_room([10.0, 5.0], &places), [0.0; 2]);
    }
}
