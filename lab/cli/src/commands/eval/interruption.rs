//! What an interrupted evaluation says: how far it was, what is written, and how to go on.

use std::sync::{Arc, Mutex};

use anyhow::Result;
use heliostat::programs;
use heliostat_learn::comparison::{Progress, Report, Settings, compare};
use heliostat_service::locks::lock;
use heliostat_service::signals;

/// How to go on.
const AGAIN: &str = "eval has no --resume: the same command begins again";

/// How far the comparisons of a command are.
#[derive(Debug)]
pub struct Interruption(Arc<Mutex<State>>);

#[derive(Debug, Default)]
struct State {
    compared: usize,
    of: usize,
    progress: Option<Progress>,
}

impl Interruption {
    /// From now on, Ctrl-C and SIGTERM end the process with what is to be said of so many comparisons.
    ///
    /// # Errors
    /// As [`signals::end_on_signals`].
    pub fn watch(comparisons: usize) -> Result<Self> {
        let state = Arc::new(Mutex::new(State { of: comparisons, ..State::default() }));
        let watched = Arc::clone(&state);
        signals::end_on_signals(programs::LAB, move || {
            let state = lock(&watched);
            said((state.compared, state.of), state.progress.as_ref().and_then(Progress::abandon))
        })?;
        Ok(Self(state))
    }

    /// Makes the next comparison.
    ///
    /// # Errors
    /// As [`compare`].
    pub fn compare(&self, settings: &Settings) -> Result<Report> {
        let progress = Progress::shown()?;
        lock(&self.0).progress = Some(progress.clone());
        let report = compare(settings, &progress)?;
        lock(&self.0).compared += 1;
        Ok(report)
    }
}

fn said((compared, of): (usize, usize), at: Option<String>) -> String {
    if compared == of {
        return format!("the comparison was complete, and each file is complete or missing; {AGAIN}");
    }
    let name = if of == 1 { "the comparison".to_owned() } else { format!("comparison {} of {of}", compared + 1) };
    let at = at.map_or_else(|| "at its start".to_owned(), |at| format!("at {at}"));
    format!("{name} was {at}; nothing is written, because tables and files follow the last comparison; {AGAIN}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_interrupted_evaluation_says_how_far_it_was_and_what_is_written() {
        let at = || Some("3 of 7 policies: greedy".to_owned());
        let one = said((0, 1), at());
        assert!(one.starts_with("the comparison was at 3 of 7 policies: greedy; nothing is written, "), "{one}");
        assert!(one.ends_with("; eval has no --resume: the same command begins again"), "{one}");
        assert!(said((1, 6), at()).starts_with("comparison 2 of 6 was at 3 of 7 policies: greedy; "));
        assert!(said((0, 1), None).starts_with("the comparison was at its start; nothing is written"));
        assert!(!said((6, 6), at()).contains("nothing is written"));
    }
}
