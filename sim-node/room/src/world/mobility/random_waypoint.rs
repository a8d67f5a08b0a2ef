//! The random waypoint model.
//!
//! A user walks straight to a point drawn uniformly in the room, at a speed drawn uniformly for
//! that segment, and then draws the next point. With pauses the user stands at each point for an
//! exponential time, turned to a direction drawn uniformly. The walk starts in its stationary
//! regime, so it needs no warm-up. It is exact over any time step: one step may cover many
//! segments. Without pauses it uses only the four operations and square roots, so it is the same
//! on every platform, bit for bit.

use crate::random::{self, RoomRng};
use crate::world::mobility::motion::{Motion, draw_direction};
use crate::world::mobility::places::draw_point;
use crate::world::mobility::speeds::Speeds;
use crate::world::walker::Floor;

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

    /// Where the user is now.
    pub fn motion(&self) -> Motion {
        let share = if self.segment.length > 0.0 { self.segment.travelled / self.segment.length } else { 0.0 };
        // Rounding must not move the user beyond the end point and out of the room.
        let between =
            |axis: usize| self.segment.from[axis] + share.min(1.0) * (self.segment.to[axis] - self.segment.from[axis]);
        let at = [between(0), between(1)];
        match self.pause {
            Some(pause) => Motion { at, velocity: [0.0; 2], facing: pause.facing },
            None => {
                let facing = self.segment.direction();
                Motion { at, velocity: facing.map(|component| component * self.segment.speed), facing }
            }
        }
    }
}
