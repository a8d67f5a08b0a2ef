//! Sampled observations of a scenario, on which networks are tried when they are loaded.
//!
//! Users stand at points spread evenly over the floor, and every second direct path is blocked.

use heliostat_channel::{ChannelModel, Vec3};
use heliostat_scenario::Scenario;

use crate::observe::observation::{Observation, RoomState};

/// No further observation after this time, so that a slow network does not delay the start.
pub const TIME_MAX_NS: u64 = 250_000_000;

/// Fills an observation with the sample of an index.
pub fn observe(scenario: &Scenario, model: &ChannelModel, index: usize, observation: &mut Observation) {
    let users = scenario.users.count;
    let (x_m, y_m) = (scenario.room.length_x_m, scenario.room.length_y_m);
    let point = |user: usize| {
        let at = index * users + user + 1;
        let share = [2, 3].map(|base| spread(at, base) - 0.5);
        Vec3::new(share[0] * x_m, share[1] * y_m, scenario.receiver.height_m)
    };
    let state = RoomState {
        positions: &(0..users).map(point).collect::<Vec<_>>(),
        velocities: &vec![Vec3::zeros(); users],
        min_rate_bps: &scenario.min_rate_bps(),
        forced: &(0..users).map(|user| (index + user).is_multiple_of(2)).collect::<Vec<_>>(),
        ..RoomState::default()
    };
    observation.set_state(model, &state);
}

/// The radical inverse of an index: points in (0, 1) that fill the interval evenly (van der Corput;
/// with two bases, Halton).
fn spread(mut index: usize, base: usize) -> f64 {
    let (mut value, mut share) = (0.0, 1.0 / base as f64);
    while index > 0 {
        value += share * (index % base) as f64;
        index /= base;
        share /= base as f64;
    }
    value
}
