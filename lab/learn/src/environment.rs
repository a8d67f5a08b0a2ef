//! What a learner observes and what its actions do: the first stage of the data flow.
//!
//! - [`room`]: a simulated room with the controller's observation, the decoder and the reward; the
//!   rooms of a run.
//! - [`features`], [`angle_state`]: the observation vector as inputs of a network.
//! - [`target_user`]: the user whom the mirrors can help most, as the state of the codebook
//!   learners.
//! - [`codebook`]: the codewords, which are the actions of the codebook learners.

pub mod codebook;
pub mod features;
pub mod target_user;

pub use heliostat_environment::{angle_state, room};
pub use room::{Environment, Outcome, Reward, RewardForm, Rooms};
