//! The belief about the users of the last decision, as a message for viewers.

use heliostat_proto::{BeliefReport, Nanos, UserBelief};

use super::Observer;
use crate::{belief::Estimate, input::inbox::Inbox, observe::observation::Observation};

impl Observer {
    /// Fills a report with the belief by which `observation` was made at `now`; its stamp is the
    /// caller's. False, without a change, where there is no belief or no position report. Does not
    /// allocate in a report with memory for all users.
    pub fn report_beliefs(
        &self,
        inbox: &Inbox,
        observation: &Observation,
        now: Nanos,
        report: &mut BeliefReport,
    ) -> bool {
        let Some(users) = inbox.users() else { return false };
        let age_s = now.saturating_sub(users.stamp.time_ns) as f64 * 1e-9;
        let Some(ahead_s) = self.prediction.ahead_s(age_s) else { return false };
        report.tick = users.tick;
        report.holds_ns = users.stamp.time_ns.saturating_add((ahead_s.max(0.0) * 1e9).round() as Nanos);
        report.users.clear();
        for (slot, user) in observation.ids.iter().enumerate() {
            let Some(estimate) = self.prediction.estimate(*user, age_s) else { continue };
            let heading = estimate.heading;
            // A body or a surveyed obstacle of the observation, or else what is believed.
            let is_modelled = observation.scene.los_blocked().get(slot).is_some_and(|blocked| *blocked);
            let blocked = if is_modelled && estimate.direct_clear > 0.5 { 1.0 } else { 1.0 - estimate.direct_clear };
            report.users.push(UserBelief {
                user: *user,
                heading_rad: heading.y.atan2(heading.x) as f32,
                heading_certainty: heading.norm().min(1.0) as f32,
                blocked_probability: blocked.clamp(0.0, 1.0) as f32,
                ..of_estimate(&estimate)
            });
        }
        true
    }
}

/// Place, velocity and covariance. The covariance is cut to the bound of the contract, which
/// rounding to f32 can exceed.
fn of_estimate(estimate: &Estimate) -> UserBelief {
    let Estimate { position, velocity, position_cov_m2: [xx, xy, yy], .. } = estimate;
    let (xx_m2, yy_m2) = (xx.max(0.0) as f32, yy.max(0.0) as f32);
    let most = (f64::from(xx_m2) * f64::from(yy_m2)).sqrt();
    UserBelief {
        position_m: [position.x as f32, position.y as f32, position.z as f32],
        velocity_m_s: [velocity.x as f32, velocity.y as f32],
        xx_m2,
        xy_m2: xy.clamp(-most, most) as f32,
        yy_m2,
        ..UserBelief::default()
    }
}
