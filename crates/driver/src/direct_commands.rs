//! Commands of a controller in the same process: they reach the array without a second socket.
//!
//! # Theory of Operation
//!
//! [`DirectCommands::apply`] runs on the thread that decides. It handles the command in the array's
//! station if no other thread holds it and no message waits; otherwise it queues the command for the
//! array's thread, as if it had arrived from the transport. It waits for nothing:
//!
//! - The array's thread holds the station while it handles a message. The command is then queued.
//! - A stop that waits for the array's thread keeps every later command in the queue behind it.
//! - After the array's thread has ended, no command turns a mirror: nothing would handle a stop.
//!
//! The device must return from each call without waiting for hardware, like
//! [`Wall`](crate::devices::wall::Wall): otherwise a command delays the next stop.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};

use heliostat_array::content::Content;
use heliostat_array::device::Device;
use heliostat_array::station::Station;
use heliostat_proto::{MirrorCommand, decode_into};
use heliostat_service::locks::lock;

use crate::clock::Clock;
use crate::receive_queue::ReceiveQueue;

/// The station of an array, for its thread and for [`DirectCommands`].
pub(crate) struct SharedStation<D> {
    station: Mutex<Station<D>>,
    /// Local time until which the array's thread waits for a message.
    wakes_ns: AtomicU64,
    /// Whether the array's thread runs.
    is_running: AtomicBool,
}

impl<D: Device> SharedStation<D> {
    pub(crate) fn new(station: Station<D>) -> Self {
        Self { station: Mutex::new(station), wakes_ns: AtomicU64::new(0), is_running: AtomicBool::new(false) }
    }

    /// The station, for the array's thread: [`DirectCommands`] hold it only while they handle a command.
    pub(crate) fn lock(&self) -> MutexGuard<'_, Station<D>> {
        lock(&self.station)
    }

    /// When the array's thread must wake if no message arrives, in local time.
    pub(crate) fn plan_wake(&self) -> u64 {
        let station = self.lock();
        let next_ns = station.next_ns();
        // Under the lock, so that a direct command compares with it.
        self.wakes_ns.store(next_ns, Ordering::SeqCst);
        next_ns
    }

    /// Direct commands are handled until the result is dropped.
    pub(crate) fn run(self: &Arc<Self>) -> Running<D> {
        self.is_running.store(true, Ordering::SeqCst);
        Running(Arc::clone(self))
    }
}

/// The array's thread runs; also a panic ends this.
pub(crate) struct Running<D>(Arc<SharedStation<D>>);

impl<D> Drop for Running<D> {
    fn drop(&mut self) {
        self.0.is_running.store(false, Ordering::SeqCst);
    }
}

/// The entry of commands from a controller in the same process; the [module](self) describes it.
pub struct DirectCommands<D> {
    shared: Arc<SharedStation<D>>,
    received: Arc<ReceiveQueue>,
    clock: Clock,
    /// Decoded into.
    command: MirrorCommand,
}

impl<D: Device> DirectCommands<D> {
    pub(crate) fn new(shared: Arc<SharedStation<D>>, received: Arc<ReceiveQueue>, clock: Clock) -> Self {
        Self { shared, received, clock, command: MirrorCommand::default() }
    }

    /// Handles the payload of a command, or queues it. Does not wait, and allocates only for a command
    /// that is queued or refused.
    pub fn apply(&mut self, payload: &[u8]) {
        let at = self.clock.now();
        if let Err(error) = decode_into(&mut self.command, payload) {
            self.received.push(at, Content::Command(Err(error)));
            return;
        }
        let is_next = self.received.pass_on(&self.command);
        // A poisoned lock is of a thread that has ended.
        let free = is_next.then(|| self.shared.station.try_lock().ok()).flatten();
        let Some(mut station) = free else {
            self.received.push_passed_on(at, self.command.clone());
            return;
        };
        if !self.shared.is_running.load(Ordering::SeqCst) {
            return;
        }
        station.handle_command(at, &self.command);
        let is_due = station.has_changed() || station.next_ns() < self.shared.wakes_ns.load(Ordering::SeqCst);
        drop(station);
        if is_due {
            self.received.wake();
        }
    }
}
