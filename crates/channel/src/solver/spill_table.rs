//! The spill of a problem for the searches, as amplitudes: which users receive light of a mirror that
//! is not aimed at them.

use crate::scene::{MIDPOINTS_MAX, Spill};

/// Amplitudes of users for each pair of aim and mirror. All lists are empty without spill.
#[derive(Clone, Debug, Default)]
pub(super) struct SpillTable {
    users: usize,
    mirrors: usize,
    /// Users and their amplitudes.
    entries: Vec<(usize, f64)>,
    /// Index of the first entry of each pair. Shape: A * M + 1, index a * M + m.
    starts: Vec<usize>,
    /// The users of each midpoint. Shape: A - K.
    midpoints: Vec<[usize; 2]>,
    /// The aims of each mirror that have entries, mirror by mirror.
    aims: Vec<usize>,
    /// Index in `aims` of the first aim of each mirror, and the number of aims. Shape: M + 1.
    aim_starts: Vec<usize>,
    /// Whether any mirror that is aimed at the first user reaches the second. Shape: K * K.
    reaches: Vec<bool>,
}

impl SpillTable {
    pub(super) fn new(users: usize, mirrors: usize) -> Self {
        Self {
            users,
            mirrors,
            entries: Vec::with_capacity(Spill::len_max(users, mirrors)),
            starts: Vec::with_capacity((users + MIDPOINTS_MAX) * mirrors + 1),
            midpoints: Vec::with_capacity(MIDPOINTS_MAX),
            aims: Vec::with_capacity((users + MIDPOINTS_MAX) * mirrors),
            aim_starts: Vec::with_capacity(mirrors + 1),
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
        self.midpoints.clear();
        self.aims.clear();
        self.aim_starts.clear();
        self.reaches.clear();
        let Some(spill) = spill.filter(|spill| !spill.is_empty()) else { return };
        assert_eq!(spill.points().len(), users + spill.midpoints().len(), "the spill was made for other users");
        self.midpoints.extend_from_slice(spill.midpoints());
        self.reaches.resize(users * users, false);
        for aim in 0..users + self.midpoints.len() {
            for mirror in 0..mirrors {
                self.starts.push(self.entries.len());
                for spilled in spill.of(aim, mirror) {
                    self.entries.push((spilled.user, amplitude(spilled.gain)));
                    if aim < users {
                        self.reaches[aim * users + spilled.user] = true;
                    }
                }
            }
        }
        self.starts.push(self.entries.len());
        for mirror in 0..mirrors {
            self.aim_starts.push(self.aims.len());
            for aim in 0..users + self.midpoints.len() {
                if self.starts[aim * mirrors + mirror] < self.starts[aim * mirrors + mirror + 1] {
                    self.aims.push(aim);
                }
            }
        }
        self.aim_starts.push(self.aims.len());
    }

    /// Whether no aim reaches two users.
    pub(super) fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Whether any aim of mirror m reaches two users.
    #[inline]
    pub(super) fn shares(&self, m: usize) -> bool {
        !self.aims_of(m).is_empty()
    }

    /// The aims of mirror m that reach users other than the aim itself.
    #[inline]
    pub(super) fn aims_of(&self, m: usize) -> &[usize] {
        if self.aim_starts.is_empty() {
            return &[];
        }
        &self.aims[self.aim_starts[m]..self.aim_starts[m + 1]]
    }

    /// The users that mirror m reaches from an aim, except the aim itself, and their amplitudes.
    #[inline]
    pub(super) fn of(&self, aim: usize, m: usize) -> &[(usize, f64)] {
        if self.starts.is_empty() {
            return &[];
        }
        let pair = aim * self.mirrors + m;
        &self.entries[self.starts[pair]..self.starts[pair + 1]]
    }

    /// The users of each midpoint; the first midpoint is the aim K.
    pub(super) fn midpoints(&self) -> &[[usize; 2]] {
        &self.midpoints
    }

    /// The midpoints that are aims of mirror m, and their users.
    #[inline]
    pub(super) fn midpoints_of(&self, m: usize) -> impl Iterator<Item = (usize, [usize; 2])> {
        let aims = self.aims_of(m).iter().filter(|aim| **aim >= self.users);
        aims.map(|aim| (*aim, self.midpoints[*aim - self.users]))
    }

    /// Whether any mirror that is aimed at user k reaches user j.
    pub(super) fn reaches(&self, k: usize, j: usize) -> bool {
        !self.reaches.is_empty() && self.reaches[k * self.users + j]
    }

    /// Whether all users of an aim are allowed.
    #[inline]
    pub(super) fn is_allowed(&self, aim: usize, allowed: &[bool]) -> bool {
        match aim.checked_sub(self.users) {
            Some(index) => self.midpoints[index].into_iter().all(|k| allowed[k]),
            None => allowed[aim],
        }
    }

    /// All users and their amplitudes, over all pairs.
    pub(super) fn entries(&self) -> &[(usize, f64)] {
        &self.entries
    }
}
