//! How a controller shares a backlog between its threads.

use rand::RngExt;

use crate::random::Rng;

/// Payloads that the receive queue of a room holds.
const QUEUE: usize = 64;

/// How many payloads the room's thread finds in the receive queue each time that it runs.
pub(super) struct Batches {
    /// Most payloads of a batch, by the load of the machine; absent without a backlog.
    most: Option<usize>,
    left: usize,
}

impl Batches {
    /// The batches of a backlog, or without one payloads that arrive alone.
    pub fn new(rng: Option<&mut Rng>) -> Self {
        Self { most: rng.map(|rng| 1 << rng.random_range(0..=QUEUE.ilog2())), left: 0 }
    }

    /// Whether the room's thread decides after the next payload.
    pub fn is_last(&mut self, rng: &mut Rng) -> bool {
        if let (0, Some(most)) = (self.left, self.most) {
            self.left = rng.random_range(1..=most);
        }
        self.left = self.left.saturating_sub(1);
        self.left == 0
    }
}
