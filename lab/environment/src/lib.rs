//! Environments for learning: a simulated room with a controller's observation, actions and reward.
//!
//! A learner in this workspace and a learner in Python act in the same environments, through the
//! observation encoder and the angle decoder of the controller. This crate does no I/O, reads no
//! clock and starts no thread.
//!
//! - [`room`]: the true state of a room, whose mirrors turn at once; the reward; the rooms of a
//!   training run.
//! - [`closed_loop`]: a room whose reports are late and noisy, with the decision core.
//! - [`held_out`]: rooms that training never uses, and the oracle on them.
//! - [`episodes`], [`sampling`]: the episodes of a comparison in closed loop, and when they are sampled.
//! - [`score`]: the true evaluation of angles, and the figures of a comparison.
//! - [`exact_states`]: the keys of a scenario that have no effect without reports.
//! - [`statistics`], [`outage`]: means with intervals, and outages, of a comparison.
//! - [`action`], [`believed`]: what an action means, and what a learner observes.
//! - [`function_policy`]: a function of a user, which sees the same and acts in the same forms, as a
//!   policy of the controller.
//! - [`thread_count`]: how many threads a computation may have.
//! - [`task`]: one of these rooms, with a form of action and observation, as steps of a learner.

pub mod action;
pub mod believed;
pub mod closed_loop;
pub mod episodes;
pub mod error;
pub mod exact_states;
pub mod function_policy;
pub mod held_out;
pub mod outage;
pub mod room;
pub mod sampling;
pub mod score;
pub mod statistics;
pub mod task;
mod task_settings;
pub mod thread_count;

pub use closed_loop::ClosedLoop;
pub use error::EnvironmentError;
pub use room::{Environment, Outcome, Reward, RewardForm, Rooms};
pub use task::{Task, TaskSettings};
