//! The SINR that remains when mirrors are aimed at past positions of the users.

use heliostat_channel::solver::Solver;
use heliostat_core::core::Controller;
use heliostat_environment::episodes::{HeldOutEpisode, WARM};
use heliostat_room::SimulatedRoom;
use heliostat_scenario::Scenario;

use super::closed_loop::Lockstep;
use super::evaluated_policy::EvaluatedPolicy;
use crate::evaluation::held_out::{best_angles, held_out_seed};

/// SINR over the SINR at perfect aim for each user, at `instants` sampling times of one walk in
/// closed loop; dimensionless.
///
/// The sampling times are a quarter of a second apart on average. Reports, their age, the
/// controller's decisions and the mirrors' motion are those of the scenario. Perfect aim is that of
/// the oracle, which observes the true positions and whose mirrors turn at once. Users with zero
/// SINR under the oracle are left out.
///
/// # Errors
/// The scenario describes no room, the policy does not fit it or fails, or reports are too old for
/// a decision.
pub fn kept_sinr(scenario: &Scenario, evaluated: &EvaluatedPolicy, instants: usize) -> anyhow::Result<Vec<f64>> {
    let (users, seed) = (scenario.users.count, scenario.seed);
    let scenario = evaluated.scenario(scenario);
    let controller = Controller::new(&scenario, scenario.channel_model()?, evaluated.build(&scenario, seed)?, 1);
    let episode = HeldOutEpisode::new(held_out_seed(seed, 0), seed, instants, WARM);
    let mut solver = Solver::new(users, scenario.mirror_count());
    let [mut sinr, mut perfect] = [vec![0.0; users], vec![0.0; users]];
    let mut kept = Vec::with_capacity(users * instants);
    let mut look = |_, room: &SimulatedRoom| {
        let (model, scene) = (room.world().model(), room.world().scene());
        scene.sinr(model, room.angles(), &mut sinr);
        let best = best_angles(&mut solver, model, scene, room.world().min_rate_bps());
        scene.sinr(model, &best, &mut perfect);
        let pairs = sinr.iter().zip(&perfect).filter(|(_, perfect)| **perfect > 0.0);
        kept.extend(pairs.map(|(sinr, perfect)| sinr / perfect));
    };
    Lockstep::new(&scenario, scenario.read_trace()?.as_deref(), &episode, (controller, true))?
        .run(&episode.instants_ns, &mut look)?;
    Ok(kept)
}
