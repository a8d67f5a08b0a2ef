//! The orders that a page can give.

use serde::Deserialize;

/// An order of the page.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "order", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Order {
    /// Switch the controller to another policy.
    Policy {
        /// The policy's name on the controller's command line.
        name: String,
    },
    /// Change the optical power.
    Power {
        /// In W, more than 0.
        watts: f32,
    },
    /// Block the direct paths of the first users by order, and end this for the others.
    Blocked {
        /// Number of users.
        users: u32,
    },
    /// Change the walking speed of the users; at 0 they stand.
    Speed {
        /// Highest speed in m/s; the lowest is a twentieth of it.
        max_m_s: f32,
    },
    /// Make some of the mirrors stick at their present angles.
    Stick {
        /// Share of all mirrors, above 0 and at most 1.
        share: f32,
    },
    /// Make all mirrors follow commands again.
    Release,
    /// Emergency stop.
    Stop,
    /// End of the emergency stop.
    Rearm,
    /// Kill the controller's process.
    KillController,
    /// Start a new controller after the previous one was killed.
    RestartController,
}

/// An order for the program that started the processes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProcessOrder {
    /// Kill the controller without a request to end.
    KillController,
    /// Start a controller if none runs.
    RestartController,
}
