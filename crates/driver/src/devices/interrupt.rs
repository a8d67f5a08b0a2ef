//! A stop that ends the wait of a board's thread for its device.

use std::io::{Read, Write};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::net::UnixStream;
use std::sync::atomic::{AtomicU64, Ordering};

/// Counts the stops that were ordered, and wakes the thread that waits for a device.
///
/// Neither side waits for the other.
#[derive(Debug)]
pub struct Interrupt {
    ordered: AtomicU64,
    wake: UnixStream,
    woken: UnixStream,
}

impl Interrupt {
    /// An interrupt without a stop.
    ///
    /// # Errors
    /// The operating system provides no pair of sockets.
    pub fn new() -> std::io::Result<Self> {
        let (wake, woken) = UnixStream::pair()?;
        wake.set_nonblocking(true)?;
        woken.set_nonblocking(true)?;
        Ok(Self { ordered: AtomicU64::new(0), wake, woken })
    }

    /// Orders a stop; returns its number, from 1.
    pub fn order(&self) -> u64 {
        let number = self.ordered.fetch_add(1, Ordering::SeqCst) + 1;
        self.wake();
        number
    }

    /// The number of the last stop; 0 before the first.
    pub fn ordered(&self) -> u64 {
        self.ordered.load(Ordering::SeqCst)
    }

    /// Ends the wait of a port.
    fn wake(&self) {
        // A full buffer wakes the reader too.
        let _ = (&self.wake).write(&[0]);
    }

    /// Takes back all wake-ups so far.
    pub fn clear(&self) {
        let mut bytes = [0; 64];
        while (&self.woken).read(&mut bytes).is_ok_and(|count| count == bytes.len()) {}
    }
}

impl AsFd for Interrupt {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.woken.as_fd()
    }
}
