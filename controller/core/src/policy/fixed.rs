//! Policies that do not depend on the users: baselines, and policies of degraded modes.

use heliostat_channel::{ChannelModel, mirrors::MirrorAngles};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::proposal::{Policy, PolicyResult};
use crate::observe::observation::Observation;

/// The same angles at each decision.
pub struct Fixed {
    name: &'static str,
    angles: MirrorAngles,
}

impl Fixed {
    /// Every mirror faces straight into the room.
    pub fn flat(mirrors: usize) -> Self {
        Self::uniform("flat", mirrors, 0.0)
    }

    /// Every mirror turns up to the end of its range, so that it reflects no light to the users.
    pub fn no_irs(mirrors: usize, range_rad: f64) -> Self {
        Self::uniform("no-irs", mirrors, -range_rad)
    }

    /// One uniform draw per axis within the range, the same for the complete run.
    pub fn random(mirrors: usize, range_rad: f64, seed: u64) -> Self {
        let mut generator = ChaCha8Rng::seed_from_u64(seed);
        let mut draw = || (0..mirrors).map(|_| generator.random_range(-range_rad..=range_rad)).collect();
        Self { name: "random", angles: MirrorAngles { roll: draw(), yaw: draw() } }
    }

    /// The angles of each decision.
    pub fn angles(&self) -> &MirrorAngles {
        &self.angles
    }

    fn uniform(name: &'static str, mirrors: usize, roll: f64) -> Self {
        Self { name, angles: MirrorAngles { roll: vec![roll; mirrors], yaw: vec![0.0; mirrors] } }
    }
}

impl Policy for Fixed {
    fn name(&self) -> &str {
        self.name
    }

    fn act(&mut self, _: &ChannelModel, _: &Observation, out: &mut MirrorAngles) -> PolicyResult {
        out.copy_from(&self.angles);
        Ok(())
    }
}

/// Publishes the last angles again: the policy `hold` and the fallback `last-good`.
pub struct Hold;

impl Policy for Hold {
    fn name(&self) -> &str {
        "hold"
    }

    fn act(&mut self, _: &ChannelModel, observation: &Observation, out: &mut MirrorAngles) -> PolicyResult {
        out.copy_from(&observation.angles);
        Ok(())
    }
}
