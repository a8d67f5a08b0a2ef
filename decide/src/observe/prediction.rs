//! Where a user is while a command is in force, by `control.belief`.

use heliostat_channel::Vec3;
use heliostat_proto::{MAX_USERS, UserReport, UserState};
use heliostat_scenario::{self as scenario, Scenario};

use crate::belief::Belief;

/// How far ahead users are predicted, and the bounds of their positions.
#[derive(Clone, Copy, Debug)]
pub struct Lead {
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

/// The prediction of all users of a room.
pub enum Prediction {
    /// At their reported positions, whatever the lead.
    AsReported(Lead),
    /// At their reported velocities.
    ConstantVelocity(Lead),
    /// By a filter of all reports.
    Filter(Lead, Box<Belief>),
}

impl Prediction {
    /// The prediction that the scenario names.
    pub fn new(scenario: &Scenario) -> Self {
        match scenario.control.belief {
            scenario::Belief::None => Self::AsReported(Lead::new(scenario)),
            scenario::Belief::ConstantVelocity => Self::ConstantVelocity(Lead::new(scenario)),
            scenario::Belief::Filter => Self::Filter(Lead::new(scenario), Box::new(Belief::new(scenario, MAX_USERS))),
        }
    }

    /// Extends the prediction by the settling time of the mirrors in s.
    pub fn set_settling(&mut self, settling_s: f64) {
        match self {
            Self::AsReported(lead) | Self::ConstantVelocity(lead) | Self::Filter(lead, _) => {
                lead.settling_s = settling_s;
            }
        }
    }

    /// From a decision to the middle of its command's time in force, in s.
    pub fn lead_s(&self) -> f64 {
        match self {
            Self::AsReported(lead) | Self::ConstantVelocity(lead) | Self::Filter(lead, _) => lead.ahead_s(0.0),
        }
    }

    /// Takes an accepted position report.
    pub fn handle_users(&mut self, report: &UserReport) {
        if let Self::Filter(_, belief) = self {
            belief.handle_users(report);
        }
    }

    /// Forgets the users.
    pub fn forget(&mut self) {
        if let Self::Filter(_, belief) = self {
            belief.forget();
        }
    }

    /// Whether the predicted position is better than the one at which a gain was measured: then a
    /// measured gain shows only whether the path is clear.
    pub fn models_gains(&self) -> bool {
        matches!(self, Self::Filter(..))
    }

    /// The belief of the filter; absent where `control.belief` is another one.
    pub fn belief(&self) -> Option<&Belief> {
        match self {
            Self::Filter(_, belief) => Some(belief),
            Self::AsReported(_) | Self::ConstantVelocity(_) => None,
        }
    }

    /// Position in m and velocity in m/s of a user of the last report, which has this age in s.
    pub fn predict(&self, user: &UserState, age_s: f64) -> (Vec3, Vec3) {
        let reported = Vec3::from_iterator(user.position_m.map(f64::from));
        let [x, y] = user.velocity_m_s.map(f64::from);
        let velocity = Vec3::new(x, y, 0.0);
        match self {
            Self::AsReported(_) => (reported, velocity),
            Self::ConstantVelocity(lead) => (lead.within_room(reported + velocity * lead.ahead_s(age_s)), velocity),
            Self::Filter(lead, belief) => match belief.estimate(user.user, lead.ahead_s(age_s)) {
                Some(estimate) => (lead.within_room(estimate.position), estimate.velocity),
                None => (reported, velocity),
            },
        }
    }
}
