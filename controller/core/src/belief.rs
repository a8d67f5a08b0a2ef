//! What the controller believes about each user: place, velocity and height at any time ahead, with
//! their uncertainty.
//!
//! [`Belief::handle_users`] takes each accepted position report once. [`Belief::estimate`] predicts
//! any time ahead. A user is found by number, in any order of the reports. A user who is absent
//! from a report has no estimate. A user who returns within a second continues: the missing reports
//! are a longer interval. One who returns later starts again. So does a number that is reported where
//! no motion of its user leads: the tracker gave it to another user.
//!
//! [`Belief::handle_orientation`] and [`Belief::handle_channel`] take each accepted report of these
//! kinds. [`Belief::handle_command`] takes each command, because the gains depend on the angles of
//! the mirrors.
//!
//! - [`motion`]: place and velocity, by a bank of hypotheses about the walk.
//! - [`height`]: the height of the detector, which is constant for a long time.
//! - [`noise`]: the noise of the reports, which starts from the scenario's values.
//! - [`heading`]: the direction in which the user faces, by the velocity and by measured gains.
//! - [`covered`]: whether the direct path is off for another reason than bodies and obstacles.
//! - `posture`: how users hold their receivers, as stated or by measured gains.
//! - `device`: the same by orientation reports, which also show headings; `holding`: all of these.
//! - `expected`, `tilt`, `lit_mirrors`: the gains that the model expects, also of tilted receivers and
//!   past bodies.
//! - `readings`, `densities`, `elementary`: measured gains, and how probable they are.
//! - [`light`]: whether served users receive the light that is expected.
//! - `independence`: how much a measurement of a user who stays at a place counts.
//! - [`occupancy`]: where unreported obstacles stand, by measured gains.
//! - [`conditions`]: where a method does not apply to a room.
//! - [`angle_history`]: the angles of the mirrors at the time of a measurement.

pub mod angle_history;
mod channel_evidence;
pub mod conditions;
pub mod covered;
mod densities;
mod device;
mod elementary;
mod expected;
pub mod heading;
pub mod height;
mod holding;
mod hypothesis;
mod independence;
pub mod innovations;
pub mod light;
mod lit_mirrors;
pub mod memory;
pub mod motion;
pub mod noise;
pub mod occupancy;
pub(crate) mod posture;
mod readings;
mod tilt;
mod track;
mod tracks;

use heliostat_channel::{Body, ChannelModel, Vec3, blockage::Cylinder, mirrors::MirrorAngles};
use heliostat_proto::{ChannelReport, LedReport, MirrorCommand, Nanos, UserReport, UserState};
use heliostat_scenario::{Scenario, Walk};

use crate::observe::slots::entry_of;
use angle_history::AngleHistory;
use channel_evidence::{Beliefs, Bodies, ChannelEvidence};
use device::DeviceSettings;
use expected::Room;
use heading::HEADINGS;
use independence::independent_share;
use innovations::{Innovations, normalised_squared};
use light::LightWatch;
use motion::{MotionEstimate, Sighting};
use noise::NoiseLevel;
use occupancy::Occupancy;
use posture::Posture;
use readings::{LedReadings, MeasuredGains, Readings};
use track::{Track, reported_velocity};
use tracks::Tracks;

/// Bounds of the estimated noise of a coordinate in m. The lower one keeps exact reports regular.
const POSITION_NOISE_M: [f64; 2] = [1e-3, 1.0];

/// Bounds of the estimated noise of a velocity component in m/s.
const VELOCITY_NOISE_M_S: [f64; 2] = [1e-3, 2.0];

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
    /// The direction in which the user faces: its length is that of the mean unit vector, 1 for a
    /// certain heading and 0 for an unknown one.
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
    priors: Walk,
    position_noise: NoiseLevel,
    velocity_noise: NoiseLevel,
    first_noise: [NoiseLevel; 2],
    /// Standard deviations of a coordinate in m and of a velocity component in m/s, as the scenario states them.
    stated_noise: [f64; 2],
    tracks: Tracks,
    last_ns: Nanos,
    /// A channel report of a larger age is not accepted.
    report_age_max_ns: Nanos,
    body: Option<Body>,
    posture: Posture,
    devices: DeviceSettings,
    /// The polar angle in rad of each receiver of which measurements show whether it is tilted.
    undecided: Vec<Option<f64>>,
    directions: [Vec3; HEADINGS],
    history: AngleHistory,
    /// The angles at the time of a measurement.
    angles: MirrorAngles,
    evidence: ChannelEvidence,
    readings: Readings,
    led_readings: LedReadings,
    /// The body of each user of a channel report, where the heading is known.
    bodies: Vec<Option<Cylinder>>,
    /// Absent where there are no unreported obstacles.
    map: Option<Occupancy>,
    leds: Vec<Vec3>,
    innovations: Innovations,
    light: LightWatch,
}

impl Belief {
    /// A belief about no users, with the scenario's priors and noise.
    pub fn new(scenario: &Scenario, model: &ChannelModel, capacity: usize) -> Self {
        let streams = &scenario.streams.positions;
        let readings = Readings::new(&scenario.streams.channel);
        let position_noise = NoiseLevel::new(streams.noise_m, POSITION_NOISE_M);
        let velocity_noise = NoiseLevel::new(streams.velocity_noise_m_s, VELOCITY_NOISE_M_S);
        Self {
            priors: scenario.control.walk.clone(),
            position_noise,
            velocity_noise,
            first_noise: [position_noise, velocity_noise],
            stated_noise: [streams.noise_m, streams.velocity_noise_m_s],
            tracks: Tracks::new(capacity),
            last_ns: 0,
            report_age_max_ns: scenario.control.report_age_max_ns(),
            body: scenario.blockage.body(),
            posture: Posture::new(scenario.control.tilt),
            devices: DeviceSettings::new(scenario),
            undecided: Vec::with_capacity(capacity),
            directions: heading::directions(),
            history: AngleHistory::new(model.mirrors.len()),
            angles: MirrorAngles::flat(model.mirrors.len()),
            evidence: ChannelEvidence::new(model, readings, capacity),
            readings,
            led_readings: LedReadings::new(model.leds.len()),
            bodies: Vec::with_capacity(capacity),
            leds: model.leds.iter().map(|led| led.position).collect(),
            map: Occupancy::new(scenario),
            innovations: Innovations::default(),
            light: LightWatch::new(model.leds.len()),
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

    /// Takes an accepted channel report, and the LED report of the same time, if there is one.
    /// `obstacles` are those of the latest survey, and `unusable` the mirrors that do not follow. Does
    /// not allocate.
    pub fn handle_channel(
        &mut self,
        model: &ChannelModel,
        report: &ChannelReport,
        leds: Option<&LedReport>,
        obstacles: &[Cylinder],
        unusable: &[u32],
    ) {
        let only_direct =
            self.map.is_none() && self.tracks.present().iter().all(|track| self.is_heading_certain(track));
        if only_direct {
            // Only the direct paths can show anything.
            for (user, track) in self.tracks.present_mut().iter_mut().enumerate() {
                if let Some(measured) = entry_of(&report.users, user, track.user, |entry| entry.user) {
                    track.covered.predict();
                    track.covered.handle_direct(self.readings.shows(f64::from(measured.los_gain)), 1.0);
                }
            }
            if !self.light.is_due(report.stamp.time_ns) {
                return;
            }
        }
        let at = (report.stamp.time_ns, signed_s(report.stamp.time_ns, self.last_ns));
        let angles = self.history.at(report.stamp.time_ns, &mut self.angles).then_some(&self.angles);
        let Self { tracks, evidence, bodies, directions, map, body, posture, devices, undecided, .. } = self;
        let (light, led_readings) = (&mut self.light, &mut self.led_readings);
        let tracks = tracks.present_mut();
        undecided.clear();
        let places = tracks.iter().map(|track| {
            let place = track.held_place(at, (posture, devices), directions);
            undecided.push(posture.undecided(place.held));
            place
        });
        let room = Room { model, obstacles, angles, unusable };
        evidence.expect(&room, places);
        bodies.clear();
        bodies.extend(tracks.iter().zip(evidence.positions()).map(|(track, position)| {
            let (shape, heading) = (body.as_ref()?, track.heading.known(directions)?);
            Some(shape.behind(position, &heading))
        }));
        let bodies = body.as_ref().map(|shape| Bodies { shape, directions, known: bodies });
        for (user, track) in tracks.iter_mut().enumerate() {
            let Some(measured) = entry_of(&report.users, user, track.user, |entry| entry.user) else { continue };
            let (los, irs) = (f64::from(measured.los_gain), f64::from(measured.irs_gain));
            let measured = MeasuredGains { los, irs, leds: led_readings.of(leds, track.user) };
            let [u, v] = track.motion.estimate(0.0).velocity_m_s;
            let independent = independent_share(u.hypot(v), self.readings.interval_s);
            // Where only the direct paths count, the gains over the mirrors change a copy.
            let mut copy = *track;
            let Track { heading, covered, tilt, .. } = if only_direct { &mut copy } else { track };
            let undecided = undecided[user].map(|polar_rad| (tilt, polar_rad));
            let beliefs = Beliefs { heading, covered, undecided, independent };
            let received = evidence.examine(&room, user, measured, bodies.as_ref(), beliefs, map.as_mut());
            light.handle(received, report.stamp.time_ns);
        }
        if only_direct {
            return;
        }
        map.iter_mut().for_each(Occupancy::finish_report);
        self.decide_posture();
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

    /// How the light of served users compares with the expected one.
    pub fn light(&self) -> &LightWatch {
        &self.light
    }

    /// Forgets all users, since another source reports from now on.
    pub fn forget(&mut self) {
        self.tracks.clear();
        self.history.clear();
        self.posture.decide(std::iter::empty());
        self.light.clear();
        self.map.iter_mut().for_each(Occupancy::clear);
        [self.position_noise, self.velocity_noise] = self.first_noise;
    }

    /// Takes an accepted report.
    pub fn handle_users(&mut self, report: &UserReport) {
        let time_ns = report.stamp.time_ns;
        self.tracks.begin_report();
        for (slot, user) in report.users.iter().enumerate() {
            let known = self.tracks.former(slot, user.user, time_ns);
            let seen_ns = known.and_then(|track| track.seen_ns()).unwrap_or(self.last_ns);
            let elapsed_s = time_ns.saturating_sub(seen_ns) as f64 * 1e-9;
            let [x, y, _] = user.position_m.map(f64::from);
            let noise_m = self.position_noise.deviation();
            let innovation =
                known.and_then(|track| normalised_squared(&track.motion.estimate(elapsed_s), [x, y], noise_m));
            let mut track = known.unwrap_or_else(|| self.new_track(user.user));
            self.learn_noise(&track, user, time_ns);
            // Any interval may be behind the first report of a user.
            let is_another = self.correct(&mut track, user, elapsed_s);
            if let Some(squared) = innovation.filter(|_| !is_another) {
                self.innovations.add(squared);
            }
            track.remember(user, time_ns);
            self.tracks.push(track);
        }
        self.tracks.finish_report(time_ns);
        self.last_ns = time_ns;
        self.decide_posture();
    }

    /// The estimate for a user of the last report, at a time in s after that report.
    pub fn estimate(&self, user: u32, ahead_s: f64) -> Option<Estimate> {
        let track = self.tracks.find(user)?;
        let MotionEstimate { position_m: [x, y], velocity_m_s: [u, v], position_cov_m2, velocity_var_m2_s2 } =
            track.motion.estimate(ahead_s);
        let position = Vec3::new(x, y, track.height.mean_m());
        let heading = self.heading(track, u.hypot(v));
        let direct_clear = self.direct_clear(&position, 1.0 - track.covered.probability());
        let velocity = Vec3::new(u, v, 0.0);
        Some(Estimate { position, velocity, position_cov_m2, velocity_var_m2_s2, heading, direct_clear })
    }

    /// Probability that neither an unreported obstacle nor a cover blocks the direct path, at a detector
    /// that is uncovered with this probability. With several LEDs the map is left out: another LED then
    /// serves.
    fn direct_clear(&self, position: &Vec3, uncovered: f64) -> f64 {
        let (Some(map), [led]) = (&self.map, &self.leds[..]) else { return uncovered };
        let mut clear = [uncovered];
        map.weigh(position, std::slice::from_ref(led), &mut clear);
        clear[0]
    }

    /// The probability of each heading of a user of the last report.
    pub fn heading_distribution(&self, user: u32) -> Option<&[f64; HEADINGS]> {
        self.tracks.find(user).map(|track| track.heading.probabilities())
    }

    /// The unit vector of a heading of [`Self::heading_distribution`].
    pub fn direction(&self, heading: usize) -> &Vec3 {
        &self.directions[heading]
    }

    /// Estimated standard deviations of a reported coordinate in m and of a reported velocity
    /// component in m/s.
    pub fn noise(&self) -> [f64; 2] {
        [&self.position_noise, &self.velocity_noise].map(NoiseLevel::deviation)
    }

    /// The same as the scenario states them.
    pub fn stated_noise(&self) -> [f64; 2] {
        self.stated_noise
    }

    fn new_track(&self, user: u32) -> Track {
        Track::new(user, &self.priors, self.map.is_none())
    }

    /// Corrects a track by a report. Where the number has been given to another user, all but the
    /// motion starts again, and the result is true.
    fn correct(&self, track: &mut Track, user: &UserState, elapsed_s: f64) -> bool {
        let [x, y, z] = user.position_m.map(f64::from);
        let [position_noise_m, velocity_noise_m_s] = self.noise();
        let sighting = Sighting {
            position_m: [x, y],
            velocity_m_s: reported_velocity(user),
            position_noise_m,
            velocity_noise_m_s,
        };
        let jumped = track.motion.correct(&self.priors, elapsed_s, &sighting);
        if jumped {
            *track = Track { motion: track.motion, ..self.new_track(user.user) };
        }
        track.height.correct(elapsed_s, z, position_noise_m);
        let velocity = track.motion.estimate(0.0).velocity_m_s;
        track.heading.handle_velocity(elapsed_s, velocity, &self.directions);
        jumped
    }

    /// Learns the noise of positions by three reports, and that of velocities by two.
    fn learn_noise(&mut self, track: &Track, user: &UserState, time_ns: Nanos) {
        let Some((squared, factor)) = track.interpolation_error(user, time_ns) else { return };
        self.position_noise.handle(squared, factor);
        if let (Some([u, v]), Some([former_u, former_v])) = (reported_velocity(user), track.reported_velocity) {
            let (du, dv) = (u - former_u, v - former_v);
            self.velocity_noise.handle(du * du + dv * dv, 2.0);
        }
    }
}

/// The time in s from `from_ns` to `to_ns`, negative where it is earlier.
fn signed_s(to_ns: Nanos, from_ns: Nanos) -> f64 {
    to_ns.saturating_sub(from_ns) as f64 * 1e-9 - from_ns.saturating_sub(to_ns) as f64 * 1e-9
}
