//! Slots of users: which user stands at which index, while users come and go.
//!
//! A user keeps the slot as long as possible, so that a network sees the same user at the same
//! inputs, whatever the order of a report:
//!
//! 1. a user who remains keeps the slot;
//! 2. a new user takes the first slot that was left, or one at the end;
//! 3. the users of the last slots fill the slots that are still empty.

use heliostat_proto::MAX_USERS;

/// The numbers of the users, slot by slot. Does not allocate for up to [`MAX_USERS`] users.
#[derive(Clone, Debug)]
pub struct Slots {
    ids: Vec<u32>,
    next: Vec<Option<u32>>,
    former: Vec<Option<usize>>,
}

impl Default for Slots {
    fn default() -> Self {
        Self::of(0)
    }
}

impl Slots {
    /// The users 0 to `users` - 1, each in the slot of its number.
    pub fn of(users: usize) -> Self {
        let mut ids = Vec::with_capacity(MAX_USERS.max(users));
        ids.extend(0..users as u32);
        let (next, former) = (Vec::with_capacity(ids.capacity()), Vec::with_capacity(ids.capacity()));
        Self { ids, next, former }
    }

    /// The user in each slot.
    pub fn ids(&self) -> &[u32] {
        &self.ids
    }

    /// Empties all slots.
    pub fn clear(&mut self) {
        self.ids.clear();
    }

    /// Gives slots to these users, all different, and takes those of the others. Returns whether a
    /// slot changed; [`former`](Self::former) then has the moves.
    pub fn assign(&mut self, present: impl Iterator<Item = u32> + Clone) -> bool {
        if present.clone().eq(self.ids.iter().copied()) {
            return false;
        }
        let mut arrivals = present.clone().filter(|id| !self.ids.contains(id));
        let is_present = |id: &u32| present.clone().any(|present| present == *id);
        self.next.clear();
        self.next.extend(self.ids.iter().map(|id| if is_present(id) { Some(*id) } else { arrivals.next() }));
        self.next.extend(arrivals.map(Some));
        let mut empty = 0;
        while empty < self.next.len() {
            if self.next[empty].is_some() {
                empty += 1;
            } else {
                self.next.swap_remove(empty);
            }
        }
        let is_same = self.next.iter().flatten().eq(&self.ids);
        if !is_same {
            let slot_of = |id: &u32| self.ids.iter().position(|former| former == id);
            self.former.clear();
            self.former.extend(self.next.iter().flatten().map(slot_of));
            self.ids.clear();
            self.ids.extend(self.next.iter().flatten());
        }
        !is_same
    }

    /// Takes over these slots as they are. Returns whether a slot changed;
    /// [`former`](Self::former) then has the moves.
    pub fn follow(&mut self, ids: &[u32]) -> bool {
        if self.ids == ids {
            return false;
        }
        self.former.clear();
        self.former.extend(ids.iter().map(|id| self.ids.iter().position(|former| former == id)));
        self.ids.clear();
        self.ids.extend_from_slice(ids);
        true
    }

    /// For each slot the one that its user had before the last change, or `None` for a new user.
    pub fn former(&self) -> &[Option<usize>] {
        &self.former
    }
}

/// The entry of a user in a report; `slot` is its likely index.
pub(crate) fn entry_of<T>(entries: &[T], slot: usize, user: u32, user_of: impl Fn(&T) -> u32) -> Option<&T> {
    let is_of_user = |entry: &&T| user_of(entry) == user;
    entries.get(slot).filter(is_of_user).or_else(|| entries.iter().find(is_of_user))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn after(steps: &[&[u32]]) -> Vec<u32> {
        let mut slots = Slots::default();
        for present in steps {
            slots.assign(present.iter().copied());
        }
        slots.ids().to_vec()
    }

    #[test]
    fn a_new_user_takes_the_slot_of_one_who_left() {
        assert_eq!(after(&[&[7, 3, 5]]), [7, 3, 5], "of no one");
        assert_eq!(after(&[&[0, 1, 2], &[9, 2, 0]]), [0, 9, 2]);
    }

    #[test]
    fn the_last_user_fills_a_slot_that_nobody_takes_and_the_others_stay() {
        assert_eq!(after(&[&[0, 1, 2, 3, 4], &[0, 2, 3, 4]]), [0, 4, 2, 3]);
        assert_eq!(after(&[&[0, 1, 2, 3, 4], &[4]]), [4]);
        assert_eq!(after(&[&[0, 1, 2], &[]]), []);
    }

    #[test]
    fn the_former_slots_are_those_of_the_same_users() {
        let mut slots = Slots::of(5);
        assert!(slots.assign([8, 1, 4].into_iter()));
        assert_eq!((slots.ids(), slots.former()), ([8, 1, 4].as_slice(), [None, Some(1), Some(4)].as_slice()));
        assert!(slots.follow(&[4, 2]));
        assert_eq!(slots.former(), [Some(2), None]);
    }
}
