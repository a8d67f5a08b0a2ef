//! The other processes with the same mirrors, by their liveliness tokens: which process has to end.
//!
//! The calling order is:
//!
//! 1. [`Others::note`] with each token that is there, appears or disappears, until the end.
//! 2. [`Others::check_free`] when the present tokens are noted: it refuses a room with such a token.
//! 3. [`Others::announce`] before the own token is declared: it refuses a token that has appeared meanwhile.
//! 4. [`Others::check`] from time to time, until the end.
//!
//! Two processes that start together announce themselves before either has received the token of the other
//! one. Both then receive it within [`START_WINDOW_NS`] and compare the source ids: the process with the higher
//! one ends, within this time too. The other one may have started long before, as where two networks are joined: then
//! it goes on. So a process that should have ended and is still present after this time is a problem.

use heliostat_proto::keys::parse_array_alive;
use heliostat_proto::{Nanos, NodeKind, START_WINDOW_NS};
use thiserror::Error;

/// Another process controls the mirrors of this room, or those of the same array.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("another {} is in room \"{room}\" ({token}): stop it, or choose another room with --room", word(.other))]
pub struct RoomTaken {
    /// Name of the room.
    pub room: String,
    /// The kind of the other process.
    pub other: NodeKind,
    /// Its liveliness token.
    pub token: String,
}

/// What a check has found since the last one.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Findings {
    /// Lines for the log: processes that have to end.
    pub notes: Vec<String>,
    /// Problems: processes that go on beside this one.
    pub problems: Vec<String>,
}

/// The tokens of other processes with the same mirrors. All times are local.
#[derive(Debug)]
pub struct Others {
    room: String,
    /// Of this process.
    source: u64,
    /// When the own token was announced.
    announced_ns: Option<Nanos>,
    present: Vec<Other>,
}

/// Another process with the same mirrors.
#[derive(Debug)]
struct Other {
    kind: NodeKind,
    source: u64,
    token: String,
    appeared_ns: Nanos,
    /// Whether its token appeared within the window at the start of this process.
    is_at_start: bool,
    stage: Stage,
}

/// What is reported of another process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// Nothing yet.
    New,
    /// That it has to end.
    HasToEnd,
    /// That it goes on.
    Problem,
}

impl Others {
    /// No other process yet; `source` is the id in the stamps of this process.
    pub fn new(room: String, source: u64) -> Self {
        Self { room, source, announced_ns: None, present: Vec::new() }
    }

    /// Notes that a token has appeared or disappeared; one that is known may be noted again. The own one is ignored.
    pub fn note(&mut self, token: &str, is_alive: bool, now_ns: Nanos) {
        let Some((array, source)) = parse_array_alive(token).filter(|(_, source)| *source != self.source) else {
            return;
        };
        if !is_alive {
            self.present.retain(|other| other.token != token);
        } else if self.present.iter().all(|other| other.token != token) {
            self.present.push(Other {
                // A simulator drives each array of its room, so its token names none.
                kind: array.map_or(NodeKind::SimNode, |_| NodeKind::Driver),
                source,
                token: token.to_owned(),
                appeared_ns: now_ns,
                is_at_start: self.announced_ns.is_none_or(|at_ns| !is_over(at_ns, now_ns)),
                stage: Stage::New,
            });
        }
    }

    /// Checks that no other process is there.
    ///
    /// # Errors
    /// [`RoomTaken`].
    pub fn check_free(&self) -> Result<(), RoomTaken> {
        self.present.first().map_or(Ok(()), |other| Err(other.taken(&self.room)))
    }

    /// Notes that the own token is declared now: each token that appears from now on is compared.
    ///
    /// # Errors
    /// [`RoomTaken`] if another token has appeared since the begin.
    pub fn announce(&mut self, now_ns: Nanos) -> Result<(), RoomTaken> {
        self.check_free()?;
        self.announced_ns = Some(now_ns);
        Ok(())
    }

    /// Judges the other processes; each note and each problem is returned once.
    ///
    /// # Errors
    /// [`RoomTaken`] if this process has to end.
    pub fn check(&mut self, now_ns: Nanos) -> Result<Findings, RoomTaken> {
        let mut findings = Findings::default();
        for other in &mut self.present {
            if other.stage == Stage::New && other.is_at_start {
                if self.source > other.source {
                    return Err(other.taken(&self.room));
                }
                findings.notes.push(other.note());
                other.stage = Stage::HasToEnd;
            }
            if other.stage == Stage::New || other.stage == Stage::HasToEnd && is_over(other.appeared_ns, now_ns) {
                findings.problems.push(other.problem());
                other.stage = Stage::Problem;
            }
        }
        Ok(findings)
    }

    /// Number of processes that are there.
    pub fn count(&self) -> u64 {
        self.present.len() as u64
    }

    /// The problems of the processes that are there.
    pub fn problems(&self) -> Vec<String> {
        self.present.iter().map(Other::problem).collect()
    }
}

impl Other {
    fn note(&self) -> String {
        let Self { kind, token, .. } = self;
        format!(
            "another {} is in the room ({token}): if it has just started, it ends now, for its source id is the higher one; \
             otherwise stop one of the two",
            word(kind)
        )
    }

    fn problem(&self) -> String {
        let Self { kind, token, .. } = self;
        format!("another {} has joined the room ({token}): stop one of the two", word(kind))
    }

    fn taken(&self, room: &str) -> RoomTaken {
        RoomTaken { room: room.to_owned(), other: self.kind, token: self.token.clone() }
    }
}

/// Whether the window from an instant is over.
fn is_over(from_ns: Nanos, now_ns: Nanos) -> bool {
    now_ns.saturating_sub(from_ns) > START_WINDOW_NS
}

/// A process with mirrors, in words for a user.
fn word(kind: &NodeKind) -> &'static str {
    if *kind == NodeKind::SimNode { "simulator" } else { NodeKind::Driver.name() }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// When the process announces itself.
    const START_NS: Nanos = 1_000_000_000;
    /// The last instant of the window.
    const WINDOW_END_NS: Nanos = START_NS + START_WINDOW_NS;

    fn token(source: u64) -> String {
        format!("heliostat/v1/lab/alive/driver/{source:016x}")
    }

    /// What a process that announced itself at the start knows.
    fn announced(source: u64) -> Others {
        let mut others = Others::new("lab".into(), source);
        others.announce(START_NS).expect("no other process");
        others
    }

    /// The number of notes and of problems.
    fn found(others: &mut Others, now_ns: Nanos) -> (usize, usize) {
        let findings = others.check(now_ns).expect("this process goes on");
        (findings.notes.len(), findings.problems.len())
    }

    #[test]
    fn of_two_processes_that_start_together_the_one_with_the_higher_source_id_ends() {
        for (own, other, ends) in [(9, 7, true), (7, 9, false)] {
            let mut others = announced(own);
            others.note(&token(own), true, START_NS);
            assert_eq!(found(&mut others, START_NS), (0, 0), "the own token");
            others.note(&token(other), true, WINDOW_END_NS);
            let checked = others.check(WINDOW_END_NS);
            assert_eq!(checked.is_err(), ends, "{own} and {other}");
            let notes = checked.map_or(Vec::new(), |findings| findings.notes);
            assert!(ends || notes[0].contains("if it has just started, it ends now"), "{notes:?}");
            others.note(&token(other), false, WINDOW_END_NS);
            assert_eq!(found(&mut others, 3 * WINDOW_END_NS), (0, 0), "the other one has ended");
        }
    }

    #[test]
    fn one_that_has_to_end_and_stays_is_a_problem_once() {
        // Two networks were joined: the other process started long ago and goes on.
        let mut others = announced(7);
        let appeared_ns = START_NS + 1;
        others.note(&token(9), true, appeared_ns);
        assert_eq!(found(&mut others, appeared_ns), (1, 0));
        assert_eq!(found(&mut others, appeared_ns + START_WINDOW_NS), (0, 0), "it has time to end");
        let Findings { notes, problems } = others.check(appeared_ns + START_WINDOW_NS + 1).expect("both go on");
        assert_eq!((notes, &problems), (Vec::new(), &others.problems()));
        assert!(problems[0].contains("another driver has joined the room"), "{problems:?}");
        assert_eq!(found(&mut others, 3 * WINDOW_END_NS), (0, 0));
    }

    #[test]
    fn a_token_that_appears_later_is_a_problem_once_and_ends_neither() {
        for (own, other) in [(9, 7), (7, 9)] {
            let mut others = announced(own);
            (0..2).for_each(|_| others.note(&token(other), true, WINDOW_END_NS + 1));
            let Findings { notes, problems } = others.check(WINDOW_END_NS + 1).expect("both go on");
            assert!(notes.is_empty() && problems.len() == 1, "{notes:?}, {problems:?}");
            assert!(problems[0].contains("another driver has joined the room") && problems[0].contains(&token(other)));
            assert_eq!(found(&mut others, 3 * WINDOW_END_NS), (0, 0));
            assert_eq!(others.problems(), problems, "it is still there");
        }
    }

    #[test]
    fn a_token_before_the_own_one_ends_the_process_with_either_source_id() {
        for (own, other) in [(9, 7), (7, 9)] {
            let mut others = Others::new("lab".into(), own);
            others.note(&token(other), true, START_NS);
            let refusal = others.announce(START_NS).expect_err("another token").to_string();
            assert!(refusal.contains("another driver is in room \"lab\""), "{refusal}");
            others.note(&token(other), false, START_NS);
            assert!(others.announce(START_NS).is_ok());
        }
    }

    #[test]
    fn a_simulator_is_named_so() {
        let mut others = Others::new("lab".into(), 9);
        others.note("heliostat/v1/lab/alive/sim-node/0000000000000007", true, START_NS);
        let refusal = others.check_free().expect_err("another token").to_string();
        assert!(refusal.contains("another simulator is in room \"lab\""), "{refusal}");
        assert!(others.problems()[0].contains("another simulator has joined the room"));
    }
}
