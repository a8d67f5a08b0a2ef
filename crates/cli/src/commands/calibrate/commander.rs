//! Publishes the commands of a calibration to its array.

use anyhow::Result;
use heliostat_bus::Publisher;
use heliostat_calibrate::commander::Commander;
use heliostat_channel::MirrorAngles;
use heliostat_proto::{MirrorCommand, Nanos, encode};

/// A [`Commander`] and the key of its array.
pub struct PublishedCommands {
    /// What decides about the commands.
    pub commander: Commander,
    publisher: Publisher,
    payload: Vec<u8>,
}

impl PublishedCommands {
    /// Publishes through this publisher.
    pub fn new(commander: Commander, publisher: Publisher) -> Self {
        Self { commander, publisher, payload: Vec::new() }
    }

    /// Answers a position report by the last angles.
    pub fn answer(&mut self, now: Nanos, tick: u64) -> Result<()> {
        let command = self.commander.answer(now, tick);
        self.publish(command)
    }

    /// Commands these angles.
    pub fn command(&mut self, now: Nanos, angles: MirrorAngles) -> Result<()> {
        let command = self.commander.command(now, angles);
        self.publish(command)
    }

    fn publish(&mut self, command: Option<MirrorCommand>) -> Result<()> {
        let Some(command) = command else { return Ok(()) };
        self.payload.clear();
        encode(&command, &mut self.payload)?;
        Ok(self.publisher.put(&self.payload)?)
    }
}
