//! The drivers that a room has lost: the counters of the status, and the lines of the journal.

use heliostat_proto::{LostDriver, array_keys::array_name};

use super::status::{Problem, Subject};

/// The lost drivers of a room, and those of them that the journal has named.
#[derive(Default)]
pub struct LostDrivers {
    /// Each with whether another driver served its array then. The absence of the only one has its own line.
    all: Vec<(LostDriver, bool)>,
    named: Vec<LostDriver>,
}

impl LostDrivers {
    /// Replaces all of them.
    pub fn set(&mut self, all: Vec<(LostDriver, bool)>) {
        self.named.retain(|driver| all.contains(&(*driver, true)));
        self.all = all;
    }

    /// Name and value of the counter of each.
    pub fn counters(&self) -> impl Iterator<Item = (String, u64)> {
        self.all.iter().map(|(driver, _)| driver.counter())
    }

    /// The next one that left beside another driver, once.
    pub fn news(&mut self) -> Option<(Subject, Problem)> {
        let is_news = |(driver, had_other): &&(LostDriver, bool)| *had_other && !self.named.contains(driver);
        let (driver, _) = *self.all.iter().find(is_news)?;
        self.named.push(driver);
        let (source, array) = (driver.source, array_name(driver.array));
        let text = format!(
            "driver {source:016x} of {array} has left the room, and another one serves this array: a stop stays \
             unconfirmed until it returns, or until the release of the stop"
        );
        Some((Subject::Driver, Problem::End(text)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_driver_that_left_beside_another_one_is_named_once_and_again_after_its_return() {
        let driver = |source, since_ns| LostDriver { array: 1, source, since_ns };
        let (only, second) = ((driver(5, 1), false), driver(7, 2));
        let mut lost = LostDrivers::default();
        let mut news = |second: &[LostDriver]| {
            lost.set([only].into_iter().chain(second.iter().map(|driver| (*driver, true))).collect());
            assert_eq!(lost.counters().count(), 1 + second.len());
            match lost.news() {
                Some((Subject::Driver, Problem::End(text))) => text,
                Some(_) => panic!("expected information about a driver"),
                None => String::new(),
            }
        };
        assert_eq!(news(&[]), "", "its absence is reported as such");
        let text = news(&[second]);
        assert!(text.starts_with("driver 0000000000000007 of mirrors-1 has left the room, and another one"), "{text}");
        assert_eq!(news(&[second]), "");
        assert_eq!(news(&[]), "", "it is back");
        assert_ne!(news(&[driver(7, 9)]), "");
    }
}
