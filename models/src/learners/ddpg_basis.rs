//! Algorithm 1 with the angles of all mirrors as the action, made to work where angles have an effect at all: under the paper's equations.
//!
//! The trainer is [`crate::ddpg_raw`]'s, and so are its departures. Further ones, and why:
//! 1. **Critic that sees patterns.** A single mirror changes the reward by a hundredth of what exploration does, so a critic of 200 separate
//!    angles learns noise. Neighbouring mirrors want nearly the same angles: the critic sees the strengths of the lowest 2 x 2 cosine modes of roll
//!    and of yaw over the array, and the gradient that the actor gets is smooth over the array too. The actor still has 200 outputs.
//! 2. **Smooth exploration.** The noise is drawn in the same patterns; noise of each mirror alone averages out and explores nothing.
//! 3. **No saturated outputs.** Gradients are cut to a norm of 1, and the mean square of the outputs before tanh is part of the actor's loss.
//! 4. **An actor that waits for its critic**: rates of 2e-4 and 1e-3 that fall to a tenth, the first update after 1500 transitions, batches of 64. With a
//!    rate of 1e-3 for both the actor follows the errors of a young critic. 400 episodes.
//! 5. **gamma = 0, and no current angles in the state.** An action does not influence later states here, and the best angles do not depend on the
//!    current ones.
//!
//! As in the paper, lambda is 1 and all rooms have the scenario's users, noise and blockage: in rooms drawn as for [`crate::ddpg`] most of the
//! reward's variation has nothing to do with the action. The result in `paper-calibrated` is 1.008 of the oracle with minimum rates, seed 1.

use crate::ddpg_raw::{Settings, Sight};
use crate::explore::{Exploration, Kind};
use crate::learner::RunSettings;

/// The numbers of the shipped actors.
pub fn settings(seed: u64) -> Settings {
    let paper = Settings::new(seed);
    Settings {
        sight: Sight::Patterns,
        angles_in_state: false,
        gamma: 0.0,
        patterns: 2,
        actor_rate: 2e-4,
        critic_rate: 1e-3,
        rate_end: 0.1,
        clip: 1.0,
        saturation: 1e-3,
        batch: 64,
        warm_up: 1500,
        exploration: Exploration { kind: Kind::Patterns, start: 0.3, end: 0.05 },
        run: RunSettings { episodes: 400, ..paper.run },
        ..paper
    }
}
