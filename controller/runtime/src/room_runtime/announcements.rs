//! Announcements of arrays, orders and liveliness tokens on their way to the core of the room.
//!
//! A callback of the transport never waits for the decision loop: a policy that does not return holds
//! it, and the transport has few threads for all sessions of the process. A callback queues its
//! message. The thread that has the decision loop handles the queue when it releases the loop.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex},
};

use heliostat_core::room_core::{Examination, Handled, Input, InputKey, Repeater};
use heliostat_service::clock::utc_ns;
use heliostat_service::locks::{lock, try_lock};

use super::decision_loop::DecisionLoop;

/// Most messages that wait; beyond that the oldest announcement is dropped, because arrays repeat
/// theirs. No process repeats a stop order to this one, or a token; the [`Repeater`] has noted the order.
const CAPACITY: usize = 256;

/// A message that waits for the decision loop.
enum Announcement {
    Payload { key: InputKey, bytes: Vec<u8> },
    Presence { token: String, is_alive: bool },
    Unexamined(Box<Examination>),
    Examined(Input<'static>),
}

impl Announcement {
    fn is_unexamined(&self) -> bool {
        matches!(self, Self::Unexamined(_))
    }

    fn input(&mut self) -> Input<'_> {
        match self {
            Self::Payload { key, bytes } => Input::Payload { key: *key, bytes },
            Self::Presence { token, is_alive } => Input::Presence { token, is_alive: *is_alive },
            Self::Examined(input) => std::mem::replace(input, Input::Wake),
            Self::Unexamined(_) => Input::Wake,
        }
    }
}

/// The entry of announcements, orders and liveliness tokens. None of them is in the decision path.
#[derive(Clone)]
pub struct Announcements {
    decision_loop: Arc<Mutex<DecisionLoop>>,
    repeater: Arc<Mutex<Repeater>>,
    waiting: Arc<Mutex<VecDeque<Announcement>>>,
}

impl Announcements {
    /// No message waits for this loop yet.
    pub fn new(decision_loop: &Arc<Mutex<DecisionLoop>>, repeater: &Arc<Mutex<Repeater>>) -> Self {
        Self { decision_loop: Arc::clone(decision_loop), repeater: Arc::clone(repeater), waiting: Arc::default() }
    }

    /// Handles a payload, now or when the decision loop is released.
    pub fn handle(&self, key: InputKey, payload: &[u8]) {
        if key == InputKey::Stop {
            // The decision loop can be locked by a policy that does not return.
            lock(&self.repeater).note_order(utc_ns(), payload);
        }
        self.push(Announcement::Payload { key, bytes: payload.to_vec() });
    }

    /// Handles a change of a liveliness token, now or when the decision loop is released.
    pub fn handle_presence(&self, token: &str, is_alive: bool) {
        self.push(Announcement::Presence { token: token.to_owned(), is_alive });
    }

    /// Handles what waits, unless another thread has the decision loop: that one does so when it
    /// releases the loop.
    pub fn settle(&self) {
        while !lock(&self.waiting).is_empty() {
            let Some(mut decision_loop) = try_lock(&self.decision_loop) else { return };
            self.settle_in(&mut decision_loop);
            drop(decision_loop);
            // It takes long, so it does not hold the lock.
            let Some(Announcement::Unexamined(examination)) = self.take(|one| one.is_unexamined()) else { return };
            let examined = Announcement::Examined(examination.run());
            lock(&self.waiting).push_front(examined);
        }
    }

    /// Handles what waits for a loop that this thread has, such as a stop before the report that the loop
    /// decides for. What takes long waits for [`settle`](Self::settle).
    pub fn settle_in(&self, decision_loop: &mut DecisionLoop) {
        while let Some(mut next) = self.take(|one| !one.is_unexamined()) {
            if let Handled::Examination(examination) = decision_loop.handle(next.input()) {
                lock(&self.waiting).push_back(Announcement::Unexamined(examination));
            }
        }
    }

    /// The first of these that waits.
    fn take(&self, is_wanted: impl Fn(&Announcement) -> bool) -> Option<Announcement> {
        let mut waiting = lock(&self.waiting);
        let index = waiting.iter().position(is_wanted)?;
        waiting.remove(index)
    }

    fn push(&self, announcement: Announcement) {
        let mut waiting = lock(&self.waiting);
        if waiting.len() == CAPACITY {
            let is_repeated =
                |one: &Announcement| matches!(one, Announcement::Payload { key, .. } if *key != InputKey::Stop);
            let least = waiting.iter().position(is_repeated).unwrap_or_default();
            waiting.remove(least);
        }
        waiting.push_back(announcement);
        drop(waiting);
        self.settle();
    }
}
