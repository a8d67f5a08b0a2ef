//! Encodes and publishes the commands to each array.

use heliostat_bus::Publisher;
use heliostat_core::core::Decision;
use heliostat_proto::{MirrorCommand, encode};

/// The publisher of each array, and its payload buffer.
pub struct CommandSender {
    arrays: Vec<(Publisher, Vec<u8>)>,
}

impl CommandSender {
    /// A sender for arrays of these numbers of mirrors.
    pub fn new(arrays: impl IntoIterator<Item = (Publisher, usize)>) -> Self {
        // Two f32 per mirror, and less than 100 bytes for the other fields.
        let buffered = |(publisher, mirrors): (Publisher, usize)| (publisher, Vec::with_capacity(100 + 8 * mirrors));
        Self { arrays: arrays.into_iter().map(buffered).collect() }
    }

    /// Publishes the commands of a decision, if it has any; false where the transport refuses one.
    /// Does not allocate.
    pub fn send(&mut self, decision: Decision<'_>) -> bool {
        decision.commands().fold(true, |is_sent, (array, command)| self.publish(array, command) && is_sent)
    }

    /// A command of the core always encodes, so only the transport fails.
    fn publish(&mut self, array: usize, command: &MirrorCommand) -> bool {
        let (publisher, payload) = &mut self.arrays[array];
        encode(command, payload).is_ok() && publisher.put(payload).is_ok()
    }
}
