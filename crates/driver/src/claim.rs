//! The claim of a process to its arrays: its liveliness token, and the watch over the tokens of other
//! processes with the same mirrors. [`heliostat_array::others`] has the rules.
//!
//! The calling order is:
//!
//! 1. [`Claim::begin`]: it refuses a room with the token of another process.
//! 2. The caller declares its publishers and subscriptions.
//! 3. [`Claim::announce`]: it refuses a room in which such a token has appeared meanwhile, and declares the own token.
//! 4. [`Claim::check`] in the loop of the process, until its end.

use std::ops::Range;
use std::sync::{Arc, Mutex};

use heliostat_array::others::Others;
use heliostat_bus::{Bus, Presence, Subscription, Token};
use heliostat_proto::NodeKind;
use heliostat_service::clock::monotonic_ns;
use heliostat_service::locks::lock;

use crate::session::{ALIVE_LIMIT, SessionError};

/// The claim of a process to arrays of its room; dropping it withdraws the token.
pub struct Claim {
    others: Arc<Mutex<Others>>,
    /// Absent until it is announced.
    token: Option<Token>,
    _watches: Vec<Subscription>,
}

impl Claim {
    /// Begins to watch the tokens of other drivers of these arrays and of simulators; `source` is the id in the
    /// stamps of this process.
    ///
    /// # Errors
    /// [`SessionError::RoomTaken`] if there is such a token, or a transport that fails.
    pub fn begin(bus: &Bus, arrays: Range<usize>, source: u64) -> Result<Self, SessionError> {
        let room = bus.room();
        let others = Arc::new(Mutex::new(Others::new(room.to_string(), source)));
        let drivers = arrays.map(|array| room.array(array).drivers_alive());
        let patterns: Vec<String> = std::iter::once(room.alive_of(NodeKind::SimNode)).chain(drivers).collect();
        let mut watches = Vec::new();
        for pattern in &patterns {
            let watched = Arc::clone(&others);
            let note = move |token: &str, presence: Presence| {
                lock(&watched).note(token, presence == Presence::Alive, monotonic_ns());
            };
            watches.push(bus.watch(pattern, note)?);
        }
        // The watch does not say when it has received the present tokens. The query does.
        for pattern in &patterns {
            for token in bus.alive(pattern, ALIVE_LIMIT)? {
                lock(&others).note(&token, true, monotonic_ns());
            }
        }
        lock(&others).check_free()?;
        Ok(Self { others, token: None, _watches: watches })
    }

    /// Declares the token of this process.
    ///
    /// # Errors
    /// [`SessionError::RoomTaken`] if another token has appeared since the begin, or a transport that fails.
    pub fn announce(&mut self, bus: &Bus, token: &str) -> Result<(), SessionError> {
        // Before the token, so that each token that arrives from now on is compared.
        lock(&self.others).announce(monotonic_ns())?;
        self.token = Some(bus.announce(token)?);
        Ok(())
    }

    /// Judges the other processes. `late` takes each problem once: a process that goes on beside this one.
    ///
    /// # Errors
    /// [`SessionError::RoomTaken`] if this process has to end.
    pub fn check(&self, late: impl FnMut(String)) -> Result<(), SessionError> {
        let findings = lock(&self.others).check(monotonic_ns())?;
        findings.notes.iter().for_each(|note| tracing::warn!("{note}"));
        findings.problems.into_iter().for_each(late);
        Ok(())
    }

    /// Number of other processes that are in the room.
    pub fn count(&self) -> u64 {
        lock(&self.others).count()
    }

    /// The problems of the other processes that are in the room.
    pub fn others(&self) -> Vec<String> {
        lock(&self.others).problems()
    }
}
