//! The tracker: users walk, come and go; their positions, gains, orientations and LEDs are reported at a fixed
//! rate, and obstacles less often.

use heliostat_proto::{
    ChannelReport, LedGain, LedReport, Obstacle, ObstacleReport, OrientationReport, Stamp, UserChannel, UserLeds,
    UserOrientation, UserReport, UserState,
};
use rand::RngExt;

use super::calibration::HOLDER;
use super::{Context, encoded};
use crate::plan::{OptionalReports, Setup};
use crate::random::Rng;
use crate::topic::Topic;

/// Numbers of the users who may be present.
const USERS: u32 = 3;

/// Position reports for one report of obstacles.
const OBSTACLES_EVERY: u64 = 10;

/// A process of a tracker.
pub(crate) struct Tracker {
    source: u64,
    interval_ns: u64,
    has_channel: bool,
    reports: OptionalReports,
    /// How many faults keep the receivers silent.
    pub silent: u32,
    /// How many calibrations the holder of the receiver stands still for.
    pub standing: u32,
    /// Ticks in which the holder walked.
    walked: u64,
    due_ns: u64,
    tick: u64,
    present: Vec<u32>,
    rng: Rng,
}

impl Tracker {
    pub fn start(source: u64, interval_ns: u64, setup: &Setup, rng: Rng, ctx: &Context<'_>) -> Self {
        let (due_ns, present) = (ctx.at.local_ns, vec![0, 1]);
        let Setup { has_channel, reports, .. } = *setup;
        Self {
            source,
            interval_ns,
            has_channel,
            reports,
            silent: 0,
            standing: 0,
            walked: 0,
            due_ns,
            tick: 0,
            present,
            rng,
        }
    }

    pub fn next_ns(&self) -> u64 {
        self.due_ns
    }

    /// Reports the users if that is due; a tracker that was frozen leaves out what is past.
    pub fn wake(&mut self, ctx: &mut Context<'_>) {
        if ctx.at.local_ns < self.due_ns {
            return;
        }
        let late = (ctx.at.local_ns - self.due_ns) / self.interval_ns;
        self.due_ns += (1 + late) * self.interval_ns;
        self.tick += 1;
        self.walked += u64::from(self.standing == 0);
        if self.rng.random_bool(0.01) {
            self.change_users();
        }
        let stamp = Stamp { source: self.source, sequence: self.tick, time_ns: ctx.at.room_ns };
        self.publish_optional(stamp, ctx);
        if self.has_channel && self.silent == 0 {
            let measured = |user: &u32| UserChannel { user: *user, los_gain: 1e-6, irs_gain: 1e-7, sinr: 40.0 };
            let users = self.present.iter().map(measured).collect();
            ctx.publish(Topic::Channel, encoded(&ChannelReport { stamp, tick: self.tick, users }));
        }
        let users = self.present.iter().map(|user| self.walker(*user)).collect();
        ctx.publish(Topic::Users, encoded(&UserReport { stamp, tick: self.tick, users }));
    }

    /// What comes before the gains and positions of a tick.
    fn publish_optional(&self, stamp: Stamp, ctx: &mut Context<'_>) {
        if self.reports.obstacles && self.tick % OBSTACLES_EVERY == 1 {
            let x_m = (0.01 * self.tick as f64).sin() as f32;
            let obstacles = vec![Obstacle { x_m, y_m: 0.5, radius_m: 0.25, height_m: 1.75 }];
            ctx.publish(Topic::Obstacles, encoded(&ObstacleReport { stamp, obstacles }));
        }
        if self.reports.orientation {
            let held = |user: &u32| {
                let (sin, cos) = (0.1 + 0.05 * *user as f32).sin_cos();
                UserOrientation { user: *user, quaternion: [cos, sin, 0.0, 0.0] }
            };
            let users = self.present.iter().map(held).collect();
            ctx.publish(Topic::Orientation, encoded(&OrientationReport { stamp, users }));
        }
        if self.reports.leds && self.silent == 0 {
            let identified = |user: &u32| UserLeds { user: *user, serving: Some(0), measures_each: true };
            let gain = |user: &u32| LedGain { user: *user, led: 0, los_gain: 1e-6 };
            let (users, gains) =
                (self.present.iter().map(identified).collect(), self.present.iter().map(gain).collect());
            ctx.publish(Topic::Leds, encoded(&LedReport { stamp, tick: self.tick, users, gains }));
        }
    }

    fn change_users(&mut self) {
        let user = self.rng.random_range(0..USERS);
        match self.present.iter().position(|known| *known == user) {
            Some(index) => drop(self.present.remove(index)),
            None => self.present.push(user),
        }
    }

    fn walker(&self, user: u32) -> UserState {
        let steps = if user == HOLDER { self.walked } else { self.tick };
        let (sin, cos) = (2.0 * f64::from(user) + 0.02 * steps as f64).sin_cos();
        UserState {
            user,
            position_m: [(1.4 * cos) as f32, (1.1 * sin) as f32, 0.85],
            velocity_m_s: [(-1.4 * sin) as f32, (1.1 * cos) as f32],
            min_rate_bps: 1e6,
        }
    }
}
