//! The drivers that a room has lost: the counters of the status, and the lines of the journal.

use heliostat_proto::{LostDriver, array_keys::array_name};

use super::status::{Problem, Subject};

/// The lost drivers of a room, and those of them that the journal has named.
#[derive(Default)]
pub struct LostDrivers {
    all: Vec<LostDriver>,
    /// Those that left while another driver served their array. The absence of the only one has its own line.
    beside_others: Vec<LostDriver>,
    named: Vec<LostDriver>,
}

impl LostDrivers {
    /// Replaces all of them.
    pub fn set(&mut self, all: Vec<LostDriver>, beside_others: Vec<LostDriver>) {
        self.named.retain(|driver| beside_others.contains(driver));
        (self.all, self.beside_others) = (all, beside_others);
    }

    /// Name and value of the counter of each.
    pub fn counters(&self) -> impl Iterator<Item = (String, u64)> {
        self.all.iter().map(LostDriver::counter)
    }

    /// The next one that left beside another driver, once.
    pub fn news(&mut self) -> Option<(Subject, Problem)> {
        let driver = *self.beside_others.iter().find(|driver| !self.named.contains(driver))?;
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
        let (only, second) = (driver(5, 1), driver(7, 2));
        let mut lost = LostDrivers::default();
        let mut news = |second: &[LostDriver]| {
            lost.set([&[only][..], second].concat(), second.to_vec());
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
