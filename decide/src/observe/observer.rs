//! From reports to an observation: reported values are copied, the others are inferred.
//!
//! Bodies are inferred: a user stands behind the device, opposite to the direction of walking. A
//! user who has not walked yet has no body. Obstacles are those of the latest survey. Measured
//! gains of the direct path replace modelled gains, because they include blockage that no survey
//! reports.
//!
//! `control.belief` says where the users are while the command is in force: at their reported
//! positions (`none`), further on at their reported velocity (`constant-velocity`), or where a
//! filter of all reports predicts them (`filter`, [`belief`](crate::belief)). The prediction covers
//! the age of the report, the settling time of the mirrors, and half of the interval until the next
//! report. No user is predicted to leave the room.
//!
//! With the filter, a measured gain of the direct path shows only whether the path is clear; the
//! gain is then that of the model at the predicted place.

use heliostat_channel::{ChannelModel, Vec3, blockage::Cylinder};
use heliostat_proto::{ChannelReport, Nanos, UserReport, UserState};
use heliostat_scenario::{self as scenario, Scenario};

use crate::{
    belief::Belief,
    input::inbox::Inbox,
    observe::observation::{Observation, RoomState},
};

/// Below this speed in m/s a velocity does not show the direction that a user faces; half of the
/// slowest walk.
const WALKING_M_S: f64 = 0.05;

/// Dimensions of a body, and its distance from the device.
#[derive(Clone, Copy, Debug)]
struct Body {
    radius_m: f64,
    height_m: f64,
    offset_m: f64,
}

/// How far ahead users are predicted, and the bounds of their positions.
#[derive(Clone, Copy, Debug)]
struct Lead {
    /// Half of the time between reports in s.
    half_interval_s: f64,
    /// Settling time of the mirrors in s.
    settling_s: f64,
    half_room_m: [f64; 2],
}

impl Lead {
    fn new(scenario: &Scenario) -> Self {
        Self {
            half_interval_s: 0.5 / scenario.streams.positions.rate_hz,
            settling_s: 0.0,
            half_room_m: [scenario.room.length_x_m / 2.0, scenario.room.length_y_m / 2.0],
        }
    }

    /// From the sampling of a report of this age to the middle of the command's time in force, in s.
    fn ahead_s(&self, age_s: f64) -> f64 {
        age_s + self.half_interval_s + self.settling_s
    }

    fn within_room(&self, position: Vec3) -> Vec3 {
        let [half_x, half_y] = self.half_room_m;
        Vec3::new(position.x.clamp(-half_x, half_x), position.y.clamp(-half_y, half_y), position.z)
    }
}

/// How users are predicted.
enum Motion {
    /// At their reported positions.
    AsReported,
    /// At their reported velocities.
    ConstantVelocity(Lead),
    /// By the filter.
    Filter(Lead, Box<Belief>),
}

impl Motion {
    /// Position and velocity of the user at this index of a report of this age.
    fn predict(&self, index: usize, user: &UserState, age_s: f64) -> (Vec3, Vec3) {
        let reported = Vec3::from_iterator(user.position_m.map(f64::from));
        let [x, y] = user.velocity_m_s.map(f64::from);
        let velocity = Vec3::new(x, y, 0.0);
        match self {
            Self::AsReported => (reported, velocity),
            Self::ConstantVelocity(lead) => (lead.within_room(reported + velocity * lead.ahead_s(age_s)), velocity),
            Self::Filter(lead, belief) => match belief.estimate(index, lead.ahead_s(age_s)) {
                Some(estimate) => (lead.within_room(estimate.position), estimate.velocity),
                None => (reported, velocity),
            },
        }
    }
}

/// Fills observations from the inbox; its buffers are reused.
pub struct Observer {
    body: Option<Body>,
    motion: Motion,
    ids: Vec<u32>,
    /// Unit vectors in the floor plane; zero while unknown.
    headings: Vec<Vec3>,
    positions: Vec<Vec3>,
    velocities: Vec<Vec3>,
    min_rate_bps: Vec<f64>,
    measured_los_gain: Vec<f64>,
    blockers: Vec<Cylinder>,
    /// All false: blockage of unknown cause shows in measured gains.
    forced: Vec<bool>,
}

/// Where the gains of the direct paths came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LosSource {
    /// A channel report.
    Measured,
    /// The model, because there is no channel report of acceptable age.
    Modelled,
}

impl Observer {
    /// An observer of a scenario's users.
    pub fn new(scenario: &Scenario) -> Self {
        let users = scenario.users.count;
        let blockage = &scenario.blockage;
        Self {
            body: blockage.bodies.then_some(Body {
                radius_m: blockage.body_radius_m,
                height_m: blockage.body_height_m,
                offset_m: blockage.body_offset_m,
            }),
            motion: match scenario.control.belief {
                scenario::Belief::None => Motion::AsReported,
                scenario::Belief::ConstantVelocity => Motion::ConstantVelocity(Lead::new(scenario)),
                scenario::Belief::Filter => Motion::Filter(Lead::new(scenario), Box::new(Belief::new(scenario, users))),
            },
            ids: vec![0; users],
            headings: vec![Vec3::zeros(); users],
            positions: vec![Vec3::zeros(); users],
            velocities: vec![Vec3::zeros(); users],
            min_rate_bps: vec![0.0; users],
            measured_los_gain: vec![0.0; users],
            blockers: Vec::new(),
            forced: vec![false; users],
        }
    }

    /// Extends the prediction by the settling time of the mirrors, in s, where users are predicted.
    pub fn set_settling(&mut self, settling_s: f64) {
        match &mut self.motion {
            Motion::AsReported => {}
            Motion::ConstantVelocity(lead) | Motion::Filter(lead, _) => lead.settling_s = settling_s,
        }
    }

    /// Takes an accepted position report. Call it once for each, before [`observe`](Self::observe).
    pub fn handle_users(&mut self, report: &UserReport) {
        if let Motion::Filter(_, belief) = &mut self.motion {
            belief.handle_users(report);
        }
    }

    /// The belief of the filter; absent where `control.belief` is another one.
    pub fn belief(&self) -> Option<&Belief> {
        match &self.motion {
            Motion::Filter(_, belief) => Some(belief),
            Motion::AsReported | Motion::ConstantVelocity(_) => None,
        }
    }

    /// Forgets the users: another source reports from now on.
    pub fn forget(&mut self) {
        if let Motion::Filter(_, belief) = &mut self.motion {
            belief.forget();
        }
        self.headings.fill(Vec3::zeros());
    }

    /// Fills an observation from the latest reports at `now`; `None` without a position report.
    ///
    /// Does not allocate after an observation with the same number of obstacles.
    pub fn observe(
        &mut self,
        model: &ChannelModel,
        inbox: &Inbox,
        now: Nanos,
        into: &mut Observation,
    ) -> Option<LosSource> {
        let report = inbox.users()?;
        let age_s = now.saturating_sub(report.stamp.time_ns) as f64 * 1e-9;
        for (index, user) in report.users.iter().enumerate() {
            if self.ids[index] != user.user {
                self.ids[index] = user.user;
                self.headings[index] = Vec3::zeros();
            }
            let (position, velocity) = self.motion.predict(index, user, age_s);
            (self.positions[index], self.velocities[index]) = (position, velocity);
            self.min_rate_bps[index] = f64::from(user.min_rate_bps);
        }
        self.place_blockers(inbox);
        let filters = matches!(self.motion, Motion::Filter(..));
        let measured = inbox.channel(now).is_some_and(|channel| self.take_gains(report, channel));
        into.set_state(
            model,
            &RoomState {
                tick: report.tick,
                positions: &self.positions,
                velocities: &self.velocities,
                min_rate_bps: &self.min_rate_bps,
                blockers: &self.blockers,
                forced: &self.forced,
                measured_los_gain: (measured && !filters).then_some(self.measured_los_gain.as_slice()),
            },
        );
        if measured && filters {
            for (user, gain) in self.measured_los_gain.iter().enumerate() {
                into.scene.set_los_blocked(user, *gain <= 0.0);
            }
        }
        Some(if measured { LosSource::Measured } else { LosSource::Modelled })
    }

    /// Copies each user's measured gain; false where a user is missing from the channel report.
    fn take_gains(&mut self, users: &UserReport, channel: &ChannelReport) -> bool {
        let gain_of = |(slot, user): (usize, &UserState)| {
            let same_place = channel.users.get(slot).filter(|entry| entry.user == user.user);
            let entry = same_place.or_else(|| channel.users.iter().find(|entry| entry.user == user.user))?;
            Some(f64::from(entry.los_gain))
        };
        let gains = users.users.iter().enumerate().map(gain_of);
        self.measured_los_gain.iter_mut().zip(gains).all(|(place, gain)| {
            *place = gain.unwrap_or(0.0);
            gain.is_some()
        })
    }

    fn place_blockers(&mut self, inbox: &Inbox) {
        self.blockers.clear();
        let obstacles = inbox.obstacles().into_iter().flat_map(|report| &report.obstacles);
        self.blockers.extend(obstacles.map(|obstacle| Cylinder {
            x_m: f64::from(obstacle.x_m),
            y_m: f64::from(obstacle.y_m),
            radius_m: f64::from(obstacle.radius_m),
            height_m: f64::from(obstacle.height_m),
        }));
        let Some(body) = self.body else { return };
        for ((heading, velocity), position) in self.headings.iter_mut().zip(&self.velocities).zip(&self.positions) {
            if velocity.norm() > WALKING_M_S {
                *heading = velocity.normalize();
            }
            if *heading != Vec3::zeros() {
                let axis = position - body.offset_m * *heading;
                let Body { radius_m, height_m, .. } = body;
                self.blockers.push(Cylinder { x_m: axis.x, y_m: axis.y, radius_m, height_m });
            }
        }
    }
}
