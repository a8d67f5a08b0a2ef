//! What the controller believes about each user: place, velocity and height at any time ahead, with
//! their uncertainty.
//!
//! [`Belief::handle_users`] takes each accepted position report once. [`Belief::estimate`] predicts
//! any time ahead. A user is found by number, in any order of the reports. A user who is absent
//! from a report is forgotten, so a returning user starts again.
//!
//! - [`motion`]: place and velocity, by a bank of hypotheses about the walk.
//! - [`height`]: the height of the detector, which is constant for a long time.
//! - [`noise`]: the noise of the reports, which starts from the scenario's values.

pub mod height;
mod hypothesis;
pub mod memory;
pub mod motion;
pub mod noise;

use heliostat_channel::Vec3;
use heliostat_proto::{Nanos, UserReport, UserState};
use heliostat_scenario::{Scenario, Walk};
use serde::{Deserialize, Serialize};

use height::Height;
use motion::{Motion, MotionEstimate, Sighting, WalkPriors};
use noise::NoiseLevel;

/// Bounds of the estimated noise of a coordinate in m. The lower one keeps exact reports regular.
const POSITION_NOISE_M: [f64; 2] = [1e-3, 1.0];

/// Bounds of the estimated noise of a velocity component in m/s.
const VELOCITY_NOISE_M_S: [f64; 2] = [1e-3, 2.0];

/// Two intervals between reports count as equal if they differ by less than this share.
const EQUAL_INTERVALS: f64 = 0.02;

/// A user's reports and motion.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Track {
    user: u32,
    motion: Motion,
    height: Height,
    /// The last two reported positions, the later one first, with the time between them in s.
    earlier: [Option<Place>; 2],
    reported_velocity: Option<[f64; 2]>,
}

/// A reported position.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Place {
    at_m: [f64; 2],
    time_ns: Nanos,
}

/// Place and velocity of a user at a time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Estimate {
    /// Position of the detector in m.
    pub position: Vec3,
    /// Velocity in m/s, in the floor plane.
    pub velocity: Vec3,
    /// Covariance of x and y in m2: xx, xy, yy.
    pub position_cov_m2: [f64; 3],
}

/// The belief about all users of a room. Its buffers are allocated once.
#[derive(Clone, Debug)]
pub struct Belief {
    priors: WalkPriors,
    position_noise: NoiseLevel,
    velocity_noise: NoiseLevel,
    first_noise: [NoiseLevel; 2],
    /// In the order of the last report.
    tracks: Vec<Track>,
    former: Vec<Track>,
    last_ns: Nanos,
    innovations: Innovations,
}

/// Normalised innovation squared of the position reports of known users since the start.
///
/// d' S^-1 d for the deviation d of a reported position from the predicted one, where S is the
/// covariance of the prediction plus that of the report. Its mean is 2 if both are right.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Innovations {
    /// Number of reported positions.
    pub count: u64,
    /// Sum of their normalised innovations squared.
    pub sum: f64,
}

impl Belief {
    /// A belief about no users, with the scenario's priors and noise.
    pub fn new(scenario: &Scenario, capacity: usize) -> Self {
        let streams = &scenario.streams.positions;
        let position_noise = NoiseLevel::new(streams.noise_m, POSITION_NOISE_M);
        let velocity_noise = NoiseLevel::new(streams.velocity_noise_m_s, VELOCITY_NOISE_M_S);
        Self {
            priors: priors(&scenario.control.walk),
            position_noise,
            velocity_noise,
            first_noise: [position_noise, velocity_noise],
            tracks: Vec::with_capacity(capacity),
            former: Vec::with_capacity(capacity),
            last_ns: 0,
            innovations: Innovations::default(),
        }
    }

    /// How well the predictions agreed with the reports.
    pub fn innovations(&self) -> Innovations {
        self.innovations
    }

    /// Forgets all users, since another source reports from now on.
    pub fn forget(&mut self) {
        self.tracks.clear();
        [self.position_noise, self.velocity_noise] = self.first_noise;
    }

    /// Takes an accepted report.
    pub fn handle_users(&mut self, report: &UserReport) {
        let time_ns = report.stamp.time_ns;
        let elapsed_s = time_ns.saturating_sub(self.last_ns) as f64 * 1e-9;
        std::mem::swap(&mut self.tracks, &mut self.former);
        self.tracks.clear();
        for (slot, user) in report.users.iter().enumerate() {
            let same_slot = self.former.get(slot).filter(|track| track.user == user.user);
            let known = same_slot.or_else(|| self.former.iter().find(|track| track.user == user.user)).copied();
            if let Some(track) = &known {
                self.compare(track, user, elapsed_s);
            }
            let mut track = known.unwrap_or_else(|| Track::new(user.user, &self.priors));
            self.learn_noise(&track, user, time_ns);
            self.correct(&mut track, user, elapsed_s);
            track.remember(user, time_ns);
            self.tracks.push(track);
        }
        self.last_ns = time_ns;
    }

    /// The estimate for a user of the last report, at a time in s after that report.
    pub fn estimate(&self, user: u32, ahead_s: f64) -> Option<Estimate> {
        let track = self.tracks.iter().find(|track| track.user == user)?;
        let MotionEstimate { position_m: [x, y], velocity_m_s: [u, v], position_cov_m2, .. } =
            track.motion.estimate(ahead_s);
        let position = Vec3::new(x, y, track.height.mean_m());
        Some(Estimate { position, velocity: Vec3::new(u, v, 0.0), position_cov_m2 })
    }

    /// Estimated standard deviations of a reported coordinate in m and of a reported velocity
    /// component in m/s.
    pub fn noise(&self) -> [f64; 2] {
        [self.position_noise.deviation(), self.velocity_noise.deviation()]
    }

    /// Compares a reported position with the predicted one.
    fn compare(&mut self, track: &Track, user: &UserState, elapsed_s: f64) {
        let MotionEstimate { position_m, position_cov_m2: [xx, xy, yy], .. } = track.motion.estimate(elapsed_s);
        let noise = self.position_noise.deviation().powi(2);
        let (xx, yy) = (xx + noise, yy + noise);
        let [dx, dy] = [0, 1].map(|axis| f64::from(user.position_m[axis]) - position_m[axis]);
        let squared = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy);
        if squared.is_finite() {
            self.innovations.count += 1;
            self.innovations.sum += squared;
        }
    }

    fn correct(&self, track: &mut Track, user: &UserState, elapsed_s: f64) {
        let [x, y, z] = user.position_m.map(f64::from);
        let [position_noise_m, velocity_noise_m_s] = self.noise();
        let sighting = Sighting {
            position_m: [x, y],
            velocity_m_s: reported_velocity(user),
            position_noise_m,
            velocity_noise_m_s,
        };
        track.motion.correct(&self.priors, elapsed_s, &sighting);
        track.height.correct(elapsed_s, z, position_noise_m);
    }

    /// Compares a report with the two before it, if the three are equally spaced.
    fn learn_noise(&mut self, track: &Track, user: &UserState, time_ns: Nanos) {
        let [Some(last), Some(before)] = track.earlier else { return };
        let interval = time_ns.saturating_sub(last.time_ns) as f64;
        let former_interval = last.time_ns.saturating_sub(before.time_ns) as f64;
        if (interval - former_interval).abs() > EQUAL_INTERVALS * interval {
            return;
        }
        let [x, y, _] = user.position_m.map(f64::from);
        let second = |now: f64, axis: usize| now - 2.0 * last.at_m[axis] + before.at_m[axis];
        let (across, along) = (second(x, 0), second(y, 1));
        self.position_noise.handle(across * across + along * along, 6.0);
        if let (Some([u, v]), Some([former_u, former_v])) = (reported_velocity(user), track.reported_velocity) {
            let (du, dv) = (u - former_u, v - former_v);
            self.velocity_noise.handle(du * du + dv * dv, 2.0);
        }
    }
}

impl Track {
    fn new(user: u32, priors: &WalkPriors) -> Self {
        let motion = Motion::new(priors);
        Self { user, motion, height: Height::default(), earlier: [None; 2], reported_velocity: None }
    }

    fn remember(&mut self, user: &UserState, time_ns: Nanos) {
        let [x, y, _] = user.position_m.map(f64::from);
        self.earlier = [Some(Place { at_m: [x, y], time_ns }), self.earlier[0]];
        self.reported_velocity = reported_velocity(user);
    }
}

fn priors(settings: &Walk) -> WalkPriors {
    WalkPriors {
        changes_per_s: settings.changes_per_s,
        speed_m_s: settings.speed_m_s,
        standing: settings.standing,
        curving: settings.curving,
        turn_rate_rad_s: settings.turn_rate_deg_per_s.to_radians(),
    }
}

/// The velocity of a report: a tracker that does not measure it reports zeros.
fn reported_velocity(user: &UserState) -> Option<[f64; 2]> {
    (user.velocity_m_s != [0.0; 2]).then(|| user.velocity_m_s.map(f64::from))
}

#[cfg(test)]
mod tests {
    use heliostat_proto::Stamp;

    use super::*;

    fn report(tick: u64, users: &[(u32, [f32; 3], [f32; 2])]) -> UserReport {
        let stamp = Stamp { source: 1, sequence: tick, time_ns: tick * 100_000_000 };
        let state = |&(user, position_m, velocity_m_s): &(u32, [f32; 3], [f32; 2])| UserState {
            user,
            position_m,
            velocity_m_s,
            min_rate_bps: 1e6,
        };
        UserReport { stamp, tick, users: users.iter().map(state).collect() }
    }

    fn belief() -> Belief {
        Belief::new(&Scenario::builtin("hall").expect("a built-in scenario"), 64)
    }

    /// The position after user 7 walked along x at 1 m/s for ten reports, beside these others.
    fn after_walk(others: impl Fn(u64) -> Vec<(u32, [f32; 3], [f32; 2])>, first: bool) -> Vec3 {
        let mut belief = belief();
        for tick in 1..=10 {
            let mut users = others(tick);
            let slot = if first { 0 } else { users.len() };
            users.insert(slot, (7, [0.1 * tick as f32, 0.5, 0.9], [1.0, 0.0]));
            belief.handle_users(&report(tick, &users));
        }
        belief.estimate(7, 0.5).expect("a user").position
    }

    #[test]
    fn a_user_is_found_by_number_whatever_the_order_of_the_report() {
        let alone = after_walk(|_| Vec::new(), true);
        assert!((alone - Vec3::new(1.5, 0.5, 0.9)).norm() < 0.05, "{alone:?}");
        let other = |user| (user, [-2.0, 1.0, 1.2], [0.0, 0.4]);
        let come_and_go = |tick| if tick % 3 == 0 { vec![other(3)] } else { vec![other(9), other(3)] };
        // The noise of the reports is learned from all users, so the weights differ a little.
        for first in [true, false] {
            assert!((after_walk(come_and_go, first) - alone).norm() < 1e-3);
        }
    }

    #[test]
    fn a_user_who_returns_starts_again() {
        let mut belief = belief();
        for tick in 1..=10 {
            belief.handle_users(&report(tick, &[(7, [0.1 * tick as f32, 0.0, 0.9], [1.0, 0.0])]));
        }
        belief.handle_users(&report(11, &[]));
        assert_eq!(belief.estimate(7, 0.0), None);
        belief.handle_users(&report(12, &[(7, [-3.0, 2.0, 0.9], [0.0, 0.5])]));
        let back = belief.estimate(7, 0.0).expect("a user").position;
        assert!((back - Vec3::new(-3.0, 2.0, 0.9)).norm() < 0.01, "{back:?}");
    }

    #[test]
    fn a_tracker_without_velocities_still_shows_the_direction() {
        let mut belief = belief();
        for tick in 1..=20 {
            belief.handle_users(&report(tick, &[(7, [0.08 * tick as f32, 0.0, 0.9], [0.0, 0.0])]));
        }
        let estimate = belief.estimate(7, 0.0).expect("a user");
        assert!((estimate.velocity.x - 0.8).abs() < 0.1, "{estimate:?}");
    }

    #[test]
    fn the_innovations_of_a_straight_walk_have_the_mean_of_two_degrees_of_freedom() {
        let mut belief = belief();
        for tick in 1..=2000_u64 {
            // Quantiles of a circular normal error of 0.05 m.
            let (radius, angle) = (0.05 * (-2.0 * (1.0 - (tick as f32 * 0.618_034).fract()).ln()).sqrt(), tick as f32);
            let position = [0.5 + radius * angle.cos(), radius * angle.sin(), 0.9];
            belief.handle_users(&report(tick, &[(7, position, [0.0, 0.0])]));
        }
        let Innovations { count, sum } = belief.innovations();
        assert_eq!(count, 1999, "the first report of a user has no prediction");
        assert!((sum / count as f64 - 2.0).abs() < 0.4, "{}", sum / count as f64);
    }

    #[test]
    fn the_noise_of_the_reports_is_learned() {
        let mut belief = belief();
        for tick in 1..=400_u64 {
            let angle = tick as f32 * 2.399_963;
            let (dx, dy) = (0.2 * angle.cos(), 0.2 * angle.sin());
            belief.handle_users(&report(tick, &[(7, [dx, dy, 0.9], [dy, dx])]));
        }
        let [position_m, _] = belief.noise();
        assert!(position_m > 0.1, "{position_m}");
    }
}
