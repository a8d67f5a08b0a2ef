//! The drivers that a controller has lost, as counters in its status.

use crate::array_keys::array_name;
use crate::limits::{MAX_ARRAYS, Nanos};
use crate::messages::NodeStatus;

/// Beginning of the names of the counters; array and source follow.
const NAME: &str = "driver_lost:";

const NS_PER_S: Nanos = 1_000_000_000;

/// A driver or a simulator of an array that a controller has lost: its liveliness token has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LostDriver {
    /// Index of the array.
    pub array: usize,
    /// Source id in the stamps of the driver.
    pub source: u64,
    /// When the token ended, UTC in ns by the clock of the controller.
    pub since_ns: Nanos,
}

impl LostDriver {
    /// Name and value of its counter; the value is the time in s.
    pub fn counter(&self) -> (String, u64) {
        (format!("{NAME}{}:{:016x}", array_name(self.array), self.source), self.since_ns / NS_PER_S)
    }

    /// All lost drivers in a status.
    pub fn all_of(status: &NodeStatus) -> Vec<Self> {
        let of = |(name, since_s): &(String, u64)| {
            let (of, source) = name.strip_prefix(NAME)?.split_once(':')?;
            let array = (0..MAX_ARRAYS).find(|array| array_name(*array) == of)?;
            let source = u64::from_str_radix(source, 16).ok()?;
            Some(Self { array, source, since_ns: since_s.saturating_mul(NS_PER_S) })
        };
        status.counters.iter().filter_map(of).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lost_drivers_are_read_from_the_counters_that_they_wrote() {
        let lost = |array, source, since_s| LostDriver { array, source, since_ns: since_s * NS_PER_S };
        let all = vec![lost(0, 7, 43_384), lost(2, u64::MAX, 1_800_000_000)];
        let mut counters: Vec<(String, u64)> = all.iter().map(LostDriver::counter).collect();
        assert_eq!(counters[1], ("driver_lost:mirrors-2:ffffffffffffffff".to_owned(), 1_800_000_000));
        let unread =
            ["driver_lost:mirrors-99:7", "driver_lost:mirrors:x", "driver_lost:mirrors", "driver_absent:mirrors"];
        counters.extend(unread.map(|name| (name.to_owned(), 1)));
        assert_eq!(LostDriver::all_of(&NodeStatus { counters, ..NodeStatus::default() }), all);
    }
}
