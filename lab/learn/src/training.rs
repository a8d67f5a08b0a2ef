//! The training loop that all learners share, and the files that a run writes.
//!
//! - [`learner`]: the interface of a learner.
//! - [`run`]: the loop over episodes and steps, with the rooms and the random generator of the run.
//! - [`settings`]: the hyperparameters of a run, and changes to them from the command line.
//! - [`algorithm`]: one row of the table of algorithms.
//! - [`replay`], [`transitions`], [`exploration`]: parts that several learners use.
//! - [`store`], [`checkpoint`]: the state of a run on disk.
//! - [`curve`], [`card`]: the learning curve and the model card.

pub mod algorithm;
pub mod card;
pub mod checkpoint;
pub mod curve;
pub mod exploration;
pub mod learner;
pub mod pace;
pub mod replay;
pub mod run;
pub mod settings;
pub mod store;
pub mod transitions;

pub use algorithm::{Algorithm, Preset};
pub use learner::{Episode, Learner};
pub use run::{EpisodeSummary, Training};
pub use settings::RunSettings;
