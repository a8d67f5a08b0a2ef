//! How the users move: a model of `users.mobility`, or a recorded walk in its place.
//!
//! The default, the random waypoint model without a lag of the heading, is exact over any time step
//! ([`random_waypoint`]). All other models are computed on a grid of instants ([`crowd`]).
//!
//! - [`random_waypoint`], [`random_direction`], [`gauss_markov`], [`smooth_random`],
//!   [`social_force`], [`seated`]: the models, one user each.
//! - [`crowd`], [`member`], [`separation`]: all users on the grid, and users who keep apart.
//! - [`motion`], [`places`], [`speeds`]: what the models share.

use heliostat_channel::Cylinder;
use heliostat_scenario::{MobilityModel, Scenario};

use crate::random::{self, Purpose};
use crate::world::trace::Trace;
use crate::world::walker::Walker;

pub use self::random_waypoint::{RandomWaypoint, Waypoints};
pub use self::speeds::{MobilityError, Speeds};

use self::crowd::Crowd;

pub mod crowd;
pub mod gauss_markov;
pub mod member;
pub mod motion;
pub mod places;
pub mod random_direction;
pub mod random_waypoint;
pub mod seated;
pub mod separation;
pub mod smooth_random;
pub mod social_force;
pub mod speeds;

/// What moves the users.
#[derive(Clone, Debug)]
pub enum Mobility {
    /// Each user walks by the random waypoint model.
    RandomWaypoint {
        /// Floor, speeds and pauses of users who enter.
        waypoints: Waypoints,
        /// The users.
        walks: Vec<RandomWaypoint>,
        /// The seed of the walks.
        seed: u64,
    },
    /// The users move by any models, on a grid of instants.
    Crowd(Box<Crowd>),
    /// A recorded walk is played.
    Trace(Trace),
}

impl Mobility {
    /// The models of a scenario, without users.
    pub fn new(scenario: &Scenario, waypoints: Waypoints) -> Self {
        let users = &scenario.users;
        if users.mobility == MobilityModel::RandomWaypoint && users.heading_lag_s == 0.0 {
            Self::RandomWaypoint { waypoints, walks: Vec::new(), seed: 0 }
        } else {
            Self::Crowd(Box::new(Crowd::new(scenario, waypoints)))
        }
    }

    /// Begins at time 0 with the users 0 to `users` - 1, each with its own random stream.
    ///
    /// Without social forces one more user does not change the walks of the others. A recorded walk
    /// continues.
    pub fn begin(&mut self, users: usize, seed: u64, obstacles: &[Cylinder]) {
        match self {
            Self::RandomWaypoint { waypoints, walks, seed: old } => {
                *old = seed;
                walks.clear();
                walks.extend((0..users as u32).map(|id| walk_of(*waypoints, seed, id)));
            }
            Self::Crowd(crowd) => crowd.begin(users, seed, obstacles),
            Self::Trace(_) => {}
        }
    }

    /// A user who has walked for `walked_s` seconds enters after the others, with the walk of its
    /// number; no effect on a recorded walk.
    ///
    /// In a crowd the user begins to walk now, since its steps depend on those of the others: the
    /// caller first moves on to the time at which the user enters.
    pub fn enter(&mut self, id: u32, walked_s: f64) {
        match self {
            Self::RandomWaypoint { waypoints, walks, seed } => {
                let mut walk = walk_of(*waypoints, *seed, id);
                walk.step(walked_s);
                walks.push(walk);
            }
            Self::Crowd(crowd) => crowd.enter(id),
            Self::Trace(_) => {}
        }
    }

    /// The user at this index leaves; no effect on a recorded walk.
    pub fn leave(&mut self, index: usize) {
        match self {
            Self::RandomWaypoint { walks, .. } => drop(walks.remove(index)),
            Self::Crowd(crowd) => crowd.leave(index),
            Self::Trace(_) => {}
        }
    }

    /// The index of the entry of a user in `users.mixture`; `None` outside a mixture.
    pub fn entry_of(&self, id: u32) -> Option<usize> {
        match self {
            Self::Crowd(crowd) => crowd.entry_of(id),
            Self::RandomWaypoint { .. } | Self::Trace(_) => None,
        }
    }

    /// Makes room for this number of users in all.
    pub fn reserve(&mut self, users: usize) {
        match self {
            Self::RandomWaypoint { walks, .. } => walks.reserve(users.saturating_sub(walks.len())),
            Self::Crowd(crowd) => crowd.reserve(users),
            Self::Trace(_) => {}
        }
    }

    /// Whether users act on each other, so that a step must end where a user enters or leaves.
    pub fn is_crowd(&self) -> bool {
        matches!(self, Self::Crowd(_))
    }

    /// Moves on by `dt_s` seconds.
    pub fn step(&mut self, dt_s: f64) {
        match self {
            Self::RandomWaypoint { walks, .. } => walks.iter_mut().for_each(|walk| walk.step(dt_s)),
            Self::Crowd(crowd) => crowd.step(dt_s),
            Self::Trace(trace) => trace.step(dt_s),
        }
    }

    /// Writes the users' positions, headings and velocities; heights do not change.
    pub fn write(&self, walkers: &mut [Walker]) {
        match self {
            Self::RandomWaypoint { walks, .. } => {
                walks.iter().zip(walkers).for_each(|(walk, walker)| walk.motion().write(walker));
            }
            Self::Crowd(crowd) => crowd.write(walkers),
            Self::Trace(trace) => trace.write(walkers),
        }
    }

    /// Writes at least the users' velocities, of which alone something depends between two updates
    /// of the room.
    pub fn write_velocities(&self, walkers: &mut [Walker]) {
        match self {
            Self::Crowd(crowd) => crowd.write_velocities(walkers),
            Self::RandomWaypoint { .. } | Self::Trace(_) => self.write(walkers),
        }
    }

    /// New walking speeds; a recorded walk keeps its own.
    pub fn set_speeds(&mut self, speeds: Speeds) {
        match self {
            Self::RandomWaypoint { waypoints, walks, .. } => {
                waypoints.speeds = speeds;
                walks.iter_mut().for_each(|walk| walk.set_speeds(speeds));
            }
            Self::Crowd(crowd) => crowd.set_speeds(speeds),
            Self::Trace(_) => {}
        }
    }
}

fn walk_of(waypoints: Waypoints, seed: u64, id: u32) -> RandomWaypoint {
    RandomWaypoint::new(waypoints, random::stream(seed, Purpose::Walk, id))
}

#[cfg(test)]
mod tests {
    use heliostat_channel::Vec3;

    use super::*;
    use crate::world::walker::Floor;

    const FLOOR: Floor = Floor { length_x_m: 5.0, length_y_m: 5.0 };

    fn waypoints(min_m_s: f64, max_m_s: f64, pause_mean_s: f64) -> Waypoints {
        Waypoints { floor: FLOOR, speeds: Speeds::new(min_m_s, max_m_s).unwrap(), pause_mean_s }
    }

    fn random_waypoint(waypoints: Waypoints, users: usize, seed: u64) -> Mobility {
        let mut mobility = Mobility::RandomWaypoint { waypoints, walks: Vec::new(), seed: 0 };
        mobility.begin(users, seed, &[]);
        mobility
    }

    fn walkers(count: usize) -> Vec<Walker> {
        vec![Walker { position: Vec3::zeros(), direction: [1.0, 0.0], velocity: [0.0, 0.0] }; count]
    }

    fn sample(seed: u64, users: usize, after_s: f64) -> Vec<Walker> {
        let mut mobility = random_waypoint(waypoints(0.1, 2.0, 0.0), users, seed);
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
        let mut mobility = random_waypoint(waypoints(0.1, 2.0, 0.0), 20, 5);
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
        let mut mobility = random_waypoint(waypoints(0.1, 2.0, 0.0), 10, 6);
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
            let mut mobility = random_waypoint(waypoints(0.5, 1.5, pause_mean_s), 20_000, 9);
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
        let mut mobility = random_waypoint(waypoints(0.5, 1.5, 1.0), 10, 10);
        let (mut before, mut after, mut kept) = (walkers(10), walkers(10), 0);
        for _ in 0..1000 {
            mobility.write(&mut before);
            mobility.step(0.05);
            mobility.write(&mut after);
            for (a, b) in before.iter().zip(&after).filter(|(a, b)| a.velocity == b.velocity && a.velocity == [0.0; 2])
            {
                // A complete segment fits into a step only where two points almost coincide.
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
        let mut mobility = random_waypoint(waypoints(0.0, 0.0, 0.0), 5, 8);
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
