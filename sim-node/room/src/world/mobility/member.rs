//! One user of a crowd: its model, and its motion at two instants of the grid.

use crate::world::mobility::gauss_markov::GaussMarkov;
use crate::world::mobility::motion::{GRID_S, Motion};
use crate::world::mobility::random_direction::RandomDirection;
use crate::world::mobility::random_waypoint::RandomWaypoint;
use crate::world::mobility::seated::Seated;
use crate::world::mobility::smooth_random::SmoothRandom;
use crate::world::mobility::social_force::Pedestrian;
use crate::world::mobility::speeds::Speeds;

/// The walk of a user on whom other users do not act.
#[derive(Clone, Debug)]
pub enum Alone {
    /// Random waypoint.
    RandomWaypoint(RandomWaypoint),
    /// Random direction.
    RandomDirection(RandomDirection),
    /// Gauss-Markov.
    GaussMarkov(GaussMarkov),
    /// Smooth changes of speed and direction.
    SmoothRandom(SmoothRandom),
    /// At a fixed place.
    Seated(Seated),
}

impl Alone {
    /// Moves on by one step of the grid.
    pub fn step(&mut self) {
        match self {
            Self::RandomWaypoint(walk) => walk.step(GRID_S),
            Self::RandomDirection(walk) => walk.step(GRID_S),
            Self::GaussMarkov(walk) => walk.step(GRID_S),
            Self::SmoothRandom(walk) => walk.step(),
            Self::Seated(walk) => walk.step(GRID_S),
        }
    }

    /// Where the user is now.
    pub fn motion(&self) -> Motion {
        match self {
            Self::RandomWaypoint(walk) => walk.motion(),
            Self::RandomDirection(walk) => walk.motion(),
            Self::GaussMarkov(walk) => walk.motion(),
            Self::SmoothRandom(walk) => walk.motion(),
            Self::Seated(walk) => walk.motion(),
        }
    }

    fn set_speeds(&mut self, speeds: Speeds) {
        match self {
            Self::RandomWaypoint(walk) => walk.set_speeds(speeds),
            Self::RandomDirection(walk) => walk.set_speeds(speeds),
            Self::GaussMarkov(walk) => walk.set_speeds(speeds),
            Self::SmoothRandom(walk) => walk.set_speeds(speeds),
            Self::Seated(_) => {}
        }
    }
}

/// The walk of one user.
#[derive(Clone, Debug)]
pub enum Walk {
    /// Other users do not act on this one.
    Alone(Alone),
    /// Social force; the crowd computes its steps.
    SocialForce(Pedestrian),
}

impl Walk {
    /// New walking speeds; no effect on a seated user.
    pub fn set_speeds(&mut self, speeds: Speeds) {
        match self {
            Self::Alone(walk) => walk.set_speeds(speeds),
            Self::SocialForce(user) => user.set_speeds(speeds),
        }
    }
}

/// One user of a crowd.
#[derive(Clone, Debug)]
pub struct Member {
    /// The model.
    pub walk: Walk,
    /// The motion at the last instant of the grid.
    pub from: Motion,
    /// The motion at the next instant of the grid.
    pub to: Motion,
    /// Whether the step is not made, since it would touch another user or an obstacle.
    pub is_held: bool,
}

impl Member {
    /// A user who stays at its start until the next instant of the grid.
    pub fn new(walk: Walk, start: Motion) -> Self {
        Self { walk, from: start, to: start, is_held: false }
    }

    /// Longest way in one step in m of a user on whom other users act; `None` for others.
    pub fn reach_m(&self) -> Option<f64> {
        match &self.walk {
            Walk::SocialForce(user) => Some(user.reach_m()),
            Walk::Alone(_) => None,
        }
    }

    /// The velocity between the two instants in m/s.
    pub fn velocity(&self) -> [f64; 2] {
        [0, 1].map(|axis| (self.to.at[axis] - self.from.at[axis]) / GRID_S)
    }

    /// The motion between the two instants, at a share of the time from 0 to 1.
    ///
    /// The place is interpolated linearly, so that the velocity is the change of the place. The
    /// heading is interpolated unless it jumps by a right angle or more.
    pub fn motion_at(&self, share: f64) -> Motion {
        let between = |from: [f64; 2], to: [f64; 2]| [0, 1].map(|axis| from[axis] + share * (to[axis] - from[axis]));
        let (a, b) = (self.from.facing, self.to.facing);
        let facing = if a == b || a[0] * b[0] + a[1] * b[1] <= 0.0 {
            a
        } else {
            let facing = between(a, b);
            let length = (facing[0] * facing[0] + facing[1] * facing[1]).sqrt();
            facing.map(|component| component / length)
        };
        Motion { at: between(self.from.at, self.to.at), velocity: self.velocity(), facing }
    }
}
