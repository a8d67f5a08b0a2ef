//! The two processes of a demo, and what the page may do to them.

use std::time::Duration;

use anyhow::{Context, Result};
use heliostat_ui::Errand;
use serde_json::Value;

use super::child::Part;

/// How long a process may take to end once it was asked to.
const END_PATIENCE: Duration = Duration::from_secs(10);

/// The two processes.
pub struct Parts {
    room: Part,
    /// Nothing while it is killed by order.
    controller: Option<Part>,
}

impl Parts {
    /// Starts both.
    pub fn start(room: &[String], controller: &[String]) -> Result<Self> {
        Ok(Self { room: Part::start("sim-node", room)?, controller: Some(Part::start("controller", controller)?) })
    }

    /// The operating system's numbers: of the room and of the controller.
    pub fn ids(&self) -> (u32, Option<u32>) {
        (self.room.id(), self.controller.as_ref().map(Part::id))
    }

    /// An error with the last words of a process that ended though nobody asked it to.
    pub fn check_alive(&mut self) -> Result<()> {
        self.room.check_alive()?;
        self.controller.as_mut().map_or(Ok(()), Part::check_alive)
    }

    /// Kills or revives the controller; `arguments` are those of a new one.
    pub fn run(&mut self, errand: Errand, arguments: impl FnOnce() -> Result<Vec<String>>) -> Result<()> {
        match errand {
            // Dropping a part kills it.
            Errand::KillController => self.controller = None,
            Errand::ReviveController if self.controller.is_none() => {
                self.controller =
                    Some(Part::start("controller", &arguments()?).context("the controller was not revived")?);
            }
            Errand::ReviveController => {}
        }
        Ok(())
    }

    /// Ends both, and gives what they printed last; nothing of a controller that is killed.
    pub fn finish(self) -> Result<(Value, Option<Value>)> {
        // The room first: a tick that nobody answers because the controller has already gone is no lost tick.
        let room = self.room.finish(END_PATIENCE)?;
        let controller = self.controller.map(|controller| controller.finish(END_PATIENCE)).transpose()?;
        Ok((room, controller))
    }
}
