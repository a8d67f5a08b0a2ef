//! A stochastic actor: a normal distribution of each user's output before tanh.
//!
//! The mean is the output of an [`Actor`], so the exported policy is the actor alone. A second
//! network of the same size gives the logarithm of the standard deviation.

use candle_core::{Device, Result, Tensor};
use rand::Rng;

use super::actor::{ACTOR_INPUTS, Actor, HIDDEN, States};
use super::layers::{Encoder, Network, Shape};
use crate::environment::features::{Head, Layout};
use crate::training::exploration::normal;

/// Logarithm of the standard deviation that an untrained network gives: 0.14. The decoder raises
/// the weights to a power, so the value of an action with more noise says little about its mean.
const LOG_SPREAD_START: f64 = -2.0;

/// Bounds of the logarithm of the standard deviation.
const LOG_SPREAD: [f64; 2] = [-4.0, 0.5];

/// ln(2 pi) / 2.
const LOG_NORM: f64 = 0.918_938_533_204_672_7;

/// The policy pi(a | s) of SAC and PPO.
pub struct GaussianActor {
    /// The actor of the means, without exploration.
    pub mean: Actor,
    /// The network of the standard deviations.
    pub spread: Network,
}

/// Means and logarithms of the standard deviations before tanh, (batch, slots) each.
pub struct Distribution {
    mean: Tensor,
    log_spread: Tensor,
}

impl GaussianActor {
    /// An actor with newly drawn parameters.
    ///
    /// # Errors
    /// Errors of candle, when memory runs out.
    pub fn new(layout: Layout, head: Head, rng: &mut impl Rng) -> Result<Self> {
        let mean = Actor::new(layout, Encoder::PerUser, (head, 1), rng)?;
        let slots = layout.slots();
        let shape = Shape { encoder: Encoder::PerUser, slots, inputs: ACTOR_INPUTS, hidden: HIDDEN, outputs: slots };
        Ok(Self { mean, spread: Network::new(shape, rng)? })
    }

    /// The distribution in some states.
    ///
    /// # Errors
    /// Errors of candle, when shapes differ.
    pub fn distribution(&self, states: &States) -> Result<Distribution> {
        let [least, most] = LOG_SPREAD;
        let log_spread = (self.spread.forward(&states.first_round()?)? + LOG_SPREAD_START)?.clamp(least, most)?;
        Ok(Distribution { mean: self.mean.raw(states)?, log_spread })
    }

    /// Draws from the distribution in the state of one row: the value before tanh of each slot.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn draw(&self, state: &[f32], rng: &mut impl Rng) -> Result<Vec<f32>> {
        let states = States::new(state.to_vec(), 1, self.mean.layout, self.mean.head.baseline_weight)?;
        self.distribution(&states)?.draw(rng)?.squeeze(0)?.to_vec1()
    }
}

impl Distribution {
    /// Draws values before tanh as mean + spread times standard normal noise, so that they have a
    /// gradient (the reparametrisation of SAC, eq. 11): (batch, slots).
    ///
    /// # Errors
    /// Errors of candle.
    pub fn draw(&self, rng: &mut impl Rng) -> Result<Tensor> {
        let noise = (0..self.mean.elem_count()).map(|_| normal(rng) as f32).collect();
        let noise = Tensor::from_vec(noise, self.mean.shape(), &Device::Cpu)?;
        &self.mean + self.log_spread.exp()?.mul(&noise)?
    }

    /// ln of the density of values before tanh, (batch, slots), without meaning in empty slots.
    ///
    /// # Errors
    /// Errors of candle, when shapes differ.
    pub fn log_density(&self, raw: &Tensor) -> Result<Tensor> {
        let scaled = (raw - &self.mean)?.mul(&self.log_spread.neg()?.exp()?)?;
        ((scaled.sqr()? * -0.5)? - &self.log_spread)? - LOG_NORM
    }

    /// ln of the density of the actions tanh(raw), (batch, slots): that of `raw` less ln(1 -
    /// tanh^2(raw)), as in SAC, appendix C.
    ///
    /// # Errors
    /// Errors of candle, when shapes differ.
    pub fn log_density_of_action(&self, raw: &Tensor) -> Result<Tensor> {
        // ln(1 - tanh^2 x) = 2 [ln 2 - |x| - ln(1 + exp(-2 |x|))], without cancellation.
        let size = raw.abs()?;
        let slope = ((size.neg()? - ((size * -2.0)?.exp()? + 1.0)?.log()?)? + std::f64::consts::LN_2)?;
        self.log_density(raw)? - (slope * 2.0)?
    }

    /// The differential entropy before tanh, (batch, slots): ln spread + (1 + ln 2 pi) / 2.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn entropy(&self) -> Result<Tensor> {
        &self.log_spread + (LOG_NORM + 0.5)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn distribution() -> Distribution {
        let tensor = |values: [f32; 2]| Tensor::from_slice(&values, (1, 2), &Device::Cpu).expect("a tensor");
        Distribution { mean: tensor([0.3, -1.2]), log_spread: tensor([-0.7, 0.2]) }
    }

    /// The integral over the actions of the density that the logarithm gives, for each slot.
    #[test]
    fn the_density_of_the_actions_integrates_to_one() {
        let (steps, mut sums) = (20_000, [0.0; 2]);
        for step in 0..steps {
            let action = (step as f32 + 0.5) / steps as f32 * 2.0 - 1.0;
            let raw = Tensor::from_slice(&[action.atanh(); 2], (1, 2), &Device::Cpu).expect("a tensor");
            let log = distribution().log_density_of_action(&raw).and_then(|log| log.to_vec2::<f32>()).expect("values");
            sums.iter_mut().zip(&log[0]).for_each(|(sum, log)| *sum += f64::from(log.exp()) * 2.0 / f64::from(steps));
        }
        assert!(sums.iter().all(|sum| (sum - 1.0).abs() < 2e-3), "{sums:?}");
    }

    #[test]
    fn draws_have_the_mean_the_spread_and_the_entropy_of_the_distribution() {
        use rand::SeedableRng;
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let (distribution, count) = (distribution(), 20_000);
        let (mut sum, mut squares, mut surprise) = (0.0, 0.0, 0.0);
        for _ in 0..count {
            let raw = distribution.draw(&mut rng).expect("a draw");
            let value = f64::from(raw.to_vec2::<f32>().expect("values")[0][0]);
            let log = distribution.log_density(&raw).and_then(|log| log.to_vec2::<f32>()).expect("values");
            (sum, squares, surprise) = (sum + value, squares + value * value, surprise - f64::from(log[0][0]));
        }
        let mean = sum / f64::from(count);
        let spread = (squares / f64::from(count) - mean * mean).sqrt();
        assert!((mean - 0.3).abs() < 0.02 && (spread - (-0.7_f64).exp()).abs() < 0.02, "{mean} {spread}");
        let entropy = f64::from(distribution.entropy().and_then(|all| all.to_vec2::<f32>()).expect("values")[0][0]);
        assert!((surprise / f64::from(count) - entropy).abs() < 0.02, "{surprise} {entropy}");
    }
}
