//! Reports for benchmarks: users who walk in circles around two pillars, half of them without a
//! direct path.

use heliostat_proto::{ChannelReport, Nanos, Obstacle, ObstacleReport, Stamp, UserChannel, UserReport, UserState};

/// Angle around the circle from one report to the next, in rad.
const STEP: f64 = 0.01;

/// The reports of one tick; their memory is reused.
#[derive(Default)]
pub struct Walkers {
    /// Positions.
    pub users: UserReport,
    /// Measured gains.
    pub channel: ChannelReport,
    /// The pillars.
    pub obstacles: ObstacleReport,
}

impl Walkers {
    /// Moves all users by one step.
    pub fn walk(&mut self, source: u64, tick: u64, now: Nanos, users: usize) {
        let stamp = Stamp { source, sequence: tick, time_ns: now };
        let pillar = |x_m: f32, y_m: f32| Obstacle { x_m, y_m, radius_m: 0.25, height_m: 1.75 };
        self.obstacles.stamp = stamp;
        self.obstacles.obstacles.clear();
        self.obstacles.obstacles.extend([pillar(1.2, 0.8), pillar(-1.0, -0.6)]);
        (self.users.stamp, self.users.tick) = (stamp, tick);
        self.users.users.clear();
        self.users.users.extend((0..users).map(|user| walker(user, users, tick)));
        let gain = |user: usize| if user.is_multiple_of(2) { 0.0 } else { 8e-7 };
        let measured = |user: usize| UserChannel { user: user as u32, los_gain: gain(user), irs_gain: 0.0, sinr: 0.0 };
        (self.channel.stamp, self.channel.tick) = (stamp, tick);
        self.channel.users.clear();
        self.channel.users.extend((0..users).map(measured));
    }
}

fn walker(user: usize, users: usize, tick: u64) -> UserState {
    let turn = std::f64::consts::TAU * user as f64 / users as f64 + STEP * tick as f64;
    let (sin, cos) = turn.sin_cos();
    UserState {
        user: user as u32,
        position_m: [(1.8 * cos) as f32, (1.4 * sin) as f32, 0.85],
        velocity_m_s: [(-1.8 * sin) as f32, (1.4 * cos) as f32],
        min_rate_bps: 1e6,
    }
}
