//! The reports of the room's trackers and receivers: each stream has its own rate, latency and
//! noise, and may lose reports.
//!
//! A sample is taken when it is due and released one latency later; its stamp has the time of the
//! sample. Reports that are released at the same instant are ordered: obstacles, orientations,
//! branches, LEDs, channel, positions, because the positions complete a tick.
//!
//! - [`schedule`]: when the samples of a stream are due.
//! - [`receiver`]: how a receiver measures a gain.
//! - [`losses`]: which reports are lost.

use std::collections::BTreeMap;

use heliostat_array::moment::Moment;
use heliostat_channel::{Cylinder, MirrorAngles, Orientation};
use heliostat_proto::{
    BranchReport, ChannelReport, LedGain, LedReport, Obstacle, ObstacleReport, OrientationReport, Stamp, UserBranches,
    UserChannel, UserLeds, UserOrientation, UserReport, UserState,
};
use heliostat_scenario::{LedIdentity, Streams};

use self::losses::Losses;
use self::receiver::Receivers;
use self::schedule::Schedule;
use crate::random::{self, Purpose, RoomRng};
use crate::world::World;
use crate::world::walker::Walker;

pub mod losses;
pub mod receiver;
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
    /// The channel gains of each branch of the users' receivers.
    Branches(BranchReport),
    /// Which LEDs the users' receivers detect.
    Leds(LedReport),
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
    receivers: Receivers,
    branch_receivers: Receivers,
    led_receivers: Receivers,
    position_losses: Losses,
    channel_losses: Losses,
    orientation_noise: RoomRng,
    tick: u64,
    channel_sequence: u64,
    obstacle_sequence: u64,
    orientation_sequence: u64,
    late_ticks: u64,
    waiting: BTreeMap<ReleaseOrder, Report>,
    irs_gain: Vec<f64>,
    irs_branch_gain: Vec<f64>,
    sinr: Vec<f64>,
}

impl Reports {
    /// The streams of a scenario; `source` is the id in every stamp.
    pub fn new(settings: &Streams, seed: u64, source: u64) -> Self {
        let (positions, channel) = (&settings.positions, &settings.channel);
        Self {
            source,
            positions: Schedule::new(positions.rate_hz, 0),
            channel: Schedule::new(channel.rate_hz, 0),
            obstacles: Schedule::new(settings.obstacles.rate_hz, 0),
            orientation: Schedule::new(settings.orientation.as_ref().map_or(0.0, |stream| stream.rate_hz), 0),
            settings: settings.clone(),
            position_noise: random::stream(seed, Purpose::PositionNoise, 0),
            receivers: Receivers::new(channel, seed, [Purpose::ChannelNoise, Purpose::ReceiverNoise]),
            branch_receivers: Receivers::new(channel, seed, [Purpose::BranchNoise, Purpose::BranchReceiverNoise]),
            led_receivers: Receivers::new(channel, seed, [Purpose::LedNoise, Purpose::LedReceiverNoise]),
            position_losses: Losses::new(positions.loss, positions.loss_burst_reports, seed, Purpose::PositionLoss),
            channel_losses: Losses::new(channel.loss, channel.loss_burst_reports, seed, Purpose::ChannelLoss),
            orientation_noise: random::stream(seed, Purpose::OrientationNoise, 0),
            tick: 0,
            channel_sequence: 0,
            obstacle_sequence: 0,
            orientation_sequence: 0,
            late_ticks: 0,
            waiting: BTreeMap::new(),
            irs_gain: Vec::new(),
            irs_branch_gain: Vec::new(),
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
        // The tick number advances first: a channel report of the same instant has it too. A lost
        // report is made all the same, so that losses do not change the noise of the others.
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
            let branches = self.settings.channel.branches.then(|| self.branch_report(report.stamp, world, angles));
            let leds = (!self.settings.channel.leds.is_none()).then(|| self.led_report(report.stamp, world));
            let release_ns = now.local_ns + latency_ns(self.settings.channel.latency_ms);
            if !self.channel_losses.next_is_lost() {
                branches.into_iter().for_each(|branches| self.queue(release_ns, Report::Branches(branches)));
                leds.into_iter().for_each(|leds| self.queue(release_ns, Report::Leds(leds)));
                self.queue(release_ns, Report::Channel(report));
            }
        }
        if tick_due.is_some() {
            let report = self.user_report(now, world);
            let release_ns = now.local_ns + latency_ns(self.settings.positions.latency_ms);
            if !self.position_losses.next_is_lost() {
                self.queue(release_ns, Report::Users(report));
            }
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
        let receivers = &mut self.receivers;
        let gains = world.scene().los_gain().iter().zip(&self.irs_gain).zip(&self.sinr).zip(world.ids());
        let users = gains.map(|(((los_gain, irs_gain), sinr), user)| {
            let (measured_los, measured_irs) = (receivers.measure(*los_gain), receivers.measure(*irs_gain));
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

    /// The gains of a channel report with this stamp, branch by branch. Each branch has a converter
    /// and noise of its own.
    fn branch_report(&mut self, stamp: Stamp, world: &World, angles: &MirrorAngles) -> BranchReport {
        let los_gain = world.scene().los_branch_gain();
        self.irs_branch_gain.resize(los_gain.len(), 0.0);
        world.scene().irs_branch_gain(world.model(), angles, &mut self.irs_branch_gain);
        let branches = world.model().receiver.branches.len();
        let receivers = &mut self.branch_receivers;
        let mut measured =
            |gains: &[f64]| gains.iter().map(|gain| receivers.measure(*gain) as f32).collect::<Vec<f32>>();
        let gains = los_gain.chunks_exact(branches).zip(self.irs_branch_gain.chunks_exact(branches));
        let users = world.ids().iter().zip(gains).map(|(user, (los_gain, irs_gain))| UserBranches {
            user: *user,
            los_gain: measured(los_gain),
            irs_gain: measured(irs_gain),
        });
        BranchReport { stamp, tick: self.tick, users: users.collect() }
    }

    /// The LEDs that the receivers detect at the time of a channel report with this stamp. Each LED is
    /// measured with noise of its own; a gain that can come from a blocked path is not detected.
    fn led_report(&mut self, stamp: Stamp, world: &World) -> LedReport {
        let (scene, model, settings) = (world.scene(), world.model(), &self.settings.channel);
        let measures_each = settings.leds == LedIdentity::Gains;
        let is_detected = |gain: f64| gain > settings.detectable_gain();
        let (mut users, mut gains) = (Vec::new(), Vec::new());
        for (index, user) in world.ids().iter().enumerate() {
            let serving = is_detected(scene.los_gain()[index]).then(|| scene.serving()[index] as u32);
            users.push(UserLeds { user: *user, serving, measures_each });
            let is_forced = world.forced()[index];
            for led in (0..model.leds.len()).filter(|_| measures_each) {
                let gain = if is_forced { 0.0 } else { scene.los_gain_by(model, world.blockers(), index, led) };
                let gain = self.led_receivers.measure(gain);
                if is_detected(gain) {
                    gains.push(LedGain { user: *user, led: led as u32, los_gain: gain as f32 });
                }
            }
        }
        LedReport { stamp, tick: self.tick, users, gains }
    }

    fn stamp(&self, sequence: u64, now: Moment) -> Stamp {
        Stamp { source: self.source, sequence, time_ns: now.room_ns }
    }

    fn queue(&mut self, release_ns: u64, report: Report) {
        let (rank, sequence) = match &report {
            Report::Obstacles(report) => (0, report.stamp.sequence),
            Report::Orientation(report) => (1, report.stamp.sequence),
            Report::Branches(report) => (2, report.stamp.sequence),
            Report::Leds(report) => (3, report.stamp.sequence),
            Report::Channel(report) => (4, report.stamp.sequence),
            Report::Users(report) => (5, report.stamp.sequence),
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
