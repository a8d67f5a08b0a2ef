//! Bounds the lines of the log: of a lasting problem the first line at once, then one in ten seconds with the number of
//! occurrences; of events each one, until there are too many.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::time::{Duration, Instant};

/// Shortest time between two lines of one problem.
const INTERVAL: Duration = Duration::from_secs(10);

/// Problems that are remembered; the one that was logged first is forgotten for a new one.
const PROBLEMS_MAX: usize = 64;

/// The problems that were logged last. Texts that differ in numbers only, such as ages and
/// positions, are one problem.
#[derive(Clone, Debug, Default)]
pub struct LogLimit {
    problems: BTreeMap<String, Logged>,
}

#[derive(Clone, Copy, Debug)]
struct Logged {
    at: Instant,
    /// Occurrences since then.
    count: u64,
}

impl LogLimit {
    /// The line for a problem that occurred `count` times since the last call, if one is due.
    pub fn line(&mut self, now: Instant, problem: &str, count: u64) -> Option<String> {
        let key = without_numbers(problem);
        match self.problems.get_mut(&key) {
            Some(logged) if now.saturating_duration_since(logged.at) < INTERVAL => {
                logged.count += count;
                None
            }
            Some(logged) => {
                let (all, passed_s) = (logged.count + count, now.saturating_duration_since(logged.at).as_secs());
                *logged = Logged { at: now, count: 0 };
                Some(if all > 1 { format!("{problem} ({all} times in {passed_s} s)") } else { problem.to_owned() })
            }
            None => {
                if self.problems.len() >= PROBLEMS_MAX
                    && let Some(oldest) =
                        self.problems.iter().min_by_key(|(_, logged)| logged.at).map(|(key, _)| key.clone())
                {
                    self.problems.remove(&oldest);
                }
                self.problems.insert(key, Logged { at: now, count: 0 });
                Some(problem.to_owned())
            }
        }
    }
}

/// Most events in succession that have a line each.
pub const EVENTS_MAX: u32 = 100;

/// Time after which one further event has a line.
pub const EVENT_EVERY: Duration = INTERVAL;

/// The lines of events that another process can cause at any rate, such as stops and liveliness tokens.
#[derive(Clone, Debug, Default)]
pub struct EventLimit {
    last: Option<Instant>,
    /// Time since the last event after which none counts any more: each one with a line adds [`EVENT_EVERY`].
    owed: Duration,
    further: LogLimit,
}

impl EventLimit {
    /// The line of an event. Of more than [`EVENTS_MAX`] events and one for each [`EVENT_EVERY`], `further` stands for
    /// the others, once in ten seconds with their number.
    pub fn line(&mut self, now: Instant, event: impl Display, further: &str) -> Option<String> {
        let last = self.last.replace(now).unwrap_or(now);
        self.owed = self.owed.saturating_sub(now.saturating_duration_since(last));
        if self.owed + EVENT_EVERY <= EVENT_EVERY * EVENTS_MAX {
            self.owed += EVENT_EVERY;
            return Some(event.to_string());
        }
        self.further.line(now, further, 1)
    }
}

/// The text with each number as one sign.
fn without_numbers(text: &str) -> String {
    let mut plain = String::with_capacity(text.len());
    for letter in text.chars() {
        if !letter.is_ascii_digit() {
            plain.push(letter);
        } else if !plain.ends_with('0') {
            plain.push('0');
        }
    }
    plain.replace("0.0", "0").replace("-0", "0")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lasting_problem_is_one_line_at_once_and_then_one_in_ten_seconds_with_its_count() {
        let (mut limit, start) = (LogLimit::default(), Instant::now());
        // Twice a second for a minute, as a controller checks; each check counts 50 refusals.
        let lines: Vec<String> = (0..120)
            .filter_map(|check| {
                let problem = format!("users refused: a report is {:.1} s old", 60.0 + 0.1 * f64::from(check));
                limit.line(start + check * Duration::from_millis(500), &problem, 50)
            })
            .collect();
        assert_eq!(lines.len(), 6, "{lines:?}");
        assert_eq!(lines[0], "users refused: a report is 60.0 s old");
        assert_eq!(lines[1], "users refused: a report is 62.0 s old (1000 times in 10 s)");
    }

    #[test]
    fn a_flood_of_events_has_a_bounded_number_of_lines_and_then_one_in_ten_seconds() {
        let (mut limit, start) = (EventLimit::default(), Instant::now());
        let mut lines = |from_s: u32, to_s: u32| -> Vec<String> {
            let events = (1000 * from_s..1000 * to_s).step_by(10);
            events
                .filter_map(|ms| {
                    limit.line(start + ms * Duration::from_millis(1), format!("stop {ms}"), "further stops")
                })
                .collect()
        };
        let (flood, most) = (lines(0, 60), EVENTS_MAX as usize);
        assert_eq!((flood.len(), flood[0].as_str()), (most + 5 + 6, "stop 0"));
        assert_eq!(flood[most..most + 3], ["further stops", "stop 10000", "further stops (999 times in 10 s)"]);
        let after_pauses = (8..100).map(|burst| lines(11 * burst, 11 * burst + 1).len()).max();
        assert_eq!(after_pauses, Some(4), "a pause of ten seconds ends no flood");
        assert_eq!(lines(3000, 3001).len(), most, "each one after a long pause");
    }

    #[test]
    fn different_problems_have_lines_of_their_own_and_a_rare_one_has_no_count() {
        let (mut limit, start) = (LogLimit::default(), Instant::now());
        assert!(limit.line(start, "(1200.0, -3.0) is outside", 1).is_some());
        assert!(limit.line(start, "(900.5, 12.25) is outside", 1).is_none());
        assert!(limit.line(start, "a command could not be sent", 1).is_some());
        let later = start + 2 * INTERVAL;
        assert_eq!(limit.line(later, "a command could not be sent", 1).as_deref(), Some("a command could not be sent"));
        for number in 0..1000 {
            let word: String = format!("{number:04}").chars().map(|digit| (digit as u8 + b'a') as char).collect();
            limit.line(later, &word, 1);
        }
        assert_eq!(limit.problems.len(), PROBLEMS_MAX);
    }
}
