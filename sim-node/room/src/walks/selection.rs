//! Chooses the users of a trace: each is present from its beginning to its end.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use thiserror::Error;

use crate::walks::tracks::{Track, TrackPoint};

/// Least time between two samples of a user in s; the trace has milliseconds.
const INTERVAL_MIN_S: f64 = 1e-3;

/// Which pedestrians become users.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Presence {
    /// Pedestrians who were present at the same time, over the longest such time.
    Together,
    /// The longest tracks; each begins at 0 s, whenever it was recorded.
    Longest,
}

/// What a trace requires.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice {
    /// Number of users.
    pub users: usize,
    /// Which pedestrians.
    pub presence: Presence,
    /// Duration in s; `None`: as long as all users are present.
    pub duration_s: Option<f64>,
    /// Samples a second; `None`: the recorded times, and the first and last time of the trace.
    pub rate_hz: Option<f64>,
}

/// Why users cannot be chosen.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum SelectionError {
    /// Too few pedestrians.
    #[error("pedestrians {presence}: at most {found}; expected {users}")]
    Few {
        /// Pedestrians who can be chosen.
        found: usize,
        /// Under which condition.
        presence: &'static str,
        /// Users required.
        users: usize,
    },
    /// All are present, but not for long enough.
    #[error("{users} pedestrians {presence} last {found_s:.2} s; expected {duration_s} s or more")]
    Short {
        /// Users required.
        users: usize,
        /// Longest duration in s.
        found_s: f64,
        /// Under which condition.
        presence: &'static str,
        /// Duration required in s.
        duration_s: f64,
    },
}

/// The users of a trace.
#[derive(Clone, Debug, PartialEq)]
pub struct Selected {
    /// One track for each user, from 0 s to the duration.
    pub users: Vec<Track>,
    /// Time of the file in s at which each user's track begins.
    pub starts_s: Vec<f64>,
    /// Duration in s.
    pub duration_s: f64,
}

impl Presence {
    fn condition(self) -> &'static str {
        match self {
            Self::Together => "who are present at the same time",
            Self::Longest => "with more than one position",
        }
    }
}

/// Chooses users, and their samples from the first to the last time of the trace.
///
/// # Errors
/// [`SelectionError`] where too few pedestrians are present, or not for long enough.
pub fn select(tracks: &[Track], choice: &Choice) -> Result<Selected, SelectionError> {
    let lasting: Vec<&Track> = tracks.iter().filter(|track| track.duration_s() > INTERVAL_MIN_S).collect();
    let users = choice.users;
    let (chosen, longest_s) = match choice.presence {
        Presence::Together => together(&lasting, users),
        Presence::Longest => longest(lasting, users),
    };
    let presence = choice.presence.condition();
    if chosen.len() < users {
        return Err(SelectionError::Few { found: chosen.len(), presence, users });
    }
    // A rate needs at least one interval.
    let least_s = choice.rate_hz.map_or(INTERVAL_MIN_S, |rate_hz| 1.0 / rate_hz);
    let duration_s = choice.duration_s.unwrap_or(longest_s).max(least_s);
    if duration_s > longest_s {
        return Err(SelectionError::Short { users, found_s: longest_s, presence, duration_s });
    }
    let times = Times::new(duration_s, choice.rate_hz);
    Ok(Selected {
        users: chosen.iter().map(|(track, start_s)| times.cut(track, *start_s)).collect(),
        starts_s: chosen.iter().map(|(_, start_s)| *start_s).collect(),
        duration_s: times.duration_s,
    })
}

/// The longest time in which the same `users` pedestrians are present: those pedestrians with its
/// beginning, and its duration in s. With too few pedestrians: as many as are ever present at once.
fn together<'a>(tracks: &[&'a Track], users: usize) -> (Vec<(&'a Track, f64)>, f64) {
    let mut by_start = tracks.to_vec();
    by_start.sort_by(|a, b| a.start_s().total_cmp(&b.start_s()));
    // A time begins with a track. The last ends of the tracks so far bound it.
    let mut ends: BinaryHeap<Reverse<Ordered>> = BinaryHeap::new();
    let (mut best, mut most) = (None, (0, 0.0));
    for track in &by_start {
        let start_s = track.start_s();
        ends.push(Reverse(Ordered(track.end_s())));
        while ends.len() > users || ends.peek().is_some_and(|end| end.0.0 <= start_s) {
            ends.pop();
        }
        if ends.len() > most.0 {
            most = (ends.len(), start_s);
        }
        if let Some(Reverse(Ordered(end_s))) = ends.peek().filter(|_| ends.len() == users)
            && best.is_none_or(|(from_s, to_s)| end_s - start_s > to_s - from_s)
        {
            best = Some((start_s, *end_s));
        }
    }
    let (start_s, end_s) = best.unwrap_or((most.1, most.1 + INTERVAL_MIN_S));
    let is_present = |track: &&&Track| track.start_s() <= start_s && track.end_s() >= end_s;
    let chosen = by_start.iter().filter(is_present).take(users).map(|track| (*track, start_s));
    (chosen.collect(), end_s - start_s)
}

/// The longest tracks with their beginnings, in the order of the file, and the least duration in s.
fn longest(tracks: Vec<&Track>, users: usize) -> (Vec<(&Track, f64)>, f64) {
    let mut order: Vec<(usize, &Track)> = tracks.into_iter().enumerate().collect();
    order.sort_by(|a, b| b.1.duration_s().total_cmp(&a.1.duration_s()));
    order.truncate(users);
    let least_s = order.last().map_or(0.0, |(_, track)| track.duration_s());
    order.sort_by_key(|(index, _)| *index);
    (order.into_iter().map(|(_, track)| (track, track.start_s())).collect(), least_s)
}

/// A time that orders.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Ordered(f64);

impl Eq for Ordered {}

impl PartialOrd for Ordered {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Ordered {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.0.total_cmp(&other.0)
    }
}

/// The sample times of a trace.
#[derive(Clone, Copy, Debug)]
struct Times {
    duration_s: f64,
    rate_hz: Option<f64>,
}

impl Times {
    /// With a rate the duration is a whole number of intervals.
    fn new(duration_s: f64, rate_hz: Option<f64>) -> Self {
        let duration_s = rate_hz.map_or(duration_s, |rate_hz| (duration_s * rate_hz + 1e-6).floor() / rate_hz);
        Self { duration_s, rate_hz }
    }

    /// The part of a track from a time of the file on, with times from 0.
    fn cut(&self, track: &Track, start_s: f64) -> Track {
        let at = |time_s: f64| TrackPoint { time_s, ..track.at(start_s + time_s) };
        let points = match self.rate_hz {
            Some(rate_hz) => {
                let last = (self.duration_s * rate_hz).round() as u64;
                (0..=last).map(|index| at(index as f64 / rate_hz)).collect()
            }
            None => {
                let inside = INTERVAL_MIN_S..self.duration_s - INTERVAL_MIN_S;
                let recorded = track.points.iter().map(|point| TrackPoint { time_s: point.time_s - start_s, ..*point });
                let mut points = vec![at(0.0)];
                points.extend(recorded.filter(|point| inside.contains(&point.time_s)));
                points.push(at(self.duration_s));
                points.dedup_by(|later, earlier| later.time_s - earlier.time_s < INTERVAL_MIN_S);
                points
            }
        };
        Track { pedestrian: track.pedestrian.clone(), points }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A pedestrian who walks along x at 1 m/s, sampled twice a second.
    fn track(pedestrian: &str, start_s: f64, end_s: f64) -> Track {
        let count = ((end_s - start_s) * 2.0) as usize;
        let times = (0..=count).map(|index| start_s + 0.5 * index as f64);
        let point = |time_s| TrackPoint { time_s, at_m: [time_s, 0.0], heading_rad: None };
        Track { pedestrian: pedestrian.to_owned(), points: times.map(point).collect() }
    }

    fn choice(users: usize, presence: Presence) -> Choice {
        Choice { users, presence, duration_s: None, rate_hz: None }
    }

    fn pedestrians(selected: &Selected) -> Vec<&str> {
        selected.users.iter().map(|track| track.pedestrian.as_str()).collect()
    }

    #[test]
    fn users_who_are_together_have_the_longest_common_time() {
        let tracks = [track("a", 0.0, 10.0), track("b", 8.0, 30.0), track("c", 9.0, 20.0), track("d", 12.0, 19.0)];
        let two = select(&tracks, &choice(2, Presence::Together)).expect("two pedestrians");
        assert_eq!((pedestrians(&two), two.duration_s, two.starts_s[0]), (vec!["b", "c"], 11.0, 9.0));
        let three = select(&tracks, &choice(3, Presence::Together)).expect("three pedestrians");
        assert_eq!((pedestrians(&three), three.duration_s, three.starts_s[0]), (vec!["b", "c", "d"], 7.0, 12.0));
        for user in &three.users {
            assert_eq!((user.start_s(), user.end_s(), user.points[0].at_m), (0.0, 7.0, [12.0, 0.0]));
        }
    }

    #[test]
    fn the_longest_tracks_begin_together_whenever_they_were_recorded() {
        let tracks = [track("a", 0.0, 4.0), track("b", 50.0, 52.0), track("c", 90.0, 93.0)];
        let two = select(&tracks, &choice(2, Presence::Longest)).expect("two pedestrians");
        assert_eq!((pedestrians(&two), two.duration_s), (vec!["a", "c"], 3.0));
        assert_eq!((two.starts_s.as_slice(), two.users[1].start_s()), (&[0.0, 90.0][..], 0.0));
    }

    #[test]
    fn too_few_pedestrians_and_too_short_walks_are_refused_with_what_was_found() {
        let tracks = [track("a", 0.0, 4.0), track("b", 2.0, 6.0), track("c", 7.0, 9.0)];
        let error = |choice| select(&tracks, &choice).expect_err("refused").to_string();
        let few = error(choice(3, Presence::Together));
        assert!(few.contains("present at the same time: at most 2; expected 3"), "{few}");
        let short = error(Choice { duration_s: Some(2.5), ..choice(2, Presence::Together) });
        assert!(
            short.contains("2 pedestrians who are present at the same time last 2.00 s; expected 2.5 s"),
            "{short}"
        );
        let slow = error(Choice { rate_hz: Some(0.25), ..choice(2, Presence::Together) });
        assert!(slow.contains("expected 4 s"), "{slow}");
        assert!(error(choice(4, Presence::Longest)).contains("at most 3; expected 4"));
    }

    #[test]
    fn resampling_interpolates_at_the_rate_and_keeps_the_ends() {
        let tracks = [track("a", 0.0, 4.0), track("b", 0.25, 4.25)];
        let resampled = select(&tracks, &Choice { rate_hz: Some(4.0), ..choice(2, Presence::Together) }).expect("two");
        assert_eq!(resampled.duration_s, 3.75);
        assert!(resampled.users.iter().all(|user| user.points.len() == 16));
        assert!((resampled.users[0].points[1].at_m[0] - 0.5).abs() < 1e-12);
        let recorded = select(&tracks, &choice(2, Presence::Together)).expect("two");
        let times: Vec<f64> = recorded.users[0].points.iter().map(|point| point.time_s).collect();
        assert_eq!(times, [0.0, 0.25, 0.75, 1.25, 1.75, 2.25, 2.75, 3.25, 3.75]);
    }
}
