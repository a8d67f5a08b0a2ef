//! The policy that explores: a network in training with noise on its corrections.

use candle_core::{Device, Result, Tensor};
use heliostat_channel::{ChannelModel, MirrorAngles};
use heliostat_core::evidence::{Evidence, FEATURES};
use heliostat_core::observation::Observation;
use heliostat_core::policy::{Policy, PolicyError, PolicyKind};
use heliostat_models::{ActorSource, build};
use heliostat_scenario::Scenario;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::actor::{self, CERTAIN};
use crate::networks::layers::Network;
use crate::training::exploration::normal;

/// Horizontal components of the change of a normal.
pub const CHANGE: usize = 2;

/// Share of the noise of a decision that the next one keeps.
const NOISE_KEPT: f64 = 0.9;

/// The network in training with noise on its changes, in front of the solver.
pub struct Explorer {
    solver: Box<dyn Policy>,
    network: Network,
    /// Standard deviation of the noise.
    noise: f64,
    /// The noise of the last decision. Shape: users.
    kept: Vec<[f64; CHANGE]>,
    rng: ChaCha8Rng,
}

impl Explorer {
    /// The policy of a network in a room, with noise of this standard deviation on each component.
    ///
    /// # Errors
    /// The solver does not fit the room.
    pub fn new(network: Network, room: &Scenario, (noise, seed): (f64, u64)) -> anyhow::Result<Self> {
        let solver = build(PolicyKind::Greedy, room, &ActorSource::Shipped)?;
        Ok(Self { solver, network, noise, kept: Vec::new(), rng: ChaCha8Rng::seed_from_u64(seed) })
    }

    /// The outputs for all rows, with noise.
    fn outputs(&mut self, rows: &[[f32; FEATURES]]) -> Result<Vec<f32>> {
        let values = Tensor::from_vec(rows.concat(), (rows.len(), FEATURES), &Device::Cpu)?;
        let found = self.network.forward_rows(&values)?.to_vec2::<f32>()?;
        self.kept.resize(rows.len(), [0.0; CHANGE]);
        let fresh = self.noise * (1.0 - NOISE_KEPT * NOISE_KEPT).sqrt();
        let mut outputs = Vec::with_capacity(3 * rows.len());
        for ((row, found), kept) in rows.iter().zip(&found).zip(&mut self.kept) {
            let counted = actor::change_of(row, &[found[0], found[1], found[2]]);
            for (kept, counted) in kept.iter_mut().zip(counted) {
                *kept = NOISE_KEPT * *kept + fresh * normal(&mut self.rng);
                outputs.push((counted + *kept) as f32);
            }
            outputs.push(CERTAIN);
        }
        Ok(outputs)
    }
}

impl Policy for Explorer {
    fn name(&self) -> &str {
        "residual"
    }

    fn reads_evidence(&self) -> bool {
        true
    }

    fn correct(&mut self, evidence: &mut Evidence) {
        // Without outputs, as when memory runs out, nothing is corrected.
        if let Ok(outputs) = self.outputs(evidence.rows()) {
            evidence.correct(&outputs);
        }
    }

    fn act(
        &mut self,
        model: &ChannelModel,
        observation: &Observation,
        out: &mut MirrorAngles,
    ) -> std::result::Result<(), PolicyError> {
        self.solver.act(model, observation, out)
    }
}
