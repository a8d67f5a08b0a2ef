//! How far a run is, for the thread that ends it on request.

use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard};

use heliostat_service::locks::lock;
use indicatif::ProgressBar;

/// The finished parts of a run, which another thread can read.
#[derive(Clone, Debug, Default)]
pub struct Progress(Arc<Mutex<State>>);

#[derive(Debug, Default)]
struct State {
    finished: usize,
    of: usize,
    /// `None` before the first part is computed.
    bar: Option<ProgressBar>,
}

impl Progress {
    /// The parts that an earlier run finished, all parts, and the bar that shows the others.
    pub(crate) fn start(&self, finished: usize, of: usize, bar: &ProgressBar) {
        *self.lock() = State { finished, of, bar: Some(bar.clone()) };
    }

    /// One more part is finished.
    pub(crate) fn finish_part(&self) {
        self.lock().finished += 1;
    }

    /// Leaves the bar as it is, and says how far an interrupted run was, and how it goes on.
    pub fn interrupted(&self, out: &Path) -> String {
        let state = self.lock();
        let kept = format!("the same command continues; {} keeps the finished parts", out.display());
        let Some(bar) = &state.bar else { return kept };
        bar.abandon();
        format!("{} of {} parts were finished; {kept}", state.finished, state.of)
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        lock(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_interrupted_run_says_how_far_it_was_and_how_it_goes_on() {
        let progress = Progress::default();
        let of_another_thread = progress.clone();
        let said = || of_another_thread.interrupted(Path::new("figures"));
        assert_eq!(said(), "the same command continues; figures keeps the finished parts");
        progress.start(2, 7, &ProgressBar::hidden());
        progress.finish_part();
        assert_eq!(said(), "3 of 7 parts were finished; the same command continues; figures keeps the finished parts");
    }
}
