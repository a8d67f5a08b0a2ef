//! The messages of one key, for a command that waits for some of them: in a queue, or as the answer to a query.

use std::sync::mpsc::{self, Receiver};
use std::thread;
use std::time::{Duration, Instant};

use heliostat_proto::{Message, decode};

use crate::error::BusError;
use crate::session::{Bus, Subscription};

/// Time between two queries.
const QUERY_EVERY: Duration = Duration::from_millis(50);

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

/// The first answer to a query of a key within a limit. The query is repeated, because a new session may not know the
/// process that answers yet.
///
/// # Errors
/// A closed session.
pub fn fetch<T: Message>(bus: &Bus, key: &str, limit: Duration) -> Result<Option<T>, BusError> {
    let until = Instant::now() + limit;
    loop {
        let found = bus.fetch(key, limit)?.iter().find_map(|payload| decode(payload).ok());
        if found.is_some() || Instant::now() >= until {
            return Ok(found);
        }
        thread::sleep(QUERY_EVERY);
    }
}
