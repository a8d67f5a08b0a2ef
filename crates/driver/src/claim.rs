//! The claim of a process to its arrays: its liveliness token, and the watch over the tokens of other
//! processes with the same mirrors.
//!
//! The calling order is:
//!
//! 1. [`Claim::begin`]: it refuses a room with the token of another process.
//! 2. The caller declares its publishers and subscriptions.
//! 3. [`Claim::announce`]: it refuses a room in which such a token has appeared meanwhile, and declares the own token.
//! 4. [`Claim::check`] in the loop of the process, until its end.
//!
//! Two processes that start together announce themselves before either has received the token of the other
//! one. Both then receive it within [`START_WINDOW`] and compare the source ids: the process with the higher
//! one ends.

use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use heliostat_bus::{Bus, Presence, Subscription, Token};
use heliostat_proto::NodeKind;
use heliostat_proto::keys::parse_array_alive;

use crate::session::{ALIVE_LIMIT, SessionError};

/// Time from the own token in which another token is one of a process that started together with this one.
pub const START_WINDOW: Duration = Duration::from_secs(5);

/// The claim of a process to arrays of its room; dropping it withdraws the token.
pub struct Claim {
    room: String,
    others: Arc<Mutex<Others>>,
    /// Absent until it is announced.
    token: Option<Token>,
    _watches: Vec<Subscription>,
}

impl Claim {
    /// Begins to watch the tokens of other drivers of these arrays and of simulators; `source` is the id in the
    /// stamps of this process.
    ///
    /// # Errors
    /// [`SessionError::RoomTaken`] if there is such a token, or a transport that fails.
    pub fn begin(bus: &Bus, arrays: Range<usize>, source: u64) -> Result<Self, SessionError> {
        let room = bus.room();
        let others = Arc::new(Mutex::new(Others { source, announced: None, present: Vec::new() }));
        let drivers = arrays.map(|array| room.array(array).drivers_alive());
        let patterns: Vec<String> = std::iter::once(room.alive_of(NodeKind::SimNode)).chain(drivers).collect();
        let mut watches = Vec::new();
        for pattern in &patterns {
            let watched = Arc::clone(&others);
            let note = move |token: &str, presence| lock(&watched).note(token, presence, Instant::now());
            watches.push(bus.watch(pattern, note)?);
        }
        // The watch does not say when it has received the present tokens. The query does.
        for pattern in &patterns {
            for token in bus.alive(pattern, ALIVE_LIMIT)? {
                lock(&others).note(&token, Presence::Alive, Instant::now());
            }
        }
        let room = room.to_string();
        lock(&others).check_free(&room)?;
        Ok(Self { room, others, token: None, _watches: watches })
    }

    /// Declares the token of this process.
    ///
    /// # Errors
    /// [`SessionError::RoomTaken`] if another token has appeared since the begin, or a transport that fails.
    pub fn announce(&mut self, bus: &Bus, token: &str) -> Result<(), SessionError> {
        let mut others = lock(&self.others);
        others.check_free(&self.room)?;
        // Before the token, so that each token that arrives from now on is compared.
        others.announced = Some(Instant::now());
        drop(others);
        self.token = Some(bus.announce(token)?);
        Ok(())
    }

    /// Judges the tokens that have appeared since the last call. `late` takes the problem of one that appeared after
    /// [`START_WINDOW`]: the process with it should have ended by its own check.
    ///
    /// # Errors
    /// [`SessionError::RoomTaken`] if this process has to end.
    pub fn check(&self, mut late: impl FnMut(String)) -> Result<(), SessionError> {
        let mut others = lock(&self.others);
        let (source, new) = (others.source, others.take_new());
        drop(others);
        for other in new {
            match (other.is_at_start, source > other.source) {
                (true, true) => return Err(other.taken(&self.room)),
                (true, false) => tracing::warn!(
                    "another {} has started at the same time ({}): it has the higher source id and ends",
                    other.kind,
                    other.token
                ),
                (false, _) => late(other.problem()),
            }
        }
        Ok(())
    }

    /// The problems of the other processes that are in the room.
    pub fn others(&self) -> Vec<String> {
        lock(&self.others).present.iter().map(Other::problem).collect()
    }
}

/// Another process with the same mirrors.
#[derive(Clone, Debug)]
struct Other {
    kind: NodeKind,
    source: u64,
    token: String,
    /// Whether its token appeared within the window at the start of this process.
    is_at_start: bool,
    is_new: bool,
}

impl Other {
    fn problem(&self) -> String {
        let process = if self.kind == NodeKind::SimNode { "simulator" } else { "driver" };
        format!("another {process} has joined the room ({}): stop one of the two", self.token)
    }

    fn taken(&self, room: &str) -> SessionError {
        SessionError::RoomTaken { room: room.to_owned(), other: self.kind, token: self.token.clone() }
    }
}

/// The tokens of other processes with the same mirrors.
#[derive(Debug)]
struct Others {
    /// Of this process.
    source: u64,
    /// When the own token was announced.
    announced: Option<Instant>,
    present: Vec<Other>,
}

impl Others {
    /// Notes that a token has appeared or disappeared; one that is known may be reported again.
    fn note(&mut self, token: &str, presence: Presence, now: Instant) {
        let Some((array, source)) = parse_array_alive(token).filter(|(_, source)| *source != self.source) else {
            return;
        };
        let is_known = self.present.iter().any(|other| other.token == token);
        match presence {
            Presence::Gone => self.present.retain(|other| other.token != token),
            Presence::Alive if is_known => {}
            Presence::Alive => self.present.push(Other {
                // A simulator drives each array of its room, so its token names none.
                kind: array.map_or(NodeKind::SimNode, |_| NodeKind::Driver),
                source,
                token: token.to_owned(),
                is_at_start: self.announced.is_none_or(|at| now.saturating_duration_since(at) <= START_WINDOW),
                is_new: true,
            }),
        }
    }

    fn check_free(&self, room: &str) -> Result<(), SessionError> {
        self.present.first().map_or(Ok(()), |other| Err(other.taken(room)))
    }

    /// The processes that are present and were not returned before.
    fn take_new(&mut self) -> Vec<Other> {
        let new = |other: &mut Other| std::mem::take(&mut other.is_new).then(|| other.clone());
        self.present.iter_mut().filter_map(new).collect()
    }
}

fn lock(others: &Mutex<Others>) -> MutexGuard<'_, Others> {
    others.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn token(source: u64) -> String {
        format!("heliostat/v1/lab/alive/driver/{source:016x}")
    }

    /// The claim of a process that announced itself at this time.
    fn claim(source: u64, announced: Option<Instant>) -> Claim {
        let others = Arc::new(Mutex::new(Others { source, announced, present: Vec::new() }));
        Claim { room: "lab".into(), others, token: None, _watches: Vec::new() }
    }

    /// Whether the process has to end, and the problems that it reports.
    fn checked(claim: &Claim) -> (bool, Vec<String>) {
        let mut problems = Vec::new();
        let result = claim.check(|problem| problems.push(problem));
        (result.is_err(), problems)
    }

    #[test]
    fn of_two_processes_that_start_together_the_one_with_the_higher_source_id_ends() {
        let start = Instant::now();
        for (own, other, ends) in [(9, 7, true), (7, 9, false)] {
            let claim = claim(own, Some(start));
            lock(&claim.others).note(&token(own), Presence::Alive, start);
            assert_eq!(checked(&claim), (false, Vec::new()), "the own token");
            lock(&claim.others).note(&token(other), Presence::Alive, start + START_WINDOW);
            assert_eq!(checked(&claim), (ends, Vec::new()), "{own} and {other}");
        }
    }

    #[test]
    fn a_token_that_appears_later_is_a_problem_once_and_ends_neither() {
        let (start, late) = (Instant::now(), START_WINDOW + Duration::from_nanos(1));
        for (own, other) in [(9, 7), (7, 9)] {
            let claim = claim(own, Some(start));
            (0..2).for_each(|_| lock(&claim.others).note(&token(other), Presence::Alive, start + late));
            let (ends, problems) = checked(&claim);
            assert!(!ends && problems.len() == 1, "{problems:?}");
            assert!(problems[0].contains("another driver has joined the room") && problems[0].contains(&token(other)));
            assert_eq!(checked(&claim), (false, Vec::new()));
            assert_eq!(claim.others(), problems, "it is still there");
        }
    }

    #[test]
    fn a_token_before_the_own_one_ends_the_process_with_either_source_id() {
        for (own, other) in [(9, 7), (7, 9)] {
            let claim = claim(own, None);
            lock(&claim.others).note(&token(other), Presence::Alive, Instant::now());
            let refusal = lock(&claim.others).check_free("lab").expect_err("another token").to_string();
            assert!(refusal.contains("another driver is in room \"lab\""), "{refusal}");
            lock(&claim.others).note(&token(other), Presence::Gone, Instant::now());
            assert!(lock(&claim.others).check_free("lab").is_ok());
        }
    }
}
