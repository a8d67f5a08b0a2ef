//! Where a user is while a command is in force, by `control.belief`.

use heliostat_channel::{ChannelModel, Orientation, Vec3, blockage::Cylinder};
use heliostat_proto::{
    ChannelReport, LedReport, MAX_USERS, MirrorCommand, Nanos, OrientationReport, UserReport, UserState,
};
use heliostat_scenario::{self as scenario, Scenario};
use serde::{Deserialize, Serialize};

use crate::belief::{
    Belief, Estimate,
    memory::{BeliefMemory, LaterMemories},
};

/// Weight of a new interval in the mean time between reports.
const INTERVAL_WEIGHT: f64 = 0.1;

/// A longer interval counts as this many mean ones, so that a pause changes the mean little.
const PAUSE: f64 = 3.0;

/// How far ahead users are predicted, and the bounds of their positions.
#[derive(Clone, Copy, Debug)]
pub struct Lead {
    /// Mean time between reports in s: that of the scenario until reports show another.
    interval_s: f64,
    /// Time of the last report.
    last_ns: Nanos,
    /// Settling time of the mirrors in s.
    settling_s: f64,
    half_room_m: [f64; 2],
}

impl Lead {
    fn new(scenario: &Scenario) -> Self {
        Self {
            interval_s: 1.0 / scenario.streams.positions.rate_hz,
            last_ns: 0,
            settling_s: 0.0,
            half_room_m: [scenario.room.length_x_m / 2.0, scenario.room.length_y_m / 2.0],
        }
    }

    /// From the sampling of a report of this age to the middle of the command's time in force, in
    /// s.
    fn ahead_s(&self, age_s: f64) -> f64 {
        age_s + 0.5 * self.interval_s + self.settling_s
    }

    /// Learns the time between reports.
    fn handle_users(&mut self, time_ns: Nanos) {
        let interval_s = time_ns.saturating_sub(self.last_ns) as f64 * 1e-9;
        if self.last_ns > 0 {
            self.interval_s += INTERVAL_WEIGHT * (interval_s.min(PAUSE * self.interval_s) - self.interval_s);
        }
        self.last_ns = time_ns;
    }

    fn within_room(&self, position: Vec3) -> Vec3 {
        let [half_x, half_y] = self.half_room_m;
        Vec3::new(position.x.clamp(-half_x, half_x), position.y.clamp(-half_y, half_y), position.z)
    }
}

/// A user while a command is in force.
#[derive(Clone, Copy, Debug)]
pub struct Predicted {
    /// Position in m.
    pub position: Vec3,
    /// Velocity in m/s.
    pub velocity: Vec3,
    /// What a filter believes besides.
    pub estimate: Option<Estimate>,
}

/// A settling time or an interval in a recorded state above this, in s, is of no room.
const TIME_MAX_S: f64 = 1e6;

/// The state of a prediction, as a recording holds it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PredictionMemory {
    settling_s: f64,
    interval_s: f64,
    last_ns: Nanos,
    belief: Option<BeliefMemory>,
}

/// How users are predicted.
#[derive(Clone)]
enum Method {
    /// At their reported positions.
    AsReported,
    /// At their reported velocities.
    ConstantVelocity,
    /// By a filter of all reports.
    Filter(Box<Belief>),
}

/// The prediction of all users of a room.
#[derive(Clone)]
pub struct Prediction {
    lead: Lead,
    method: Method,
}

impl Prediction {
    /// The prediction that the scenario names.
    pub fn new(scenario: &Scenario, model: &ChannelModel) -> Self {
        let method = match scenario.control.belief {
            scenario::Belief::None => Method::AsReported,
            scenario::Belief::ConstantVelocity => Method::ConstantVelocity,
            scenario::Belief::Filter => Method::Filter(Box::new(Belief::new(scenario, model, MAX_USERS))),
        };
        Self { lead: Lead::new(scenario), method }
    }

    /// Extends the prediction by the settling time of the mirrors in s.
    pub fn set_settling(&mut self, settling_s: f64) {
        self.lead.settling_s = settling_s;
        if let Method::Filter(belief) = &mut self.method {
            belief.set_settling(settling_s);
        }
    }

    /// From a decision to the middle of its command's time in force, in s.
    pub fn lead_s(&self) -> f64 {
        self.lead.ahead_s(0.0)
    }

    /// Takes an accepted channel report; see [`Belief::handle_channel`].
    pub fn handle_channel(
        &mut self,
        model: &ChannelModel,
        report: &ChannelReport,
        leds: Option<&LedReport>,
        obstacles: &[Cylinder],
        unusable: &[u32],
    ) {
        if let Method::Filter(belief) = &mut self.method {
            belief.handle_channel(model, report, leds, obstacles, unusable);
        }
    }

    /// Takes an accepted orientation report.
    pub fn handle_orientation(&mut self, report: &OrientationReport) {
        if let Method::Filter(belief) = &mut self.method {
            belief.handle_orientation(report);
        }
    }

    /// Notes a command that was given.
    pub fn handle_command(&mut self, command: &MirrorCommand) {
        if let Method::Filter(belief) = &mut self.method {
            belief.handle_command(command);
        }
    }

    /// Takes an accepted position report.
    pub fn handle_users(&mut self, report: &UserReport) {
        self.lead.handle_users(report.stamp.time_ns);
        if let Method::Filter(belief) = &mut self.method {
            belief.handle_users(report);
        }
    }

    /// Forgets the users, since another source reports from now on. The time since its predecessor's
    /// last report is no interval between reports.
    pub fn forget(&mut self) {
        self.lead.last_ns = 0;
        if let Method::Filter(belief) = &mut self.method {
            belief.forget();
        }
    }

    /// The belief of the filter; absent where `control.belief` is another one.
    pub fn belief(&self) -> Option<&Belief> {
        match &self.method {
            Method::Filter(belief) => Some(belief),
            Method::AsReported | Method::ConstantVelocity => None,
        }
    }

    /// The present state.
    pub fn memory(&self) -> PredictionMemory {
        let Lead { settling_s, interval_s, last_ns, .. } = self.lead;
        PredictionMemory { settling_s, interval_s, last_ns, belief: self.belief().map(Belief::memory) }
    }

    /// Replaces the state; false where it is not one of this scenario.
    pub fn restore(&mut self, memory: &PredictionMemory, later: LaterMemories<'_>) -> bool {
        let PredictionMemory { settling_s, interval_s, last_ns, belief } = memory;
        if ![settling_s, interval_s].iter().all(|time_s| (0.0..=TIME_MAX_S).contains(*time_s)) {
            return false;
        }
        self.set_settling(*settling_s);
        self.lead = Lead { interval_s: *interval_s, last_ns: *last_ns, ..self.lead };
        match (&mut self.method, belief) {
            (Method::Filter(belief), Some(memory)) => belief.restore(memory, later),
            (Method::AsReported | Method::ConstantVelocity, None) => true,
            _ => false,
        }
    }

    /// From the sampling of a report of this age to the time for which the belief holds, in s;
    /// absent without a belief.
    pub fn ahead_s(&self, age_s: f64) -> Option<f64> {
        self.belief().map(|_| self.lead.ahead_s(age_s))
    }

    /// The belief about a user of the last report, which has this age in s, within the room.
    pub fn estimate(&self, user: u32, age_s: f64) -> Option<Estimate> {
        let estimate = self.belief()?.estimate(user, self.lead.ahead_s(age_s))?;
        Some(Estimate { position: self.lead.within_room(estimate.position), ..estimate })
    }

    /// How a user with this heading and speed holds the receiver, by the last report, which has
    /// this age in s; `None` without a belief. See [`Belief::orientation`].
    pub fn orientation(&self, user: u32, age_s: f64, motion: (&Vec3, f64)) -> Option<Orientation> {
        Some(self.belief()?.orientation(user, self.lead.ahead_s(age_s), motion))
    }

    /// A user of the last report, which has this age in s.
    pub fn predict(&self, user: &UserState, age_s: f64) -> Predicted {
        let position = Vec3::from_iterator(user.position_m.map(f64::from));
        let [x, y] = user.velocity_m_s.map(f64::from);
        let velocity = Vec3::new(x, y, 0.0);
        let as_reported = Predicted { position, velocity, estimate: None };
        match &self.method {
            Method::AsReported => as_reported,
            Method::ConstantVelocity => {
                let position = self.lead.within_room(position + velocity * self.lead.ahead_s(age_s));
                Predicted { position, ..as_reported }
            }
            Method::Filter(_) => self.estimate(user.user, age_s).map_or(as_reported, |estimate| Predicted {
                position: estimate.position,
                velocity: estimate.velocity,
                estimate: Some(estimate),
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use heliostat_proto::Stamp;

    use super::*;

    #[test]
    fn the_lead_follows_the_rate_of_the_reports_and_not_their_pauses() {
        let scenario = Scenario::builtin("hall").expect("a built-in scenario");
        let mut lead = Lead::new(&scenario);
        assert!((lead.ahead_s(0.1) - 0.15).abs() < 1e-12, "the scenario has 10 reports a second");
        for report in 1..=100_u64 {
            lead.handle_users(report * 400_000_000);
        }
        assert!((lead.ahead_s(0.1) - 0.3).abs() < 1e-3, "{}", lead.ahead_s(0.1));
        lead.handle_users(60_000_000_000);
        assert!(lead.ahead_s(0.1) < 0.35, "one pause: {}", lead.ahead_s(0.1));
    }

    #[test]
    fn the_time_between_the_reports_of_two_sources_is_no_interval() {
        let scenario = Scenario::builtin("hall").expect("a built-in scenario");
        let model = scenario.channel_model().expect("a valid channel");
        let mut prediction = Prediction::new(&scenario, &model);
        let report = |time_ns| UserReport { stamp: Stamp { time_ns, ..Stamp::default() }, ..UserReport::default() };
        prediction.handle_users(&report(1_000_000_000));
        prediction.forget();
        prediction.handle_users(&report(9_000_000_000));
        assert_eq!(prediction.lead_s(), 0.05, "half of the interval that the scenario states");
    }
}
