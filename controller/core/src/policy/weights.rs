//! From one action per user to decoder weights, and from these to the angles of all mirrors.
//!
//! Training, evaluation and serving call the same functions.

use std::str::FromStr;

use heliostat_channel::{ChannelModel, decode, mirrors::MirrorAngles};
use heliostat_proto::named;
use serde::{Deserialize, Serialize};

use crate::observe::observation::{Observation, ObservationEncoder, Summary};

named! {
    /// The baseline weight b_k, which is the decoder weight for an action of zero.
    #[derive(Serialize, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum BaselineWeight {
        /// b_k = 1.
        Uniform = "uniform",
        /// b_k = q_k, the balanced weight of [`Summary::LogWeight`].
        Balanced = "balanced",
    }
}

impl FromStr for BaselineWeight {
    type Err = ();

    fn from_str(name: &str) -> Result<Self, ()> {
        Self::ALL.into_iter().find(|weight| weight.name() == name).ok_or(())
    }
}

/// The map from actions u_k in [-1, 1] to decoder weights w_k = b_k exp(c u_k).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Head {
    /// The baseline weight b_k.
    #[serde(rename = "prior")]
    pub baseline_weight: BaselineWeight,
    /// The constant c.
    pub range: f32,
}

/// The observation in which actions were chosen.
#[derive(Clone, Copy)]
pub struct Seen<'a> {
    /// The observation.
    pub observation: &'a Observation,
    /// Index in the observation of each slot's user.
    pub chosen: &'a [usize],
    /// The layout of the vector.
    pub encoder: ObservationEncoder,
    /// The observation as a vector.
    pub vector: &'a [f32],
}

impl Head {
    /// The map of an environment with one weight per user, and of a file without its own: an action
    /// of zero is the balanced weight.
    pub const BALANCED: Self = Self { baseline_weight: BaselineWeight::Balanced, range: 2.0 };

    /// The decoder weights of all slots of an observation vector; zero in empty slots. Actions
    /// beyond [-1, 1] count as the nearest bound.
    pub fn weights(self, encoder: ObservationEncoder, vector: &[f32], actions: &[f32]) -> impl Iterator<Item = f32> {
        let column = |column: Summary| vector[encoder.column(column as usize)].iter();
        let slots = column(Summary::Present).zip(column(Summary::LogWeight));
        actions.iter().zip(slots).map(move |(action, (present, balanced))| {
            let log_baseline = match self.baseline_weight {
                BaselineWeight::Uniform => 0.0,
                BaselineWeight::Balanced => *balanced,
            };
            (self.range * action.clamp(-1.0, 1.0) + log_baseline).exp() * present
        })
    }

    /// Writes the mirror angles for the actions of all slots. A user without a slot has the weight
    /// zero. `weights` is a buffer.
    ///
    /// # Panics
    /// If the observation holds no user, or `out` has another size than the array.
    pub fn decode(
        self,
        model: &ChannelModel,
        seen: Seen<'_>,
        actions: &[f32],
        weights: &mut Vec<f64>,
        out: &mut MirrorAngles,
    ) {
        weights.clear();
        weights.resize(seen.observation.users(), 0.0);
        for (user, weight) in seen.chosen.iter().zip(self.weights(seen.encoder, seen.vector, actions)) {
            weights[*user] = f64::from(weight);
        }
        decode::decode(model, &seen.observation.scene, weights, out);
    }
}
