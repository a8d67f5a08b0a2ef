//! Turns of tests that compute for most of their time.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::sync::{Condvar, LazyLock, Mutex};
use std::thread::{ThreadId, available_parallelism, current};

use heliostat_service::locks::{lock, unpoisoned};

/// A turn of a test: at most as many tests of a process have one at once as the machine has processors.
///
/// Tests wait for most of their time, so that more run at once; those with a browser compute. A test that has a turn
/// takes more of them at once.
pub struct Turn(ThreadId);

/// The threads of the tests that have a turn, with the number of theirs.
static TAKEN: LazyLock<Mutex<HashMap<ThreadId, usize>>> = LazyLock::new(Mutex::default);
static ENDED: Condvar = Condvar::new();

impl Turn {
    /// Waits for a turn.
    pub fn wait() -> Self {
        let most = available_parallelism().map_or(1, usize::from);
        let test = current().id();
        let is_full = |taken: &mut HashMap<ThreadId, usize>| taken.len() >= most && !taken.contains_key(&test);
        let mut taken = unpoisoned(ENDED.wait_while(lock(&TAKEN), is_full));
        *taken.entry(test).or_default() += 1;
        Self(test)
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        if let Entry::Occupied(mut of_test) = lock(&TAKEN).entry(self.0) {
            *of_test.get_mut() -= 1;
            if *of_test.get() == 0 {
                of_test.remove();
            }
        }
        ENDED.notify_one();
    }
}
