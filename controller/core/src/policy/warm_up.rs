//! Start-up warm-up: decisions on a synthetic room, so that the first real decision finds buffers
//! sized and caches warm.

use heliostat_channel::{ChannelModel, Vec3};

use super::proposal::Policy;
use crate::observe::observation::{Observation, RoomState};

/// Height of a device held by a user, in m.
const DEVICE_HEIGHT_M: f64 = 0.85;
/// Radius in m of the circle on which the synthetic users stand.
const CIRCLE_RADIUS_M: f64 = 1.5;

/// Lets policies decide for a synthetic room of `users` users, once for each item of `runs`.
pub fn warm_up(policies: &mut [&mut dyn Policy], model: &ChannelModel, users: usize, runs: impl Iterator) {
    let positions: Vec<Vec3> = (0..users).map(|user| synthetic_position(user, users)).collect();
    let state = RoomState {
        positions: &positions,
        velocities: &vec![Vec3::zeros(); users],
        min_rate_bps: &vec![1e6; users],
        forced: &vec![false; users],
        ..RoomState::default()
    };
    let mut observation = Observation::new(model, users);
    let mut proposed = observation.angles.clone();
    for _ in runs {
        observation.set_state(model, &state);
        for policy in policies.iter_mut() {
            // A failure here is no decision. The first real decision counts and reports it.
            let _ = policy.act(model, &observation, &mut proposed);
        }
    }
}

/// A position on a circle around the room's centre, at the height of a held device.
fn synthetic_position(user: usize, users: usize) -> Vec3 {
    let angle = std::f64::consts::TAU * user as f64 / users as f64;
    Vec3::new(CIRCLE_RADIUS_M * angle.cos(), CIRCLE_RADIUS_M * angle.sin(), DEVICE_HEIGHT_M)
}
