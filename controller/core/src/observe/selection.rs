//! The users whom a policy with fewer slots than users serves.

use crate::observe::{observation::Observation, slots::Slots};

/// Chooses users of an observation for a fixed number of slots: those with the largest minimum
/// rates, and of equal ones those with the smallest numbers.
///
/// A chosen user keeps its slot as long as possible ([`Slots`]). Does not allocate.
#[derive(Clone, Debug)]
pub struct Selection {
    users_max: usize,
    slots: Slots,
    /// Indices of the observation, the most urgent first.
    ranked: Vec<usize>,
    /// Index in the observation of each slot's user.
    chosen: Vec<usize>,
}

impl Selection {
    /// For this number of slots.
    pub fn new(users_max: usize) -> Self {
        let capacity = heliostat_proto::MAX_USERS;
        Self {
            users_max,
            slots: Slots::default(),
            ranked: Vec::with_capacity(capacity),
            chosen: Vec::with_capacity(capacity),
        }
    }

    /// Number of slots.
    pub fn users_max(&self) -> usize {
        self.users_max
    }

    /// The user in each slot.
    pub fn slots(&self) -> &[u32] {
        self.slots.ids()
    }

    /// Replaces the users of the slots.
    pub fn set_slots(&mut self, users: &[u32]) {
        self.slots.follow(users);
    }

    /// The index of the user in each slot.
    pub fn choose(&mut self, observation: &Observation) -> &[usize] {
        let (ids, min_rate_bps) = (&observation.ids, &observation.min_rate_bps);
        self.ranked.clear();
        self.ranked.extend(0..ids.len());
        if ids.len() > self.users_max {
            let urgency =
                |a: &usize, b: &usize| min_rate_bps[*b].total_cmp(&min_rate_bps[*a]).then(ids[*a].cmp(&ids[*b]));
            self.ranked.sort_unstable_by(urgency);
            self.ranked.truncate(self.users_max);
            // New users take slots in the order of the observation, not of their urgency.
            self.ranked.sort_unstable();
        }
        self.slots.assign(self.ranked.iter().map(|index| ids[*index]));
        self.chosen.clear();
        self.chosen.extend(self.slots.ids().iter().filter_map(|id| ids.iter().position(|other| other == id)));
        &self.chosen
    }

    /// The last result of [`choose`](Self::choose).
    pub fn chosen(&self) -> &[usize] {
        &self.chosen
    }
}

#[cfg(test)]
mod tests {
    use heliostat_scenario::Scenario;

    use super::*;

    fn observation(users: &[(u32, f64)]) -> Observation {
        let model = Scenario::builtin("specular").unwrap().channel_model().unwrap();
        let mut observation = Observation::new(&model, users.len());
        observation.ids = users.iter().map(|user| user.0).collect();
        observation.min_rate_bps = users.iter().map(|user| user.1).collect();
        observation
    }

    fn chosen(selection: &mut Selection, users: &[(u32, f64)]) -> Vec<u32> {
        selection.choose(&observation(users)).iter().map(|index| users[*index].0).collect()
    }

    #[test]
    fn the_largest_minimum_rates_come_first_and_equal_ones_by_the_smaller_number() {
        let mut selection = Selection::new(2);
        assert_eq!(chosen(&mut selection, &[(5, 1e6), (9, 2e6), (3, 1e6)]), [9, 3]);
    }

    #[test]
    fn a_chosen_user_keeps_the_slot() {
        let mut selection = Selection::new(3);
        assert_eq!(chosen(&mut selection, &[(0, 1.0), (1, 1.0), (2, 1.0)]), [0, 1, 2]);
        assert_eq!(chosen(&mut selection, &[(7, 2.0), (2, 1.0), (1, 1.0), (0, 1.0)]), [0, 1, 7]);
        assert_eq!(chosen(&mut selection, &[(0, 1.0), (2, 1.0), (7, 2.0)]), [0, 2, 7]);
    }
}
