//! The spill of a problem for the searches, as amplitudes: which other users receive light of a
//! mirror that is aimed at a user.

use crate::scene::Spill;

/// Amplitudes of other users for each pair of user and mirror. All lists are empty without spill.
#[derive(Clone, Debug, Default)]
pub(super) struct SpillTable {
    users: usize,
    mirrors: usize,
    /// Users and their amplitudes.
    entries: Vec<(usize, f64)>,
    /// Index of the first entry of each pair. Shape: K * M + 1, index k * M + m.
    starts: Vec<usize>,
    /// Whether any aim of a mirror reaches a second user. Shape: M.
    shared: Vec<bool>,
    /// Whether any mirror that is aimed at the first user reaches the second. Shape: K * K.
    reaches: Vec<bool>,
}

impl SpillTable {
    pub(super) fn new(users: usize, mirrors: usize) -> Self {
        Self {
            users,
            mirrors,
            entries: Vec::with_capacity(Spill::len_max(users, mirrors)),
            starts: Vec::with_capacity(users * mirrors + 1),
            shared: Vec::with_capacity(mirrors),
            reaches: Vec::with_capacity(users * users),
        }
    }

    /// Loads the gains of a list; `amplitude` converts them.
    pub(super) fn load(
        &mut self,
        spill: Option<&Spill>,
        (users, mirrors): (usize, usize),
        amplitude: impl Fn(f64) -> f64,
    ) {
        (self.users, self.mirrors) = (users, mirrors);
        self.entries.clear();
        self.starts.clear();
        self.shared.clear();
        self.reaches.clear();
        let Some(spill) = spill.filter(|spill| !spill.is_empty()) else { return };
        self.shared.resize(mirrors, false);
        self.reaches.resize(users * users, false);
        for user in 0..users {
            for mirror in 0..mirrors {
                self.starts.push(self.entries.len());
                for spilled in spill.of(user, mirror) {
                    self.entries.push((spilled.user, amplitude(spilled.gain)));
                    self.shared[mirror] = true;
                    self.reaches[user * users + spilled.user] = true;
                }
            }
        }
        self.starts.push(self.entries.len());
    }

    /// Whether no aim reaches a second user.
    pub(super) fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Whether any aim of mirror m reaches a second user.
    #[inline]
    pub(super) fn shares(&self, m: usize) -> bool {
        !self.shared.is_empty() && self.shared[m]
    }

    /// The other users that mirror m reaches if it is aimed at user k, and their amplitudes.
    #[inline]
    pub(super) fn of(&self, k: usize, m: usize) -> &[(usize, f64)] {
        if self.starts.is_empty() {
            return &[];
        }
        let pair = k * self.mirrors + m;
        &self.entries[self.starts[pair]..self.starts[pair + 1]]
    }

    /// Whether any mirror that is aimed at user k reaches user j.
    pub(super) fn reaches(&self, k: usize, j: usize) -> bool {
        !self.reaches.is_empty() && self.reaches[k * self.users + j]
    }

    /// All users and their amplitudes, over all pairs.
    pub(super) fn entries(&self) -> &[(usize, f64)] {
        &self.entries
    }
}
