//! How the users move: the random waypoint model, or a recorded walk in its place.
//!
//! A user walks straight to a point drawn uniformly in the room, at a speed drawn uniformly for
//! that segment, and then draws the next point. With pauses the user stands at each point for an
//! exponential time, turned to a direction drawn uniformly. The walk starts in its stationary
//! regime, so it needs no warm-up. It is exact over any time step: one step may cover many
//! segments. Without pauses it uses only the four operations and square roots, so it is the same
//! on every platform, bit for bit.

use thiserror::Error;

use crate::random::{self, Purpose, RoomRng};
use crate::world::trace::Trace;
use crate::world::walker::{Floor, Walker};

/// Why a walk cannot be made.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum MobilityError {
    /// At zero speed a segment never ends: the minimum must be positive, or both speeds zero.
    #[error(
        "invalid speeds {min} to {max} m/s: expected a minimum above 0 and at most the maximum, \
         or both 0 for users who stand still"
    )]
    Speed {
        /// Minimum speed in m/s.
        min: f64,
        /// Maximum speed in m/s.
        max: f64,
    },
}

/// The speeds of the segments, uniform between two bounds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Speeds {
    min: f64,
    max: f64,
}

impl Speeds {
    /// Speeds from `min` to `max` in m/s; with both 0 all users stand still.
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

    /// Minimum and maximum in m/s.
    pub fn bounds_m_s(&self) -> [f64; 2] {
        [self.min, self.max]
    }

    fn draw(&self, rng: &mut RoomRng) -> f64 {
        random::uniform_in(rng, self.min, self.max)
    }

    /// The speed of the segment that is under way at a random time.
    ///
    /// A segment lasts in proportion to 1/v, so the density is uniform times 1/v.
    fn draw_under_way(&self, rng: &mut RoomRng) -> f64 {
        loop {
            let speed = self.draw(rng);
            if random::uniform(rng) * speed <= self.min {
                return speed;
            }
        }
    }
}

/// A straight segment of the walk.
#[derive(Clone, Copy, Debug)]
struct Segment {
    from: [f64; 2],
    to: [f64; 2],
    length: f64,
    travelled: f64,
    speed: f64,
}

impl Segment {
    fn new(from: [f64; 2], to: [f64; 2], speed: f64) -> Self {
        let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
        Self { from, to, length: (dx * dx + dy * dy).sqrt(), travelled: 0.0, speed }
    }

    /// The segment under way at a random time: its probability is proportional to its length, and
    /// the position on it is uniform.
    fn under_way(floor: &Floor, speeds: &Speeds, rng: &mut RoomRng) -> Self {
        let longest = diagonal_m(floor);
        loop {
            let mut segment = Self::new(draw_point(floor, rng), draw_point(floor, rng), 0.0);
            if random::uniform(rng) * longest < segment.length {
                segment.travelled = random::uniform(rng) * segment.length;
                segment.speed = speeds.draw_under_way(rng);
                return segment;
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

/// A point drawn uniformly on the floor.
fn draw_point(floor: &Floor, rng: &mut RoomRng) -> [f64; 2] {
    [0.5 * floor.length_x_m, 0.5 * floor.length_y_m].map(|half| random::uniform_in(rng, -half, half))
}

/// The longest straight line on the floor, in m.
fn diagonal_m(floor: &Floor) -> f64 {
    (floor.length_x_m * floor.length_x_m + floor.length_y_m * floor.length_y_m).sqrt()
}

/// Where, how fast and with which pauses users walk.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Waypoints {
    /// The points lie on this floor.
    pub floor: Floor,
    /// Speeds of the segments.
    pub speeds: Speeds,
    /// Mean duration of a pause in s; 0: no pauses.
    pub pause_mean_s: f64,
}

impl Waypoints {
    /// Mean duration of a segment in s: mean distance of two points times the mean of 1/speed.
    fn segment_mean_s(&self) -> f64 {
        let [min, max] = self.speeds.bounds_m_s();
        let slowness = if max > min { (max / min).ln() / (max - min) } else { 1.0 / max };
        mean_distance_m(self.floor.length_x_m, self.floor.length_y_m) * slowness
    }

    fn draw_pause(&self, rng: &mut RoomRng) -> Option<Pause> {
        (self.pause_mean_s > 0.0).then(|| {
            let left_s = random::exponential(rng, self.pause_mean_s);
            Pause { left_s, facing: draw_direction(rng) }
        })
    }
}

/// Mean distance of two points drawn uniformly in a rectangle.
///
/// Source: Mathai, An Introduction to Geometrical Probability, 1999, section 2.4. Units: those of
/// the sides.
fn mean_distance_m(a: f64, b: f64) -> f64 {
    let d = a.hypot(b);
    let (a_b, b_a) = (a / b, b / a);
    let cubes = a * a_b * a_b + b * b_a * b_a + d * (3.0 - a_b * a_b - b_a * b_a);
    let logarithms = b * b_a * ((a + d) / b).ln() + a * a_b * ((b + d) / a).ln();
    (cubes + 2.5 * logarithms) / 15.0
}

/// A direction drawn uniformly, as a unit vector.
fn draw_direction(rng: &mut RoomRng) -> [f64; 2] {
    loop {
        let [x, y] = [0; 2].map(|_| random::uniform_in(rng, -1.0, 1.0));
        let length = (x * x + y * y).sqrt();
        if length > 0.01 && length < 1.0 {
            return [x / length, y / length];
        }
    }
}

/// A user who stands.
#[derive(Clone, Copy, Debug)]
struct Pause {
    left_s: f64,
    facing: [f64; 2],
}

/// The random waypoint walk of one user.
#[derive(Clone, Debug)]
pub struct RandomWaypoint {
    waypoints: Waypoints,
    segment: Segment,
    /// The pause at the start of the segment, while it lasts.
    pause: Option<Pause>,
    rng: RoomRng,
}

impl RandomWaypoint {
    /// A walk in its stationary regime; the generator belongs to this user.
    pub fn new(waypoints: Waypoints, mut rng: RoomRng) -> Self {
        let mut segment = Segment::under_way(&waypoints.floor, &waypoints.speeds, &mut rng);
        let mut pause = waypoints.draw_pause(&mut rng).filter(|_| segment.speed > 0.0);
        if pause.is_some() {
            let cycle_s = waypoints.pause_mean_s + waypoints.segment_mean_s();
            if random::uniform(&mut rng) * cycle_s < waypoints.pause_mean_s {
                // The rest of an exponential time has the same distribution; the next segment is
                // an ordinary one.
                let [from, to] = [0; 2].map(|_| draw_point(&waypoints.floor, &mut rng));
                segment = Segment::new(from, to, waypoints.speeds.draw(&mut rng));
            } else {
                pause = None;
            }
        }
        Self { waypoints, segment, pause, rng }
    }

    /// Walks on for `dt_s` seconds, over as many segments as that takes.
    pub fn step(&mut self, dt_s: f64) {
        if self.segment.speed == 0.0 {
            return;
        }
        let mut left = dt_s;
        loop {
            if let Some(pause) = &mut self.pause {
                if left < pause.left_s {
                    pause.left_s -= left;
                    return;
                }
                left -= pause.left_s;
                self.pause = None;
            }
            let until_arrival = (self.segment.length - self.segment.travelled) / self.segment.speed;
            if left < until_arrival {
                self.segment.travelled += self.segment.speed * left;
                return;
            }
            left -= until_arrival;
            let next = draw_point(&self.waypoints.floor, &mut self.rng);
            self.segment = Segment::new(self.segment.to, next, self.waypoints.speeds.draw(&mut self.rng));
            self.pause = self.waypoints.draw_pause(&mut self.rng);
        }
    }

    /// New speeds from now on; the segment under way gets a new one too.
    pub fn set_speeds(&mut self, speeds: Speeds) {
        self.waypoints.speeds = speeds;
        self.segment.speed = speeds.draw(&mut self.rng);
    }

    fn write(&self, walker: &mut Walker) {
        let share = if self.segment.length > 0.0 { self.segment.travelled / self.segment.length } else { 0.0 };
        // Rounding must not move the user beyond the end point and out of the room.
        let between =
            |axis: usize| self.segment.from[axis] + share.min(1.0) * (self.segment.to[axis] - self.segment.from[axis]);
        walker.position.x = between(0);
        walker.position.y = between(1);
        (walker.direction, walker.velocity) = match self.pause {
            Some(pause) => (pause.facing, [0.0; 2]),
            None => {
                let direction = self.segment.direction();
                (direction, direction.map(|component| component * self.segment.speed))
            }
        };
    }
}

/// What moves the users.
#[derive(Clone, Debug)]
pub enum Mobility {
    /// Each user walks at random.
    RandomWaypoint(Vec<RandomWaypoint>),
    /// A recorded walk is played.
    Trace(Trace),
}

impl Mobility {
    /// Random walks for `users` users, each with its own random stream.
    ///
    /// One more user does not change the walks of the others.
    pub fn random_waypoint(waypoints: Waypoints, users: usize, seed: u64) -> Self {
        let walks = (0..users)
            .map(|user| RandomWaypoint::new(waypoints, random::stream(seed, Purpose::Walk, user as u32)))
            .collect();
        Self::RandomWaypoint(walks)
    }

    /// A user who has walked for `walked_s` seconds enters after the others, with the walk of its
    /// number; no effect on a recorded walk.
    pub fn enter(&mut self, mut walk: RandomWaypoint, walked_s: f64) {
        if let Self::RandomWaypoint(walks) = self {
            walk.step(walked_s);
            walks.push(walk);
        }
    }

    /// The user at this index leaves; no effect on a recorded walk.
    pub fn leave(&mut self, index: usize) {
        if let Self::RandomWaypoint(walks) = self {
            walks.remove(index);
        }
    }

    /// Makes room for this number of users in all.
    pub fn reserve(&mut self, users: usize) {
        if let Self::RandomWaypoint(walks) = self {
            walks.reserve(users.saturating_sub(walks.len()));
        }
    }

    /// Moves on by `dt_s` seconds.
    pub fn step(&mut self, dt_s: f64) {
        match self {
            Self::RandomWaypoint(walks) => walks.iter_mut().for_each(|walk| walk.step(dt_s)),
            Self::Trace(trace) => trace.step(dt_s),
        }
    }

    /// Writes the users' positions, headings and velocities; heights do not change.
    pub fn write(&self, walkers: &mut [Walker]) {
        match self {
            Self::RandomWaypoint(walks) => {
                walks.iter().zip(walkers).for_each(|(walk, walker)| walk.write(walker));
            }
            Self::Trace(trace) => trace.write(walkers),
        }
    }

    /// New walking speeds; a recorded walk keeps its own.
    pub fn set_speeds(&mut self, speeds: Speeds) {
        if let Self::RandomWaypoint(walks) = self {
            walks.iter_mut().for_each(|walk| walk.set_speeds(speeds));
        }
    }
}

#[cfg(test)]
mod tests {
    use heliostat_channel::Vec3;

    use super::*;

    const FLOOR: Floor = Floor { length_x_m: 5.0, length_y_m: 5.0 };

    fn waypoints(min_m_s: f64, max_m_s: f64, pause_mean_s: f64) -> Waypoints {
        Waypoints { floor: FLOOR, speeds: Speeds::new(min_m_s, max_m_s).unwrap(), pause_mean_s }
    }

    fn walkers(count: usize) -> Vec<Walker> {
        vec![Walker { position: Vec3::zeros(), direction: [1.0, 0.0], velocity: [0.0, 0.0] }; count]
    }

    fn sample(seed: u64, users: usize, after_s: f64) -> Vec<Walker> {
        let mut mobility = Mobility::random_waypoint(waypoints(0.1, 2.0, 0.0), users, seed);
        mobility.step(after_s);
        let mut out = walkers(users);
        mobility.write(&mut out);
        out
    }

    /// Variance of x and the largest gap between its distribution and that of equation (4), F(x) =
    /// 1/2 + 3x/(2L) - 2x^3/L^3.
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
    fn the_stationary_distribution_is_near_equation_4_from_the_start() {
        for after_s in [0.0, 40.0] {
            let xs = sample(3, 60_000, after_s).iter().map(|walker| walker.position.x).collect();
            let (variance, gap) = against_equation_4(xs);
            assert!((variance - 1.34).abs() < 0.025, "variance {variance} after {after_s} s; equation (4) gives 1.25");
            assert!(gap < 0.03, "largest gap {gap} after {after_s} s");
        }
    }

    #[test]
    fn mean_speed_is_the_stationary_one() {
        // Uniform in [a, b] per segment is log-uniform in time: mean (b - a) / ln(b / a).
        let expected = 1.9 / 20.0_f64.ln();
        for after_s in [0.0, 40.0] {
            let out = sample(4, 40_000, after_s);
            let mean = out.iter().map(|w| w.velocity[0].hypot(w.velocity[1])).sum::<f64>() / out.len() as f64;
            assert!((mean - expected).abs() < 0.01, "{mean} for {expected} after {after_s} s");
        }
    }

    #[test]
    fn one_long_step_equals_many_short_ones() {
        let long = sample(5, 20, 60.0);
        let mut mobility = Mobility::random_waypoint(waypoints(0.1, 2.0, 0.0), 20, 5);
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
    fn users_stay_in_the_room_and_move_with_their_velocity() {
        let mut mobility = Mobility::random_waypoint(waypoints(0.1, 2.0, 0.0), 10, 6);
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
    fn standing_users_have_their_stationary_share_and_face_any_way() {
        // Side 5 m: mean distance 2.607 m; the mean of 1/v over [0.5, 1.5] is ln 3.
        let pause_mean_s = 2.607 * 3.0_f64.ln();
        for after_s in [0.0, 30.0] {
            let mut mobility = Mobility::random_waypoint(waypoints(0.5, 1.5, pause_mean_s), 20_000, 9);
            let mut out = walkers(20_000);
            mobility.step(after_s);
            mobility.write(&mut out);
            let standing: Vec<&Walker> = out.iter().filter(|walker| walker.velocity == [0.0; 2]).collect();
            let share = standing.len() as f64 / out.len() as f64;
            assert!((share - 0.5).abs() < 0.015, "{share} after {after_s} s");
            for axis in [0, 1] {
                let mean = standing.iter().map(|walker| walker.direction[axis]).sum::<f64>() / standing.len() as f64;
                assert!(mean.abs() < 0.03, "{mean}");
            }
            // Users who stand at points drawn uniformly are spread uniformly: variance L^2 / 12.
            let variance = standing.iter().map(|walker| walker.position.x.powi(2)).sum::<f64>() / standing.len() as f64;
            assert!((variance - 25.0 / 12.0).abs() < 0.06, "{variance} after {after_s} s");
        }
    }

    #[test]
    fn a_user_keeps_place_and_direction_during_a_pause() {
        let mut mobility = Mobility::random_waypoint(waypoints(0.5, 1.5, 1.0), 10, 10);
        let (mut before, mut after, mut kept) = (walkers(10), walkers(10), 0);
        for _ in 0..1000 {
            mobility.write(&mut before);
            mobility.step(0.05);
            mobility.write(&mut after);
            for (a, b) in before.iter().zip(&after).filter(|(a, b)| a.velocity == b.velocity && a.velocity == [0.0; 2])
            {
                // A whole segment fits into a step only where two points almost coincide.
                kept += usize::from(a == b);
            }
        }
        assert!(kept > 500, "{kept}");
    }

    #[test]
    fn one_more_user_does_not_change_the_walks_of_the_others() {
        assert_eq!(sample(7, 3, 10.0), sample(7, 4, 10.0)[..3]);
    }

    #[test]
    fn invalid_speeds_are_refused_and_zero_means_standing() {
        for (min, max) in [(0.0, 1.0), (-1.0, 1.0), (2.0, 1.0), (0.1, f64::INFINITY), (f64::NAN, 1.0)] {
            assert!(Speeds::new(min, max).is_err(), "{min} {max}");
        }
        let mut mobility = Mobility::random_waypoint(waypoints(0.0, 0.0, 0.0), 5, 8);
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
