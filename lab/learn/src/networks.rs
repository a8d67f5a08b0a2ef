//! The networks that learners train: layers, initialisation, optimiser, and the actors and critics
//! of learners with one weight per user.

pub mod actor;
pub mod adam;
pub mod critic;
pub mod layers;

pub use adam::Adam;
pub use layers::{Encoder, Linear, Network, Shape, assign, soft_update};

use crate::threads::on_threads;

/// Runs the work on a thread pool of one thread, candle's matrix products included.
///
/// candle shares each larger product out over all cores. The products here are so small that
/// waiting for a busy core takes far longer than the computation.
///
/// # Errors
/// The system refuses a thread.
pub fn on_one_thread<T: Send>(work: impl FnOnce() -> T + Send) -> anyhow::Result<T> {
    on_threads(1, work)
}
