//! The reports of the room's trackers and receivers: each stream has its own rate, latency and
//! noise.
//!
//! A sample is taken when it is due and released one latency later; its stamp has the time of the
//! sample. Reports that are released at the same instant are ordered: obstacles, orientations,
//! channel, positions, because the positions complete a tick.
//!
//! - [`schedule`]: when the samples of a stream are due.

use std::collections::BTreeMap;

use heliostat_array::moment::Moment;
use heliostat_channel::{Cylinder, MirrorAngles, Orientation};
use heliostat_proto::{
    ChannelReport, Obstacle, ObstacleReport, OrientationReport, Stamp, UserChannel, UserOrientation, UserReport,
    UserState,
};
use heliostat_scenario::Streams;

use self::schedule::Schedule;
use crate::random::{self, Purpose, RoomRng};
use crate::world::World;
use crate::world::walker::Walker;

pub mod schedule;

/// A tick that is sampled later than this after its due time is a delayed tick; half a period if
/// that is shorter.
pub const LATE_NS: u64 = 1_000_000;

/// A report of one stream.
#[derive(Clone, Debug, PartialEq)]
pub enum Report {
    /// The obstacles in the room.
    Obstacles(ObstacleReport),
    /// How the users hold their receivers.
    Orientation(OrientationReport),
    /// The users' channel gains and SINR.
    Channel(ChannelReport),
    /// The users' positions and velocities; completes a tick.
    Users(UserReport),
}

/// The order of release: by time, then by rank among the reports of the same instant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct ReleaseOrder {
    release_ns: u64,
    rank: u8,
    sequence: u64,
}

/// All report streams of a room.
#[derive(Clone, Debug)]
pub struct Reports {
    source: u64,
    settings: Streams,
    positions: Schedule,
    channel: Schedule,
    obstacles: Schedule,
    orientation: Schedule,
    position_noise: RoomRng,
    channel_noise: RoomRng,
    orientation_noise: RoomRng,
    tick: u64,
    channel_sequence: u64,
    obstacle_sequence: u64,
    orientation_sequence: u64,
    late_ticks: u64,
    waiting: BTreeMap<ReleaseOrder, Report>,
    irs_gain: Vec<f64>,
    sinr: Vec<f64>,
}

impl Reports {
    /// The streams of a scenario; `source` is the id in every stamp.
    pub fn new(settings: &Streams, seed: u64, source: u64) -> Self {
        Self {
            source,
            positions: Schedule::new(settings.positions.rate_hz, 0),
            channel: Schedule::new(settings.channel.rate_hz, 0),
            obstacles: Schedule::new(settings.obstacles.rate_hz, 0),
            orientation: Schedule::new(settings.orientation.as_ref().map_or(0.0, |stream| stream.rate_hz), 0),
            settings: settings.clone(),
            position_noise: random::stream(seed, Purpose::PositionNoise, 0),
            channel_noise: random::stream(seed, Purpose::ChannelNoise, 0),
            orientation_noise: random::stream(seed, Purpose::OrientationNoise, 0),
            tick: 0,
            channel_sequence: 0,
            obstacle_sequence: 0,
            orientation_sequence: 0,
            late_ticks: 0,
            waiting: BTreeMap::new(),
            irs_gain: Vec::new(),
            sinr: Vec::new(),
        }
    }

    /// When the next sample is due, in local time.
    pub fn next_sample_ns(&self) -> u64 {
        let schedules = [self.positions, self.channel, self.obstacles, self.orientation];
        schedules.into_iter().filter_map(|schedule| schedule.next_ns()).min().unwrap_or(u64::MAX)
    }

    /// When the next report is released, in local time.
    pub fn next_release_ns(&self) -> u64 {
        self.waiting.first_key_value().map_or(u64::MAX, |(order, _)| order.release_ns)
    }

    /// Takes the samples that are due. The world must be up to date, with the mirrors at `angles`.
    pub fn sample(&mut self, now: Moment, world: &World, angles: &MirrorAngles) {
        // The tick number advances first: a channel report of the same instant has it too.
        let tick_due = self.positions.take(now.local_ns);
        if let Some(due) = tick_due {
            self.tick += 1;
            let tolerance_ns = LATE_NS.min(self.positions.period_ns() / 2);
            self.late_ticks += u64::from(now.local_ns - due.due_ns > tolerance_ns) + due.skipped;
        }
        if self.obstacles.take(now.local_ns).is_some() {
            self.obstacle_sequence += 1;
            let report = ObstacleReport {
                stamp: self.stamp(self.obstacle_sequence, now),
                obstacles: world.obstacles().iter().map(obstacle).collect(),
            };
            self.queue(now.local_ns, Report::Obstacles(report));
        }
        if self.orientation.take(now.local_ns).is_some()
            && let Some(stream) = &self.settings.orientation
        {
            let (release_ns, noise) = (now.local_ns + latency_ns(stream.latency_ms), stream.noise_deg.to_radians());
            let report = self.orientation_report(now, world, noise);
            self.queue(release_ns, Report::Orientation(report));
        }
        if self.channel.take(now.local_ns).is_some() {
            let report = self.channel_report(now, world, angles);
            let release_ns = now.local_ns + latency_ns(self.settings.channel.latency_ms);
            self.queue(release_ns, Report::Channel(report));
        }
        if tick_due.is_some() {
            let report = self.user_report(now, world);
            let release_ns = now.local_ns + latency_ns(self.settings.positions.latency_ms);
            self.queue(release_ns, Report::Users(report));
        }
    }

    /// The next report whose release time has come.
    pub fn release(&mut self, local_ns: u64) -> Option<Report> {
        self.waiting.first_entry().filter(|first| first.key().release_ns <= local_ns).map(|first| first.remove())
    }

    /// Number of the latest tick; ticks count from 1.
    pub fn tick(&self) -> u64 {
        self.tick
    }

    /// Delayed ticks: sampled after their due time, or skipped because the next one was already
    /// due.
    pub fn late_ticks(&self) -> u64 {
        self.late_ticks
    }

    fn user_report(&mut self, now: Moment, world: &World) -> UserReport {
        let (spread, velocity_spread) = (self.settings.positions.noise_m, self.settings.positions.velocity_noise_m_s);
        let stamp = self.stamp(self.tick, now);
        // Noise is drawn even where its size is 0, so that one noise does not change the others.
        let rng = &mut self.position_noise;
        let mut noisy = |value: f64, spread: f64| (value + spread * random::normal(rng)) as f32;
        let report = |((user, walker), min_rate): ((&u32, &Walker), &f64)| UserState {
            user: *user,
            position_m: [walker.position.x, walker.position.y, walker.position.z].map(|value| noisy(value, spread)),
            velocity_m_s: walker.velocity.map(|value| noisy(value, velocity_spread)),
            min_rate_bps: *min_rate as f32,
        };
        let users = world.ids().iter().zip(world.users()).zip(world.min_rate_bps()).map(report).collect();
        UserReport { stamp, tick: self.tick, users }
    }

    /// The orientations, each with a random rotation of this standard deviation in rad about each
    /// axis.
    fn orientation_report(&mut self, now: Moment, world: &World, noise: f64) -> OrientationReport {
        self.orientation_sequence += 1;
        let stamp = self.stamp(self.orientation_sequence, now);
        let rng = &mut self.orientation_noise;
        let mut measured = |held: &Orientation| {
            let error = Orientation::from_rotation_vector([0; 3].map(|_| noise * random::normal(rng)));
            held.then(&error).quaternion().map(|part| part as f32)
        };
        let users = world.ids().iter().zip(world.device_orientations());
        let users = users.map(|(user, held)| UserOrientation { user: *user, quaternion: measured(held) }).collect();
        OrientationReport { stamp, users }
    }

    fn channel_report(&mut self, now: Moment, world: &World, angles: &MirrorAngles) -> ChannelReport {
        self.channel_sequence += 1;
        let stamp = self.stamp(self.channel_sequence, now);
        self.irs_gain.resize(world.ids().len(), 0.0);
        self.sinr.resize(world.ids().len(), 0.0);
        world.scene().irs_gain(world.model(), angles, &mut self.irs_gain);
        world.scene().sinr(world.model(), angles, &mut self.sinr);
        let spread = self.settings.channel.noise_relative;
        let rng = &mut self.channel_noise;
        let mut factor = || (1.0 + spread * random::normal(rng)).max(0.0);
        let gains = world.scene().los_gain().iter().zip(&self.irs_gain).zip(&self.sinr).zip(world.ids());
        let users = gains.map(|(((los_gain, irs_gain), sinr), user)| {
            let (los_factor, irs_factor) = (factor(), factor());
            let (measured_los, measured_irs) = (los_gain * los_factor, irs_gain * irs_factor);
            let total = los_gain + irs_gain;
            // SINR is proportional to the square of the total gain.
            let sinr_factor = if total > 0.0 { ((measured_los + measured_irs) / total).powi(2) } else { 1.0 };
            UserChannel {
                user: *user,
                los_gain: measured_los as f32,
                irs_gain: measured_irs as f32,
                sinr: (sinr * sinr_factor) as f32,
            }
        });
        let users = users.collect();
        ChannelReport { stamp, tick: self.tick, users }
    }

    fn stamp(&self, sequence: u64, now: Moment) -> Stamp {
        Stamp { source: self.source, sequence, time_ns: now.room_ns }
    }

    fn queue(&mut self, release_ns: u64, report: Report) {
        let (rank, sequence) = match &report {
            Report::Obstacles(report) => (0, report.stamp.sequence),
            Report::Orientation(report) => (1, report.stamp.sequence),
            Report::Channel(report) => (2, report.stamp.sequence),
            Report::Users(report) => (3, report.stamp.sequence),
        };
        self.waiting.insert(ReleaseOrder { release_ns, rank, sequence }, report);
    }
}

/// A cylinder as a message of the contract.
pub fn obstacle(cylinder: &Cylinder) -> Obstacle {
    Obstacle {
        x_m: cylinder.x_m as f32,
        y_m: cylinder.y_m as f32,
        radius_m: cylinder.radius_m as f32,
        height_m: cylinder.height_m as f32,
    }
}

fn latency_ns(latency_ms: f64) -> u64 {
    (latency_ms * 1e6).round() as u64
}
