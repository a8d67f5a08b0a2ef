//! The tracks of all users: those of the last report, and those who are absent from it for a short
//! time.

use heliostat_proto::Nanos;

use crate::belief::track::Track;

/// Time in ns for which an absent user is remembered. A user who walks past a body or a pillar is
/// hidden from a tracker for less than this; after it, the place is hardly better known than that
/// of a new user.
pub(super) const ABSENT_NS: Nanos = 1_000_000_000;

/// The tracks, in memory for a fixed number of them.
#[derive(Clone, Debug)]
pub(super) struct Tracks {
    /// The users of the last report in its order, then the absent ones, the last seen first.
    all: Vec<Track>,
    /// Number of users of the last report.
    present: usize,
    /// The same before the last report.
    former: Vec<Track>,
    former_present: usize,
    capacity: usize,
}

impl Tracks {
    /// No users; memory for `capacity` tracks.
    pub fn new(capacity: usize) -> Self {
        let [all, former] = [(); 2].map(|()| Vec::with_capacity(capacity));
        Self { all, present: 0, former, former_present: 0, capacity }
    }

    /// The users of the last report, in its order.
    pub fn present(&self) -> &[Track] {
        &self.all[..self.present]
    }

    /// The same.
    pub fn present_mut(&mut self) -> &mut [Track] {
        &mut self.all[..self.present]
    }

    /// All users, first those of the last report.
    pub fn all(&self) -> &[Track] {
        &self.all
    }

    /// The same.
    pub fn all_mut(&mut self) -> &mut [Track] {
        &mut self.all
    }

    /// Number of absent users, the last ones of [`all`](Self::all).
    pub fn absent(&self) -> usize {
        self.all.len() - self.present
    }

    /// The track of a user of the last report.
    pub fn find(&self, user: u32) -> Option<&Track> {
        self.present().iter().find(|track| track.user == user)
    }

    /// Forgets all users.
    pub fn clear(&mut self) {
        self.all.clear();
        self.present = 0;
    }

    /// Replaces all users, of whom the last `absent` ones are absent; false where they are too many.
    pub fn restore(&mut self, all: &[Track], absent: usize) -> bool {
        let fits = all.len() <= self.capacity && absent <= all.len();
        if fits {
            self.clear();
            self.all.extend_from_slice(all);
            self.present = all.len() - absent;
        }
        fits
    }

    /// Begins a report. The users of it follow by [`former`](Self::former) and [`push`](Self::push),
    /// in its order, then [`finish_report`](Self::finish_report).
    pub fn begin_report(&mut self) {
        std::mem::swap(&mut self.all, &mut self.former);
        self.former_present = self.present;
        self.clear();
    }

    /// The track of a user before this report, unless the user was absent for too long; `slot` is
    /// the index in the report.
    pub fn former(&self, slot: usize, user: u32, time_ns: Nanos) -> Option<Track> {
        let same_slot = self.former.get(slot).is_some_and(|track| track.user == user);
        let found = || self.former.iter().position(|track| track.user == user);
        let index = if same_slot { slot } else { found()? };
        let is_known = index < self.former_present || is_recent(&self.former[index], time_ns);
        is_known.then(|| self.former[index])
    }

    /// Adds the next user of the report.
    pub fn push(&mut self, track: Track) {
        self.all.push(track);
        self.present += 1;
    }

    /// Keeps the users who are absent from the report, the last seen first, as far as there is memory.
    pub fn finish_report(&mut self, time_ns: Nanos) {
        let Self { all, present, former, capacity, .. } = self;
        for track in former.iter().filter(|track| is_recent(track, time_ns)) {
            if all.len() < *capacity && all[..*present].iter().all(|other| other.user != track.user) {
                all.push(*track);
            }
        }
    }
}

/// Whether a user was seen within [`ABSENT_NS`].
fn is_recent(track: &Track, time_ns: Nanos) -> bool {
    track.seen_ns().is_some_and(|seen_ns| time_ns.saturating_sub(seen_ns) <= ABSENT_NS)
}
