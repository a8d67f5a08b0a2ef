//! A stop that ends the wait of a board's thread for its device.

use std::sync::atomic::{AtomicU64, Ordering};

use crate::devices::system::WakeUp;

/// Counts the stops that were ordered, and wakes the thread that waits for a device.
///
/// Neither side waits for the other.
#[derive(Debug)]
pub struct Interrupt {
    ordered: AtomicU64,
    wake_up: WakeUp,
}

impl Interrupt {
    /// An interrupt without a stop.
    ///
    /// # Errors
    /// The operating system provides no pair of sockets, or has no such sockets.
    pub fn new() -> std::io::Result<Self> {
        Ok(Self { ordered: AtomicU64::new(0), wake_up: WakeUp::new()? })
    }

    /// Orders a stop; returns its number, from 1.
    pub fn order(&self) -> u64 {
        let number = self.ordered.fetch_add(1, Ordering::SeqCst) + 1;
        self.wake_up.wake();
        number
    }

    /// The number of the last stop; 0 before the first.
    pub fn ordered(&self) -> u64 {
        self.ordered.load(Ordering::SeqCst)
    }

    /// What ends the wait of a port.
    pub(super) fn wake_up(&self) -> &WakeUp {
        &self.wake_up
    }
}
