//! Replays a recording into the controller core of this process, and compares every command.
//!
//! The core is a function of `(now, message)`. A recording holds the messages; the source of `now`
//! depends on the run:
//!
//! - **lockstep**: the stamps of the messages. Every command must be equal bit for bit.
//! - **live**: for an answered position report, the time in the command that answers it, which is
//!   exact. For any other message, the time at which the recorder received it; this only matters
//!   for a message close to its maximum age. A report without a command is skipped: the controller
//!   may not have received it, or may have dropped it for a newer one. A command that repeats the
//!   one before it is replayed as a late decision, if the controller counted any.
//!
//! A recording cannot hold messages that the controller received before the recording started. It
//! holds the controller's state once a second, with the inputs in between, where the controller
//! publishes both: the replay repeats these inputs (`schedule.rs`), and compares commands from the
//! first state on. Without such states, the first [`SETTLE`] decisions of an epoch are replayed but
//! not compared. A lockstep epoch recorded from its first command needs neither.

mod comparison;
mod epoch;
mod inputs;
mod plan;
mod player;
mod schedule;
mod scheduled;
mod settings;
mod verdict;

use anyhow::{Context, Result};

pub(crate) use plan::Beginning;
pub use plan::Clock;
pub(crate) use settings::unusable;
pub use settings::{SETTLE, Settings};
pub(crate) use verdict::difference;
pub use verdict::{LeftOut, Verdict};

use crate::file::open;
use plan::Plan;
use player::Player;

/// Replays a recording into a controller of this process.
///
/// # Errors
/// [`UnusableInput`](heliostat_service::exit::UnusableInput) if the recording cannot be read or lacks a required stream; a policy that cannot
/// be built.
pub fn run(settings: &Settings) -> Result<Verdict> {
    let plan = Plan::read(&settings.file, settings.policy.is_some()).with_context(|| unusable(&settings.file))?;
    let mut reading = open(&settings.file)?;
    let mut player = Player::new(settings, plan)?;
    while let Some(entry) = reading.entry()? {
        player.take(&entry)?;
    }
    Ok(player.finish(&settings.file, &reading))
}
