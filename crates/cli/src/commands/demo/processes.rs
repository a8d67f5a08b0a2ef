//! The two processes of a demo, and the orders of the page for them.

use std::time::Duration;

use anyhow::{Context, Error, Result};
use heliostat_ui::ProcessOrder;
use serde_json::Value;

use super::child::ChildProcess;

/// The command of the room's process.
pub const ROOM: &str = "sim-node";
/// Time limit for the end of a process after the request.
const END_LIMIT: Duration = Duration::from_secs(10);

/// The two processes.
pub struct Processes {
    room: ChildProcess,
    /// `None` after it was killed by order.
    controller: Option<ChildProcess>,
    /// Controllers started so far.
    controllers: u64,
}

impl Processes {
    /// Starts both.
    pub fn start(room: &[String], controller: &[String]) -> Result<Self> {
        Ok(Self {
            room: ChildProcess::start(ROOM, room)?,
            controller: Some(ChildProcess::start("controller", controller)?),
            controllers: 1,
        })
    }

    /// The process ids of the room and of the controller.
    pub fn ids(&self) -> (u32, Option<u32>) {
        (self.room.id(), self.controller.as_ref().map(ChildProcess::id))
    }

    /// The command of the next process that has ended without a request, and an error with its last output; each end
    /// once.
    pub fn next_ended(&mut self) -> Option<(&'static str, Error)> {
        let mut processes = [Some(&mut self.room), self.controller.as_mut()].into_iter().flatten();
        processes.find_map(|process| process.check_alive().err().map(|error| (process.name(), error)))
    }

    /// Kills the controller, or replaces it; `arguments` are those of the new one. A controller that hangs is
    /// replaced too.
    pub fn apply(&mut self, order: ProcessOrder, arguments: impl FnOnce() -> Result<Vec<String>>) -> Result<()> {
        match order {
            // Dropping the process kills it.
            ProcessOrder::KillController => self.controller = None,
            ProcessOrder::RestartController => {
                // The new one listens at the same endpoint.
                self.controller = None;
                self.controller =
                    Some(ChildProcess::start("controller", &arguments()?).context("the controller was not restarted")?);
                self.controllers += 1;
            }
        }
        Ok(())
    }

    /// Controllers started so far.
    pub fn controllers(&self) -> u64 {
        self.controllers
    }

    /// Ends both, and returns the summary of each, or how it ended; `None` for a controller that was
    /// killed by order.
    pub fn finish(self) -> (Result<Value>, Option<Result<Value>>) {
        // The room ends first, so that no tick counts as lost because the controller has ended.
        let room = self.room.finish(END_LIMIT);
        (room, self.controller.map(|controller| controller.finish(END_LIMIT)))
    }
}
