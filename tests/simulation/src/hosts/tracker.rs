//! The tracker: users walk, come and go; their positions and gains are reported at a fixed rate.

use heliostat_proto::{ChannelReport, Stamp, UserChannel, UserReport, UserState};
use rand::RngExt;

use super::{Context, encoded};
use crate::random::Rng;
use crate::topic::Topic;

/// Numbers of the users who may be present.
const USERS: u32 = 3;

/// A process of a tracker.
pub(crate) struct Tracker {
    source: u64,
    interval_ns: u64,
    has_channel: bool,
    /// How many faults keep the receivers silent.
    pub silent: u32,
    due_ns: u64,
    tick: u64,
    present: Vec<u32>,
    rng: Rng,
}

impl Tracker {
    pub fn start(source: u64, interval_ns: u64, has_channel: bool, rng: Rng, ctx: &Context<'_>) -> Self {
        let due_ns = ctx.at.local_ns;
        Self { source, interval_ns, has_channel, silent: 0, due_ns, tick: 0, present: vec![0, 1], rng }
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
        if self.rng.random_bool(0.01) {
            self.change_users();
        }
        let stamp = Stamp { source: self.source, sequence: self.tick, time_ns: ctx.at.room_ns };
        if self.has_channel && self.silent == 0 {
            let measured = |user: &u32| UserChannel { user: *user, los_gain: 1e-6, irs_gain: 1e-7, sinr: 40.0 };
            let users = self.present.iter().map(measured).collect();
            ctx.publish(Topic::Channel, encoded(&ChannelReport { stamp, tick: self.tick, users }));
        }
        let users = self.present.iter().map(|user| self.walker(*user)).collect();
        ctx.publish(Topic::Users, encoded(&UserReport { stamp, tick: self.tick, users }));
    }

    fn change_users(&mut self) {
        let user = self.rng.random_range(0..USERS);
        match self.present.iter().position(|known| *known == user) {
            Some(index) => drop(self.present.remove(index)),
            None => self.present.push(user),
        }
    }

    fn walker(&self, user: u32) -> UserState {
        let (sin, cos) = (2.0 * f64::from(user) + 0.02 * self.tick as f64).sin_cos();
        UserState {
            user,
            position_m: [(1.4 * cos) as f32, (1.1 * sin) as f32, 0.85],
            velocity_m_s: [(-1.4 * sin) as f32, (1.1 * cos) as f32],
            min_rate_bps: 1e6,
        }
    }
}
