//! Figures of each policy that has been in charge of a room.

use std::ops::AddAssign;

use serde::{Deserialize, Serialize};

use crate::output::safety::Clipped;

/// The counts of one policy.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Tally {
    /// Decisions on position reports while it was in charge.
    pub decisions: u64,
    /// Commands with its own angles.
    pub commands: u64,
    /// Commands while it was in charge with angles of the fallback or of a degraded action.
    pub fallbacks: u64,
    /// Axis values of its own that the limits changed.
    pub clipped: Clipped,
}

impl AddAssign for Tally {
    fn add_assign(&mut self, other: Self) {
        self.decisions += other.decisions;
        self.commands += other.commands;
        self.fallbacks += other.fallbacks;
        self.clipped += other.clipped;
    }
}

/// The counts of all policies by their names, in the order in which they came into charge. Counting does not
/// allocate.
#[derive(Clone, Debug)]
pub struct Tallies {
    all: Vec<(String, Tally)>,
    current: usize,
}

impl Tallies {
    /// One policy in charge, without decisions.
    pub fn new(policy: &str) -> Self {
        Self { all: vec![(policy.into(), Tally::default())], current: 0 }
    }

    /// A policy comes into charge, perhaps again.
    pub fn switch_to(&mut self, policy: &str) {
        self.current = self.all.iter().position(|(name, _)| name == policy).unwrap_or_else(|| {
            self.all.push((policy.into(), Tally::default()));
            self.all.len() - 1
        });
    }

    /// Counts a decision on a position report.
    pub fn count_decision(&mut self) {
        self.all[self.current].1.decisions += 1;
    }

    /// Counts a command whose angles are the policy's own, or not.
    pub fn count_command(&mut self, is_own: bool, clipped: Clipped) {
        let (_, tally) = &mut self.all[self.current];
        if is_own {
            tally.commands += 1;
            tally.clipped += clipped;
        } else {
            tally.fallbacks += 1;
        }
    }

    /// The name and the counts of each policy.
    pub fn all(&self) -> &[(String, Tally)] {
        &self.all
    }
}
