//! When a process ends: Ctrl-C, SIGTERM, the end of standard input, or a given time.
//!
//! The first signal requests an orderly end. The second ends the process at once, with exit code
//! [`INTERRUPTED`]: an orderly end may wait for a network that does not answer. A command that has
//! nothing to save ends at the first one, with the same code. A signal that the process was started to ignore, as by
//! `nohup`, stays ignored.

mod platform;

use std::io::{self, Read};
use std::process::{Command, ExitStatus};
use std::time::Duration;

use thiserror::Error;

use crate::duration;
use crate::exit::{INTERRUPTED, report};
use crate::stop::Stop;

/// The environment variable of a [`part`].
const PART: &str = "HELIOSTAT_PART";

/// The flags that say when a process ends.
#[derive(Clone, Copy, Debug, Default, clap::Args)]
pub struct EndArgs {
    /// End after this many seconds; without it, run until stopped
    #[arg(long, value_name = "N", value_parser = duration::seconds, allow_negative_numbers = true)]
    pub seconds: Option<Duration>,
    /// End when standard input closes, as it does when the parent process ends
    #[arg(long)]
    pub exit_with_parent: bool,
}

/// The operating system does not deliver signals to this process.
#[derive(Debug, Error)]
#[error("cannot listen for Ctrl-C and SIGTERM")]
pub struct SignalError(#[from] io::Error);

impl EndArgs {
    /// Listens for signals and, where the flag says so, for the end of standard input.
    ///
    /// # Errors
    /// [`SignalError`].
    pub fn stop(&self) -> Result<Stop, SignalError> {
        let stop = stop_on_signals()?;
        if self.exit_with_parent {
            stop_at_end_of_input(&stop);
        }
        Ok(stop)
    }
}

/// A request that the first Ctrl-C or SIGTERM makes; the second ends the process.
///
/// # Errors
/// [`SignalError`].
pub fn stop_on_signals() -> Result<Stop, SignalError> {
    let stop = Stop::default();
    let on_signal = stop.clone();
    let mut is_second = false;
    platform::on_each_signal(move || {
        if std::mem::replace(&mut is_second, true) {
            std::process::exit(INTERRUPTED.into());
        }
        on_signal.request();
    })?;
    Ok(stop)
}

/// Ends a program at the first Ctrl-C or SIGTERM, after a note with what `said` returns: for a command that keeps what
/// it has finished, or nothing, and that saves nothing on request. In a [`part`] there is no note.
///
/// # Errors
/// [`SignalError`].
pub fn end_on_signals(program: &'static str, said: impl Fn() -> String + Send + 'static) -> Result<(), SignalError> {
    end_on_request(stop_on_signals()?, program, move || Some(said()));
    Ok(())
}

/// Ends a program at a request, as [`end_on_signals`] does. Where `said` returns nothing, the program goes on, and ends in
/// its own way.
pub fn end_on_request(stop: Stop, program: &'static str, said: impl Fn() -> Option<String> + Send + 'static) {
    // Another thread than that of the signals: the second one ends a note that a full pipe blocks.
    std::thread::spawn(move || {
        stop.wait();
        let Some(said) = said() else { return };
        if std::env::var_os(PART).is_none() {
            report(program, &format!("interrupted: {said}"));
        }
        std::process::exit(INTERRUPTED.into());
    });
}

/// Makes a process a part of the command of this one, which says itself how far it was and how to go on.
pub fn part(process: &mut Command) {
    process.env(PART, "1");
}

/// Gives the processes that this one starts the default action of each signal that ends a process, also where this one
/// was started to ignore some; it no longer ignores them itself. For tests that send these signals, in a suite that a
/// script starts in the background.
///
/// # Panics
/// When the operating system refuses a handler.
pub fn restore_in_children() {
    platform::restore_in_children();
}

/// Whether a signal has ended a process, with [`INTERRUPTED`] or before it could handle the signal.
pub fn has_interrupted(status: ExitStatus) -> bool {
    status.code() == Some(INTERRUPTED.into()) || platform::has_ended(status)
}

/// Requests the end when standard input closes, on a thread that reads and discards it.
pub fn stop_at_end_of_input(stop: &Stop) {
    let stop = stop.clone();
    std::thread::spawn(move || {
        let mut discarded = [0; 256];
        // A read error ends the process too: the parent can no longer be watched.
        while io::stdin().read(&mut discarded).is_ok_and(|count| count > 0) {}
        stop.request();
    });
}
