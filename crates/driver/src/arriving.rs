//! The messages of one key in a queue, for a command that waits for some of them.

use std::sync::mpsc::{self, Receiver};

use heliostat_bus::{Bus, BusError, Subscription};
use heliostat_proto::{Message, decode};

/// The messages that arrive under a key while the subscription lasts.
///
/// # Errors
/// A closed session.
pub fn arriving<T: Message + Send + 'static>(bus: &Bus, key: &str) -> Result<(Receiver<T>, Subscription), BusError> {
    let (sender, arrived) = mpsc::channel();
    let subscription = bus.subscribe(key, move |payload| {
        if let Ok(message) = decode::<T>(payload) {
            // The receiver is gone after the last one that counts.
            sender.send(message).ok();
        }
    })?;
    Ok((arrived, subscription))
}
