//! The belief about the users as an observation: one row for each slot.
//!
//! In closed loop the rows hold what the filter believes for the middle of the time in which the
//! command is in force. Without a filter, and in a room whose true state is known, they hold the
//! observed state with a covariance of 0.

use heliostat_channel::{ChannelModel, Vec3};
use heliostat_core::belief::Estimate;
use heliostat_core::core::Controller;
use heliostat_core::observation::Observation;
use heliostat_scenario::WALKING_M_S;

/// The columns of a row, in this order. All are 0 in an empty slot.
pub const COLUMNS: [&str; 15] = [
    "present",
    "x_m",
    "y_m",
    "z_m",
    "velocity_x_m_s",
    "velocity_y_m_s",
    "covariance_xx_m2",
    "covariance_xy_m2",
    "covariance_yy_m2",
    "velocity_variance_m2_s2",
    "heading_x",
    "heading_y",
    "direct_clear",
    "direct_amplitude",
    "minimum_rate_bit_s_hz",
];

/// The true state of a user as an estimate without error.
fn known(observation: &Observation, user: usize) -> Estimate {
    let velocity = observation.velocities[user];
    let speed = velocity.norm();
    Estimate {
        position: observation.positions[user],
        velocity,
        heading: if speed > WALKING_M_S { velocity / speed } else { Vec3::zeros() },
        direct_clear: f64::from(u8::from(!observation.scene.los_blocked()[user])),
        ..Estimate::default()
    }
}

/// What a controller believes about a user of its observation at `now_ns`.
fn believed(controller: &Controller, user: usize, now_ns: u64) -> Estimate {
    let (observation, observer) = (controller.observation(), controller.observer());
    let reported_ns = controller.inbox().users().map_or(now_ns, |report| report.stamp.time_ns);
    let ahead_s = now_ns.saturating_sub(reported_ns) as f64 * 1e-9 + observer.lead_s();
    let estimate = observer.belief().and_then(|belief| belief.estimate(observation.ids[user], ahead_s));
    estimate.unwrap_or_else(|| Estimate { heading: observer.heading(user), ..known(observation, user) })
}

/// Writes the rows of the users `chosen`, one slot after the other. `controller` with the time in
/// ns is absent where the true state is known.
pub(crate) fn write(
    (model, observation): (&ChannelModel, &Observation),
    controller: Option<(&Controller, u64)>,
    chosen: &[usize],
    out: &mut [f32],
) {
    out.fill(0.0);
    let amplitude = model.budget.amplitude_scale();
    let share = observation.users() as f64 / model.budget.bandwidth_hz;
    for (row, user) in out.chunks_exact_mut(COLUMNS.len()).zip(chosen) {
        let estimate = match controller {
            Some((controller, now_ns)) => believed(controller, *user, now_ns),
            None => known(observation, *user),
        };
        let Estimate { position, velocity, position_cov_m2: [xx, xy, yy], velocity_var_m2_s2, heading, .. } = estimate;
        let values = [
            1.0,
            position.x,
            position.y,
            position.z,
            velocity.x,
            velocity.y,
            xx,
            xy,
            yy,
            velocity_var_m2_s2,
            heading.x,
            heading.y,
            estimate.direct_clear,
            amplitude * observation.scene.los_gain()[*user],
            share * observation.min_rate_bps[*user],
        ];
        row.iter_mut().zip(values).for_each(|(entry, value)| *entry = value as f32);
    }
}
