//! The learners, one file each, and the table of algorithms.
//!
//! - [`ddpg`]: DDPG with one weight for each user as the action.
//! - [`ddpg_raw`]: DDPG with the angles of all mirrors as the action.
//! - [`analytic`]: the network of `ddpg`, trained by the gradient through the channel.
//! - [`dql`]: deep Q-learning on a codebook of angles.
//! - [`q_learning`], [`sarsa`]: tabular learning on the codebook; [`table`] is the table.
//!
//! Each head lists the deviations from the paper.

pub mod analytic;
pub mod ddpg;
pub mod ddpg_raw;
pub mod dql;
pub mod q_learning;
pub mod sarsa;
pub mod table;

use crate::training::Algorithm;

/// The algorithms that `heliostat train` knows.
pub const ALGORITHMS: &[Algorithm] = &[
    ddpg::ALGORITHM,
    ddpg_raw::ALGORITHM,
    analytic::ALGORITHM,
    dql::ALGORITHM,
    q_learning::ALGORITHM,
    sarsa::ALGORITHM,
];

impl clap::ValueEnum for Algorithm {
    fn value_variants<'a>() -> &'a [Self] {
        ALGORITHMS
    }

    fn to_possible_value(&self) -> Option<clap::builder::PossibleValue> {
        Some(clap::builder::PossibleValue::new(self.name).help(self.help))
    }
}
