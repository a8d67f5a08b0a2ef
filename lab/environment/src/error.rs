//! Why an environment cannot be made, or refuses a step.

use heliostat_array::rules::Refusal;
use heliostat_channel::ChannelError;
use heliostat_core::observation::EncodeError;
use heliostat_room::world::WorldError;
use thiserror::Error;

/// Why an environment cannot be made, or refuses a step.
#[derive(Debug, Error)]
pub enum EnvironmentError {
    /// The scenario describes no room.
    #[error(transparent)]
    World(#[from] WorldError),
    /// The scenario describes no channel.
    #[error(transparent)]
    Channel(#[from] ChannelError),
    /// The users or mirrors do not fit the vector.
    #[error(transparent)]
    Encode(#[from] EncodeError),
    /// Users come and go, where their number must be fixed.
    #[error(
        "users.arrivals: training and held-out states need a fixed number of users; remove the arrivals, or measure \
         them with `heliostat-lab eval --closed-loop`"
    )]
    Arrivals,
    /// The true room differs from the assumed one, where a learner sees the true one.
    #[error(
        "{0}: training and held-out states show the true room to the policy; expected no mismatch, or measure it with \
         `heliostat-lab eval --closed-loop`"
    )]
    Mismatch(&'static str),
    /// A key that has an effect in closed loop only.
    #[error(
        "{0}: no effect on exact states without reports, whose mirrors turn at once; remove it, or choose a closed \
         loop: `heliostat-lab eval --closed-loop`, in Python dynamics=\"closed-loop\""
    )]
    ClosedLoopOnly(String),
    /// A key that has no effect on training.
    #[error("{0}: no effect on training, whose states are exact and whose mirrors turn at once; remove it")]
    NotInTraining(String),
    /// The array refused a command.
    #[error("the array refused a command: {0:?}; this is a fault of the environment, please report it")]
    Refused(Refusal),
    /// Reports are too old when they arrive.
    #[error("reports are older than control.report_age_max_ms when they arrive; raise it, or lower the latency")]
    Stale,
    /// No position report comes.
    #[error("streams.positions: no position report came in 60 s of simulated time; raise rate_hz, or lower loss")]
    Silence,
    /// The action has another length.
    #[error("an action of length {found}, expected {expected}: {meaning}")]
    ActionLength {
        /// Its length.
        found: usize,
        /// The length of an action.
        expected: usize,
        /// What the entries mean.
        meaning: &'static str,
    },
    /// A component of the action is not finite.
    #[error("the action holds {value} at index {index}, expected finite numbers; those beyond -1 to 1 are clamped")]
    NotFinite {
        /// Index of the first such component.
        index: usize,
        /// Its value.
        value: f32,
    },
    /// A setting outside its domain.
    #[error("{name} = {value}: expected {expected}")]
    Setting {
        /// The setting.
        name: &'static str,
        /// Its value.
        value: String,
        /// The values that are accepted.
        expected: &'static str,
    },
}
