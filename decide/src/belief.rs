//! What the controller believes about each user: place, velocity and height at any time ahead, with
//! their uncertainty.
//!
//! [`Belief::handle_users`] takes each accepted position report once. [`Belief::estimate`] predicts
//! any time ahead. A user is found by number, in any order of the reports. A user who is absent
//! from a report is forgotten, so a returning user starts again.
//!
//! [`Belief::handle_channel`] takes each accepted channel report, and [`Belief::handle_command`]
//! each command, because the gains depend on the angles of the mirrors.
//!
//! - [`motion`]: place and velocity, by a bank of hypotheses about the walk.
//! - [`height`]: the height of the detector, which is constant for a long time.
//! - [`noise`]: the noise of the reports, which starts from the scenario's values.
//! - [`heading`]: the direction in which the user faces, by the velocity and by measured gains.
//! - [`covered`]: whether the direct path is off for another reason than bodies and obstacles.
//! - `posture`: how users hold their receivers.
//! - [`occupancy`]: where unreported obstacles stand, by measured gains.
//! - [`angle_history`]: the angles of the mirrors at the time of a measurement.

pub mod angle_history;
pub(crate) mod body;
mod channel_evidence;
pub mod covered;
pub mod heading;
pub mod height;
mod hypothesis;
pub mod innovations;
pub mod memory;
pub mod motion;
pub mod noise;
pub mod occupancy;
pub(crate) mod posture;
mod track;

use heliostat_channel::{ChannelModel, Vec3, blockage::Cylinder, mirrors::MirrorAngles};
use heliostat_proto::{ChannelReport, MirrorCommand, Nanos, OrientationReport, UserReport, UserState};
use heliostat_scenario::{Scenario, Walk};

use angle_history::AngleHistory;
use body::Body;
use channel_evidence::{Beliefs, Bodies, ChannelEvidence, MeasuredGains, Readings};
use heading::{HEADING_KNOWN, HEADINGS};
use innovations::Innovations;
use motion::{MotionEstimate, Sighting, WalkPriors};
use noise::NoiseLevel;
use occupancy::Occupancy;
use posture::Posture;
use track::{Track, reported_velocity};

/// Bounds of the estimated noise of a coordinate in m. The lower one keeps exact reports regular.
const POSITION_NOISE_M: [f64; 2] = [1e-3, 1.0];

/// Bounds of the estimated noise of a velocity component in m/s.
const VELOCITY_NOISE_M_S: [f64; 2] = [1e-3, 2.0];

/// Two intervals between reports count as equal if they differ by less than this share.
const EQUAL_INTERVALS: f64 = 0.02;

/// Place and velocity of a user at a time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Estimate {
    /// Position of the detector in m.
    pub position: Vec3,
    /// Velocity in m/s, in the floor plane.
    pub velocity: Vec3,
    /// Covariance of x and y in m2: xx, xy, yy.
    pub position_cov_m2: [f64; 3],
    /// Variance of a velocity component in m2/s2.
    pub velocity_var_m2_s2: f64,
    /// Mean of the unit vector in which the user faces: its length is 1 for a certain heading and 0
    /// for an unknown one.
    pub heading: Vec3,
    /// Probability that neither an unreported obstacle nor a covered detector blocks the direct
    /// path; bodies are not included.
    pub direct_clear: f64,
}

/// A heading whose mean vector is longer than this is known: a spread of 18 degrees.
const HEADING_CERTAIN: f64 = 0.95;

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
    body: Option<Body>,
    posture: Posture,
    directions: [Vec3; HEADINGS],
    history: AngleHistory,
    /// The angles at the time of a measurement.
    angles: MirrorAngles,
    evidence: ChannelEvidence,
    readings: Readings,
    /// The body of each user of a channel report, where the heading is known.
    bodies: Vec<Option<Cylinder>>,
    /// Absent where there are no unreported obstacles.
    map: Option<Occupancy>,
    /// The place of the LED, in a room with one.
    led: Option<Vec3>,
    innovations: Innovations,
}

impl Belief {
    /// A belief about no users, with the scenario's priors and noise.
    pub fn new(scenario: &Scenario, model: &ChannelModel, capacity: usize) -> Self {
        let streams = &scenario.streams.positions;
        let readings = Readings::new(&scenario.streams.channel);
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
            body: Body::new(&scenario.blockage),
            posture: Posture::new(scenario.control.tilt),
            directions: heading::directions(),
            history: AngleHistory::new(model.mirrors.len()),
            angles: MirrorAngles::flat(model.mirrors.len()),
            evidence: ChannelEvidence::new(model, readings, capacity),
            readings,
            bodies: Vec::with_capacity(capacity),
            led: channel_evidence::single_led(model),
            map: Occupancy::new(scenario),
            innovations: Innovations::default(),
        }
    }

    /// The array announces its settling time in s.
    pub fn set_settling(&mut self, settling_s: f64) {
        self.history.set_settling(settling_s);
    }

    /// Notes a command that was given.
    pub fn handle_command(&mut self, command: &MirrorCommand) {
        self.history.handle_command(command);
    }

    /// Takes an accepted channel report, with the orientations of the receivers where they are
    /// reported. `obstacles` are those of the latest survey, and `unusable` the mirrors that do not
    /// follow. Does not allocate.
    pub fn handle_channel(
        &mut self,
        model: &ChannelModel,
        (report, held): (&ChannelReport, Option<&OrientationReport>),
        obstacles: &[Cylinder],
        unusable: &[u32],
    ) {
        if self.map.is_none() && self.tracks.iter().all(|track| self.is_heading_certain(track)) {
            // Only the direct paths can show anything.
            for (user, track) in self.tracks.iter_mut().enumerate() {
                if let Some(measured) = track.measured(user, report) {
                    track.covered.predict();
                    track.covered.handle_direct(self.readings.shows(f64::from(measured.los_gain)), 1.0);
                }
            }
            return;
        }
        let ahead_s = signed_s(report.stamp.time_ns, self.last_ns);
        let angles = self.history.at(report.stamp.time_ns, &mut self.angles).then_some(&self.angles);
        let Self { tracks, evidence, bodies, directions, map, body, posture, .. } = self;
        let places = tracks.iter().map(|track| track.held_place(ahead_s, (posture, held), directions));
        evidence.expect(model, places, obstacles, angles, unusable);
        bodies.clear();
        bodies.extend(tracks.iter().zip(evidence.positions()).map(|(track, position)| {
            let heading = track.heading.mean(directions);
            let length = heading.norm();
            let body = body.filter(|_| length > HEADING_KNOWN)?;
            Some(body.behind(position, &(heading / length)))
        }));
        let bodies = body.as_ref().map(|shape| Bodies { shape, directions, known: bodies });
        for (user, track) in tracks.iter_mut().enumerate() {
            let Some(measured) = track.measured(user, report) else { continue };
            let measured = MeasuredGains { los: f64::from(measured.los_gain), irs: f64::from(measured.irs_gain) };
            let beliefs = Beliefs { heading: &mut track.heading, covered: &mut track.covered };
            evidence.examine(model, user, measured, bodies.as_ref(), beliefs, map.as_mut());
        }
        map.iter_mut().for_each(Occupancy::finish_report);
    }

    fn is_heading_certain(&self, track: &Track) -> bool {
        self.body.is_none() || track.heading.mean(&self.directions).norm() > HEADING_CERTAIN
    }

    /// Writes the probability that no unreported obstacle blocks the path from a place to each
    /// column of mirrors; false where all obstacles are reported.
    pub fn unobstructed(&self, from: &Vec3, columns: &mut [f64]) -> bool {
        let Some(map) = &self.map else { return false };
        columns.fill(1.0);
        map.weigh(from, self.evidence.columns(), columns);
        true
    }

    /// Whether all obstacles are reported, so that no map of others is kept.
    pub fn knows_obstacles(&self) -> bool {
        self.map.is_none()
    }

    /// How well the predictions agreed with the reports.
    pub fn innovations(&self) -> Innovations {
        self.innovations
    }

    /// Forgets all users, since another source reports from now on.
    pub fn forget(&mut self) {
        self.tracks.clear();
        self.history.clear();
        self.map.iter_mut().for_each(Occupancy::clear);
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
                let [x, y, _] = user.position_m.map(f64::from);
                let noise_m = self.position_noise.deviation();
                self.innovations.handle(&track.motion.estimate(elapsed_s), [x, y], noise_m);
            }
            let mut track = known.unwrap_or_else(|| Track::new(user.user, &self.priors, self.map.is_none()));
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
        let MotionEstimate { position_m: [x, y], velocity_m_s: [u, v], position_cov_m2, velocity_var_m2_s2 } =
            track.motion.estimate(ahead_s);
        let position = Vec3::new(x, y, track.height.mean_m());
        let heading = track.heading.mean(&self.directions);
        let mut direct_clear = [1.0 - track.covered.probability()];
        if let (Some(map), Some(led)) = (&self.map, &self.led) {
            map.weigh(&position, std::slice::from_ref(led), &mut direct_clear);
        }
        let [direct_clear] = direct_clear;
        let velocity = Vec3::new(u, v, 0.0);
        Some(Estimate { position, velocity, position_cov_m2, velocity_var_m2_s2, heading, direct_clear })
    }

    /// Estimated standard deviations of a reported coordinate in m and of a reported velocity
    /// component in m/s.
    pub fn noise(&self) -> [f64; 2] {
        [self.position_noise.deviation(), self.velocity_noise.deviation()]
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
        let velocity = track.motion.estimate(0.0).velocity_m_s;
        track.heading.handle_velocity(elapsed_s, velocity, &self.directions);
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

fn priors(settings: &Walk) -> WalkPriors {
    WalkPriors {
        changes_per_s: settings.changes_per_s,
        speed_m_s: settings.speed_m_s,
        standing: settings.standing,
        curving: settings.curving,
        turn_rate_rad_s: settings.turn_rate_deg_per_s.to_radians(),
    }
}

/// The time in s from `from_ns` to `to_ns`, negative where it is earlier.
fn signed_s(to_ns: Nanos, from_ns: Nanos) -> f64 {
    to_ns.saturating_sub(from_ns) as f64 * 1e-9 - from_ns.saturating_sub(to_ns) as f64 * 1e-9
}

#[cfg(test)]
mod tests {
    use heliostat_proto::Stamp;
    use rand_chacha::rand_core::{Rng, SeedableRng};

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
        let scenario = Scenario::builtin("hall").expect("a built-in scenario");
        let model = scenario.channel_model().expect("a valid channel");
        Belief::new(&scenario, &model, 64)
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
        let (mut belief, mut rng) = (belief(), rand_chacha::ChaCha8Rng::seed_from_u64(1));
        for tick in 1..=2000_u64 {
            // A circular normal error of 0.05 m.
            let [quantile, turn] = [0; 2].map(|_| (rng.next_u64() >> 40) as f32 / (1_u64 << 24) as f32);
            let (radius, angle) = (0.05 * (-2.0 * (1.0 - quantile).ln()).sqrt(), turn * std::f32::consts::TAU);
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
