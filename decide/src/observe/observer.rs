//! From reports to an observation: reported values are copied, the others are inferred.
//!
//! Bodies are inferred: a user stands behind the device, opposite to the direction of walking. A
//! user who has not walked yet has no body. Obstacles are those of the latest survey. Measured
//! gains of the direct path replace modelled gains, because they include blockage that no survey
//! reports.
//!
//! With `control.prediction = "constant-velocity"` each user is assumed to walk on at the reported
//! velocity. The prediction covers the age of the report and half of the interval until the next
//! report, during which the command holds. No user is predicted to leave the room.

use heliostat_channel::{ChannelModel, Vec3, blockage::Cylinder};
use heliostat_proto::{ChannelReport, Nanos, UserReport, UserState};
use heliostat_scenario::{Prediction, Scenario};

use crate::{
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
    fn of(scenario: &Scenario) -> Option<Self> {
        match scenario.control.prediction {
            Prediction::None => None,
            Prediction::ConstantVelocity => Some(Self {
                half_interval_s: 0.5 / scenario.streams.positions.rate_hz,
                settling_s: 0.0,
                half_room_m: [scenario.room.length_x_m / 2.0, scenario.room.length_y_m / 2.0],
            }),
        }
    }

    /// The position of a user who walks on.
    fn predict(&self, position: Vec3, velocity: &Vec3, age_s: f64) -> Vec3 {
        let ahead = position + velocity * (age_s + self.half_interval_s + self.settling_s);
        let [half_x, half_y] = self.half_room_m;
        Vec3::new(ahead.x.clamp(-half_x, half_x), ahead.y.clamp(-half_y, half_y), ahead.z)
    }
}

/// Fills observations from the inbox; its buffers are reused.
pub struct Observer {
    body: Option<Body>,
    lead: Option<Lead>,
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
            lead: Lead::of(scenario),
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
        if let Some(lead) = &mut self.lead {
            lead.settling_s = settling_s;
        }
    }

    /// Discards the directions that the users face.
    pub fn forget(&mut self) {
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
            let [x, y] = user.velocity_m_s.map(f64::from);
            if self.ids[index] != user.user {
                self.ids[index] = user.user;
                self.headings[index] = Vec3::zeros();
            }
            self.velocities[index] = Vec3::new(x, y, 0.0);
            let reported = Vec3::from_iterator(user.position_m.map(f64::from));
            let predicted = |lead: Lead| lead.predict(reported, &self.velocities[index], age_s);
            self.positions[index] = self.lead.map_or(reported, predicted);
            self.min_rate_bps[index] = f64::from(user.min_rate_bps);
        }
        self.place_blockers(inbox);
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
                measured_los_gain: measured.then_some(self.measured_los_gain.as_slice()),
            },
        );
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
