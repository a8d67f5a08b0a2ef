//! DDPG with the angles of all mirrors as the action, and a critic of smooth patterns of angles.
//!
//! The learner is that of [`super::ddpg_raw`], with its deviations from the paper. It learns under
//! the paper's equations, where each angle has a smooth effect.
//!
//! # Further deviations from the paper
//! 1. **Critic of patterns.** One mirror changes the reward by far less than the exploration does,
//!    so a critic of 200 separate angles learns noise. The best angles of neighbouring mirrors are
//!    close. The critic therefore reads the coefficients of the lowest 2 x 2 cosine modes of roll
//!    and of yaw, and the actor's gradient is smooth over the array too. The actor still has 200
//!    outputs.
//! 2. **Smooth exploration.** The noise has the same patterns. Independent noise of each mirror
//!    averages out over the array.
//! 3. **No saturated outputs.** Gradients are scaled down to a norm of 1, and the mean square of
//!    the outputs before tanh is part of the actor's loss.
//! 4. **Slow actor.** The learning rates are 2e-4 (actor) and 1e-3 (critic), decaying to 2e-5 and
//!    1e-4. The first update follows 1500 transitions, a batch has 64 of them, and there are 400
//!    episodes. With a learning rate of 1e-3 for both, the actor follows the errors of a critic
//!    that has few transitions to learn from.
//! 5. **gamma = 0, and no current angles in the state.** An action does not influence later states
//!    here, and the best angles do not depend on the current ones.
//!
//! As in the paper, lambda is 1 and all rooms have the scenario's users, noise and blockage. In
//! rooms drawn as for [`super::ddpg`] most of the reward's variance does not depend on the action.
//! `lab/learn/experiments.md` has the result.

use heliostat_core::policy::PolicyKind;

use super::ddpg_raw::{DdpgRaw, Settings, Sight};
use crate::training::algorithm::{Algorithm, start};
use crate::training::exploration::{Exploration, Kind};
use crate::training::settings::RunSettings;

/// The row in the table of algorithms.
pub const ALGORITHM: Algorithm = Algorithm {
    name: "ddpg-basis",
    policy: PolicyKind::DdpgBasis,
    help: "DDPG on all angles, with a critic of smooth patterns of the angles",
    summary: "DDPG on all angles, with a critic of smooth patterns; deviations from the paper at the heads of \
              `lab/learn/src/learners/ddpg_basis.rs` and `lab/learn/src/learners/ddpg_raw.rs`",
    has_paper_preset: false,
    start: |scenario, _, options| {
        let settings = settings(scenario.seed);
        start(scenario, settings, options, DdpgRaw::new)
    },
};

/// The hyperparameters of the shipped actors.
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
