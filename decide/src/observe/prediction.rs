//! Where a user is while a command is in force, by `control.belief`.

use heliostat_channel::Vec3;
use heliostat_proto::{MAX_USERS, UserReport, UserState};
use heliostat_scenario::{self as scenario, Scenario};
use serde::{Deserialize, Serialize};

use crate::belief::{Belief, Estimate, memory::BeliefMemory};

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

/// A settling time in a recorded state above this, in s, is of no array.
const SETTLING_MAX_S: f64 = 1e3;

/// The state of a prediction, as a recording holds it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PredictionMemory {
    settling_s: f64,
    belief: Option<BeliefMemory>,
}

/// The prediction of all users of a room.
pub enum Prediction {
    /// At their reported positions.
    AsReported,
    /// At their reported velocities.
    ConstantVelocity(Lead),
    /// By a filter of all reports.
    Filter(Lead, Box<Belief>),
}

impl Prediction {
    /// The prediction that the scenario names.
    pub fn new(scenario: &Scenario) -> Self {
        match scenario.control.belief {
            scenario::Belief::None => Self::AsReported,
            scenario::Belief::ConstantVelocity => Self::ConstantVelocity(Lead::new(scenario)),
            scenario::Belief::Filter => Self::Filter(Lead::new(scenario), Box::new(Belief::new(scenario, MAX_USERS))),
        }
    }

    /// Extends the prediction by the settling time of the mirrors in s.
    pub fn set_settling(&mut self, settling_s: f64) {
        match self {
            Self::AsReported => {}
            Self::ConstantVelocity(lead) | Self::Filter(lead, _) => lead.settling_s = settling_s,
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
            Self::AsReported | Self::ConstantVelocity(_) => None,
        }
    }

    /// The present state.
    pub fn memory(&self) -> PredictionMemory {
        let settling_s = match self {
            Self::AsReported => 0.0,
            Self::ConstantVelocity(lead) | Self::Filter(lead, _) => lead.settling_s,
        };
        PredictionMemory { settling_s, belief: self.belief().map(Belief::memory) }
    }

    /// Replaces the state; false where it is not one of this scenario.
    pub fn restore(&mut self, memory: &PredictionMemory) -> bool {
        if !(0.0..=SETTLING_MAX_S).contains(&memory.settling_s) {
            return false;
        }
        self.set_settling(memory.settling_s);
        match (self, &memory.belief) {
            (Self::Filter(_, belief), Some(memory)) => belief.restore(memory),
            (Self::AsReported | Self::ConstantVelocity(_), None) => true,
            _ => false,
        }
    }

    /// From the sampling of a report of this age to the time for which the belief holds, in s;
    /// absent without a belief.
    pub fn ahead_s(&self, age_s: f64) -> Option<f64> {
        match self {
            Self::Filter(lead, _) => Some(lead.ahead_s(age_s)),
            Self::AsReported | Self::ConstantVelocity(_) => None,
        }
    }

    /// The belief about a user of the last report, which has this age in s, within the room.
    pub fn estimate(&self, user: u32, age_s: f64) -> Option<Estimate> {
        let Self::Filter(lead, belief) = self else { return None };
        let estimate = belief.estimate(user, lead.ahead_s(age_s))?;
        Some(Estimate { position: lead.within_room(estimate.position), ..estimate })
    }

    /// Position in m and velocity in m/s of a user of the last report, which has this age in s.
    pub fn predict(&self, user: &UserState, age_s: f64) -> (Vec3, Vec3) {
        let reported = Vec3::from_iterator(user.position_m.map(f64::from));
        let [x, y] = user.velocity_m_s.map(f64::from);
        let velocity = Vec3::new(x, y, 0.0);
        match self {
            Self::AsReported => (reported, velocity),
            Self::ConstantVelocity(lead) => (lead.within_room(reported + velocity * lead.ahead_s(age_s)), velocity),
            Self::Filter(..) => match self.estimate(user.user, age_s) {
                Some(estimate) => (estimate.position, estimate.velocity),
                None => (reported, velocity),
            },
        }
    }
}
