//! The random number by which others know one publisher.

use std::hash::{BuildHasher, RandomState};

use crate::clock::utc_ns;

/// A number that two publishers are most unlikely to share.
///
/// The operating system seeds the standard library's hashers. Process id and time separate
/// processes on systems whose seed repeats.
pub fn random() -> u64 {
    RandomState::new().hash_one((std::process::id(), utc_ns()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_ids_of_one_process_differ() {
        assert_ne!(random(), random());
    }
}
