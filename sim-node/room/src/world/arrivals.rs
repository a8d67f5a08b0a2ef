//! Users who enter and leave the room.
//!
//! Arrivals form a Poisson process, and stays have an exponential distribution: an M/M/c/c queue,
//! whose c is the largest number of users. The users at the start leave too. An arrival at a full
//! room does not enter; its stay is drawn all the same, so that the limit does not change the later
//! draws. The times depend on the seed alone, never on the mirrors: two policies have the same
//! users in the same room.
//!
//! The room has no door. A user appears where a user of the same walk would be at a random time,
//! and leaves from where it is.

use heliostat_scenario::Arrivals as Settings;
use serde::Serialize;

use crate::random::{self, Purpose, RoomRng};

/// A user enters or leaves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Change {
    /// A user with this number enters at this time in s.
    Enter {
        /// Time since the start in s.
        at_s: f64,
        /// Number of the user, never used before.
        id: u32,
    },
    /// The user at this index leaves; the indices above it decrease by one.
    Leave {
        /// Time since the start in s.
        at_s: f64,
        /// Index in the order of entry.
        index: usize,
    },
}

impl Change {
    /// Time of the change in s since the start.
    pub fn at_s(&self) -> f64 {
        match *self {
            Self::Enter { at_s, .. } | Self::Leave { at_s, .. } => at_s,
        }
    }
}

/// The users who enter and leave so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Turnover {
    /// Users who entered after the start.
    pub entered: u64,
    /// Users who left.
    pub left: u64,
    /// Arrivals at a full room.
    pub turned_away: u64,
}

/// The times at which users enter and leave.
#[derive(Clone, Debug)]
pub struct Arrivals {
    settings: Settings,
    rng: RoomRng,
    next_arrival_s: f64,
    /// When each user leaves, in the order of entry.
    leave_s: Vec<f64>,
    next_id: u32,
    turnover: Turnover,
}

impl Arrivals {
    /// The users 0 to `users` - 1 are in the room at time 0.
    pub fn new(settings: &Settings, users: usize, seed: u64) -> Self {
        let mut rng = random::stream(seed, Purpose::Arrivals, 0);
        let mut leave_s = Vec::with_capacity(settings.max_users.max(users));
        leave_s.extend((0..users).map(|_| random::exponential(&mut rng, settings.mean_stay_s)));
        let mut arrivals = Self {
            next_arrival_s: 0.0,
            settings: settings.clone(),
            rng,
            leave_s,
            next_id: users as u32,
            turnover: Turnover::default(),
        };
        arrivals.draw_arrival();
        arrivals
    }

    /// The next change up to a time in s since the start, in the order of the times.
    pub fn next_change(&mut self, until_s: f64) -> Option<Change> {
        loop {
            let first = |best: (usize, f64), (index, at_s): (usize, &f64)| {
                if *at_s < best.1 { (index, *at_s) } else { best }
            };
            let (index, leave_s) = self.leave_s.iter().enumerate().fold((0, f64::INFINITY), first);
            let arrival_s = self.next_arrival_s;
            if leave_s.min(arrival_s) > until_s {
                return None;
            }
            if leave_s <= arrival_s {
                self.leave_s.remove(index);
                self.turnover.left += 1;
                return Some(Change::Leave { at_s: leave_s, index });
            }
            let stay_s = random::exponential(&mut self.rng, self.settings.mean_stay_s);
            self.draw_arrival();
            if self.leave_s.len() >= self.settings.max_users {
                self.turnover.turned_away += 1;
                continue;
            }
            self.turnover.entered += 1;
            self.leave_s.push(arrival_s + stay_s);
            let id = self.next_id;
            self.next_id += 1;
            return Some(Change::Enter { at_s: arrival_s, id });
        }
    }

    /// The changes so far.
    pub fn turnover(&self) -> Turnover {
        self.turnover
    }

    fn draw_arrival(&mut self) {
        let gap_s = random::exponential(&mut self.rng, 60.0);
        // A rate of 0 gives a time that never comes.
        self.next_arrival_s += gap_s / self.settings.rate_per_min;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(rate_per_min: f64, mean_stay_s: f64, max_users: usize) -> Settings {
        Settings { rate_per_min, mean_stay_s, max_users }
    }

    /// The changes of a run that is advanced in steps of this length.
    fn changes(arrivals: &mut Arrivals, until_s: f64, step_s: f64) -> Vec<Change> {
        let steps = (until_s / step_s).round() as usize;
        (1..=steps)
            .flat_map(|step| std::iter::from_fn(|| arrivals.next_change(step as f64 * step_s)).collect::<Vec<_>>())
            .collect()
    }

    #[test]
    fn the_changes_depend_on_the_seed_and_not_on_the_steps() {
        let run = |seed, step_s| changes(&mut Arrivals::new(&settings(30.0, 10.0, 8), 3, seed), 120.0, step_s);
        assert_eq!(run(1, 0.01), run(1, 7.5));
        assert_ne!(run(1, 7.5), run(2, 7.5));
    }

    #[test]
    fn the_mean_number_of_users_is_that_of_the_queue() {
        // M/M/inf: rate 0.5 a second times 6 s is 3 users; the limit is far away.
        let mut arrivals = Arrivals::new(&settings(30.0, 6.0, 64), 3, 5);
        let (mut present, mut sum) = (3_i64, 0_i64);
        let seconds = 40_000;
        for second in 1..=seconds {
            while let Some(change) = arrivals.next_change(f64::from(second)) {
                present += if matches!(change, Change::Enter { .. }) { 1 } else { -1 };
            }
            sum += present;
        }
        let mean = sum as f64 / f64::from(seconds);
        assert!((mean - 3.0).abs() < 0.1, "{mean}");
        let Turnover { entered, left, turned_away } = arrivals.turnover();
        assert_eq!((3 + entered as i64 - left as i64, turned_away), (present, 0));
        assert!((entered as f64 / f64::from(seconds) - 0.5).abs() < 0.02, "{entered}");
    }

    #[test]
    fn a_full_room_admits_no_user_and_numbers_are_never_used_twice() {
        let mut arrivals = Arrivals::new(&settings(600.0, 5.0, 4), 2, 9);
        let (mut present, mut ids) = (2, vec![0, 1]);
        for change in changes(&mut arrivals, 60.0, 0.5) {
            match change {
                Change::Enter { id, .. } => {
                    assert!(!ids.contains(&id));
                    ids.push(id);
                    present += 1;
                }
                Change::Leave { index, .. } => {
                    assert!(index < present);
                    present -= 1;
                }
            }
            assert!(present <= 4);
        }
        assert!(arrivals.turnover().turned_away > 0 && ids.len() > 20);
    }

    #[test]
    fn without_arrivals_the_room_empties() {
        let mut arrivals = Arrivals::new(&settings(0.0, 1.0, 5), 5, 3);
        assert_eq!(changes(&mut arrivals, 1000.0, 10.0).len(), 5);
        assert_eq!(arrivals.turnover(), Turnover { left: 5, ..Turnover::default() });
    }
}
