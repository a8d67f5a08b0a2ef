//! Exploration: the random part of an action during training.
//!
//! The paper names epsilon-greedy in its text and additive noise in Algorithm 1. Both are here. The
//! magnitude decays geometrically from the first episode to the last.

use rand::{Rng, RngExt};

/// The kind of exploration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// Gaussian noise added to each component of the action (Algorithm 1); the magnitude is its
    /// standard deviation.
    Additive,
    /// With a probability equal to the magnitude, all components are drawn uniformly from [-1, 1].
    EpsilonGreedy,
}

/// An exploration whose magnitude decays over the episodes.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Exploration {
    /// The kind.
    pub kind: Kind,
    /// Magnitude in the first episode.
    pub start: f64,
    /// Magnitude in the last episode.
    pub end: f64,
}

impl Exploration {
    /// The magnitude in an episode counted from 0: start (end / start)^(episode / (episodes - 1)).
    pub fn magnitude(&self, episode: usize, episodes: usize) -> f64 {
        let progress = episode as f64 / (episodes.saturating_sub(1).max(1)) as f64;
        self.start * (self.end / self.start).powf(progress.min(1.0))
    }

    /// Explores around an action; its components stay within [-1, 1].
    pub fn apply(&self, magnitude: f64, actions: &mut [f32], rng: &mut impl Rng) {
        match self.kind {
            Kind::Additive => {
                for action in actions {
                    *action = (*action + (magnitude * normal(rng)) as f32).clamp(-1.0, 1.0);
                }
            }
            Kind::EpsilonGreedy => {
                if rng.random::<f64>() < magnitude {
                    actions.fill_with(|| rng.random_range(-1.0..1.0));
                }
            }
        }
    }

    /// Epsilon-greedy among `count` codewords: a random one with probability `epsilon`, otherwise
    /// `None`, for the greedy one.
    pub fn draw(epsilon: f64, count: usize, rng: &mut impl Rng) -> Option<usize> {
        (rng.random::<f64>() < epsilon).then(|| rng.random_range(0..count))
    }

    /// Refuses kinds that do not apply to the choice of a codeword.
    ///
    /// # Errors
    /// The kind is not epsilon-greedy.
    pub fn check_choices(&self) -> anyhow::Result<()> {
        anyhow::ensure!(
            self.kind == Kind::EpsilonGreedy,
            "exploration.kind: expected epsilon-greedy, because the action is a codeword"
        );
        Ok(())
    }
}

/// One draw from the standard normal distribution, by the Box-Muller transform.
pub fn normal(rng: &mut impl Rng) -> f64 {
    let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
    radius * (std::f64::consts::TAU * rng.random::<f64>()).cos()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn the_magnitude_decays_from_start_to_end() {
        let exploration = Exploration { kind: Kind::Additive, start: 0.4, end: 0.1 };
        assert!((exploration.magnitude(0, 11) - 0.4).abs() < 1e-12);
        assert!((exploration.magnitude(5, 11) - 0.2).abs() < 1e-12);
        assert!((exploration.magnitude(10, 11) - 0.1).abs() < 1e-12);
    }

    #[test]
    fn additive_noise_has_the_stated_spread_and_stays_in_range() {
        let exploration = Exploration { kind: Kind::Additive, start: 1.0, end: 1.0 };
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut actions = vec![0.0_f32; 20_000];
        exploration.apply(0.2, &mut actions, &mut rng);
        let variance = actions.iter().map(|value| f64::from(value * value)).sum::<f64>() / actions.len() as f64;
        assert!((variance.sqrt() - 0.2).abs() < 0.005, "standard deviation {}", variance.sqrt());
        exploration.apply(5.0, &mut actions, &mut rng);
        assert!(actions.iter().all(|value| value.abs() <= 1.0));
    }

    #[test]
    fn epsilon_is_the_share_of_random_actions() {
        let exploration = Exploration { kind: Kind::EpsilonGreedy, start: 1.0, end: 1.0 };
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let explored = (0..4000).filter(|_| {
            let mut actions = [0.5_f32; 3];
            exploration.apply(0.25, &mut actions, &mut rng);
            actions != [0.5; 3]
        });
        let share = explored.count() as f64 / 4000.0;
        assert!((share - 0.25).abs() < 0.03, "share {share}");
    }
}
