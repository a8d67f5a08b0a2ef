//! Particle swarm optimisation with constriction (Clerc and Kennedy, IEEE Trans. Evolutionary
//! Computation 6, 2002).
//!
//! Every coordinate x of every particle is drawn to the best place p that the particle has seen and
//! to the best g of all,
//!
//! ```text
//! v <- w v + c r1 (p - x) + c r2 (g - x),   x <- x + v,
//! ```
//!
//! with r1 and r2 uniform in [0, 1]. Differences from the source: the budget is counted in trials
//! or in time instead of rounds, one particle starts at the present angles, and particles start at
//! rest. The module `metaheuristic` has the first two.

use heliostat_channel::mirrors::MirrorAngles;
use heliostat_scenario::Scenario;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::metaheuristic::{Round, Rule, Search};
use super::proposal::TimeSource;

/// w: the constriction for c1 + c2 = 4.1.
const INERTIA: f64 = 0.7298;
/// c: the constriction times 2.05.
const ATTRACTION: f64 = 1.49618;

/// Particle swarm optimisation on the angles of all mirrors, with the budget and the seed of a scenario.
pub(super) fn pso(scenario: &Scenario, monotonic_ns: TimeSource) -> Search<Memory> {
    Search::new("pso", scenario, monotonic_ns, |places| {
        let places = places.to_vec();
        Memory { objectives: vec![f64::NEG_INFINITY; places.len()], velocities: places.clone(), places }
    })
}

/// The memory of each particle.
pub(super) struct Memory {
    /// In rad per round.
    velocities: Vec<MirrorAngles>,
    /// The best place of each particle.
    places: Vec<MirrorAngles>,
    objectives: Vec<f64>,
}

impl Memory {
    fn remember(&mut self, index: usize, place: &MirrorAngles, objective: f64) {
        self.objectives[index] = objective;
        self.places[index].copy_from(place);
    }
}

impl Rule for Memory {
    fn begin(&mut self, places: &[MirrorAngles], objectives: &[f64]) {
        for (index, (place, objective)) in places.iter().zip(objectives).enumerate() {
            self.remember(index, place, *objective);
            self.velocities[index].axes_mut().for_each(|velocity| *velocity = 0.0);
        }
    }

    fn step(&mut self, place: &mut MirrorAngles, round: &Round<'_>, generator: &mut ChaCha8Rng) {
        let velocities = self.velocities[round.index].axes_mut();
        let drawn_to = self.places[round.index].axes().zip(round.best.axes());
        for ((angle, velocity), (own, best)) in place.axes_mut().zip(velocities).zip(drawn_to) {
            let mut pull = |to: &f64| ATTRACTION * generator.random::<f64>() * (to - *angle);
            *velocity = INERTIA * *velocity + pull(own) + pull(best);
            *angle += *velocity;
        }
    }

    fn evaluated(&mut self, index: usize, place: &MirrorAngles, objective: f64) {
        if objective > self.objectives[index] {
            self.remember(index, place, objective);
        }
    }
}
