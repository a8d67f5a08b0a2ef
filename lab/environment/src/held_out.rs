//! Held-out rooms, and the oracle on them: the reference of every score.

use heliostat_channel::mirrors::MirrorAngles;
use heliostat_channel::solver::{Method, MinimumRates, QOS_PENALTY, Solver};
use heliostat_channel::{ChannelModel, Scene};
use heliostat_room::World;
use heliostat_scenario::Scenario;

use crate::error::EnvironmentError;
use crate::room::check_known;

/// Seconds that users walk before a state is taken, so that positions and headings are those of a
/// continuing walk.
pub const SETTLE_S: f64 = 20.0;

/// Separates held-out rooms from those of training, whose seeds come from the run's generator.
const HELD_OUT_SEED: u64 = 0x4e1d_0000_0000;

/// The seed of a held-out room: `set` separates rooms of different comparisons, `index` those of
/// one. The scores during training use set 0.
pub fn held_out_seed(set: u64, index: u64) -> u64 {
    HELD_OUT_SEED.wrapping_add(set << 20).wrapping_add(index)
}

/// The state `index` of a static comparison with `states` states of each seed, counted up from `first_seed`: its set
/// and its index in this set.
pub fn held_out_state(first_seed: u64, states: usize, index: usize) -> (u64, u64) {
    (first_seed.wrapping_add((index / states) as u64), (index % states) as u64)
}

/// A held-out room at the time of its state; `trace` is the text of the file `users.trace`.
///
/// # Errors
/// The scenario describes no room, or one that [`check_known`] refuses.
pub fn held_out_world(
    scenario: &Scenario,
    trace: Option<&str>,
    set: u64,
    index: u64,
) -> Result<World, EnvironmentError> {
    check_known(scenario)?;
    let mut world = World::new(scenario, trace, held_out_seed(set, index))?;
    world.step(SETTLE_S);
    Ok(world)
}

/// The angles of the oracle with minimum rates; flat mirrors without users.
///
/// `min_rate_bps`: bit/s. Shape: K.
pub fn best_angles(solver: &mut Solver, model: &ChannelModel, scene: &Scene, min_rate_bps: &[f64]) -> MirrorAngles {
    let mut angles = MirrorAngles::flat(model.mirrors.len());
    if scene.users() == 0 {
        return angles;
    }
    solver.set_users(scene.users());
    solver.solve(model, scene, &MinimumRates { min_rate_bps, qos_penalty: QOS_PENALTY }, Method::Oracle, &mut angles);
    angles
}

/// Share of users whose minimum rate is met; a shortfall by rounding counts as met.
pub fn met(rates: &[f64], min_rates: &[f64]) -> f64 {
    let count = rates.iter().zip(min_rates).filter(|(rate, min_rate)| **rate >= **min_rate * (1.0 - 1e-9)).count();
    count as f64 / rates.len() as f64
}
