//! Logs to standard error: standard output holds the summary only.
//!
//! A thread of its own writes the log, because a reader that does not read must not make a decision or an
//! emergency stop wait. Lines that such a reader leaves no room for are lost, the newest first.
//!
//! An event is one line. Its fields may quote a message or a file, so they are made
//! [`printable`](crate::printable).

use std::fmt::{self, Debug};
use std::io::{self, Write, stderr};

use tracing::field::Field;
use tracing_appender::non_blocking::{ErrorCounter, NonBlockingBuilder, WorkerGuard};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::field::MakeExt;
use tracing_subscriber::filter::LevelFilter;
use tracing_subscriber::fmt::format::{Writer, debug_fn};

use crate::printable::{printable, printable_lines};
use crate::process::program_and_version;
use crate::terminal::shows_colours;

/// What is logged unless RUST_LOG says otherwise. Zenoh warns about discovery, which is switched off.
const DEFAULT_FILTER: &str = "warn,zenoh=error,heliostat=info";

/// Most lines that wait for a slow reader.
const LINES_MAX: usize = 10_000;

/// How a line of the log is written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum LogFormat {
    /// Lines of text
    #[default]
    Text,
    /// One JSON object a line
    Json,
}

/// The flag that says how a process logs.
#[derive(Clone, Copy, Debug, Default, clap::Args)]
pub struct LogArgs {
    /// How the log on standard error is written; the variable RUST_LOG selects levels and targets
    #[arg(long, value_enum, default_value_t)]
    pub log_format: LogFormat,
}

/// Writes the lines that wait when it is dropped, for a second at most.
pub struct LogGuard {
    writer: Option<WorkerGuard>,
    lost: ErrorCounter,
}

impl Drop for LogGuard {
    fn drop(&mut self) {
        // A reader that has made it lose lines would not read the last ones either, and the writer would
        // then complain on standard output.
        if let Some(writer) = self.writer.take().filter(|_| self.lost.dropped_lines() > 0) {
            std::mem::forget(writer);
        }
    }
}

impl LogArgs {
    /// Starts the log; it is written until the result is dropped. Its first line names program and version. Does
    /// nothing where another part of the process has started it.
    #[must_use]
    pub fn start(&self) -> LogGuard {
        let (filter, refused) = filter_of(std::env::var(EnvFilter::DEFAULT_ENV).ok().as_deref());
        // A closed standard error must not end a controller.
        let (writer, guard) = NonBlockingBuilder::default().buffered_lines_limit(LINES_MAX).finish(stderr());
        let lost = writer.error_counter();
        let log = tracing_subscriber::fmt().with_env_filter(filter).log_internal_errors(false);
        let started = match self.log_format {
            // The names of the targets serve the user who selects them.
            LogFormat::Text => log
                .with_target(std::env::var_os(EnvFilter::DEFAULT_ENV).is_some())
                .with_writer(writer)
                .with_ansi(shows_colours(&stderr()))
                .fmt_fields(debug_fn(write_field).delimited(" "))
                .try_init(),
            LogFormat::Json => log.json().flatten_event(true).with_writer(move || Printable(writer.clone())).try_init(),
        };
        if started.is_ok() {
            tracing::info!("{}", program_and_version());
            if let Some(problem) = refused {
                tracing::warn!("{problem}");
            }
        }
        LogGuard { writer: Some(guard), lost }
    }
}

/// The filter that the value of RUST_LOG selects, and why the value is not used.
fn filter_of(value: Option<&str>) -> (EnvFilter, Option<String>) {
    let Some(value) = value else { return (EnvFilter::new(DEFAULT_FILTER), None) };
    let read = match unknown_word(value) {
        Some(word) => Err(format!("\"{word}\" is no level, and no target of this project")),
        None => EnvFilter::try_new(value).map_err(|error| error.to_string()),
    };
    match read {
        Ok(filter) => (filter, None),
        Err(problem) => {
            let expected = "expected levels and targets, for example info or warn,heliostat_bus=debug";
            let problem = format!("the variable RUST_LOG is not used: {problem}; {expected}");
            (EnvFilter::new(DEFAULT_FILTER), Some(problem))
        }
    }
}

/// The first word that is neither a level nor the beginning of a target, as a level with a wrong letter: as the target that
/// the filter takes it for, it would select nothing and leave out all the rest. Other targets have a level, as `hyper=info`.
fn unknown_word(value: &str) -> Option<&str> {
    let is_known = |word: &str| {
        word.contains(['=', '[', ']', '{', '}'])
            || word.parse::<LevelFilter>().is_ok()
            || ["heliostat", "zenoh"].iter().any(|name| word.starts_with(name))
    };
    value.split(',').map(str::trim).find(|word| !is_known(word))
}

/// Writes a field of an event or a span as text.
fn write_field(out: &mut Writer<'_>, field: &Field, value: &dyn Debug) -> fmt::Result {
    let value = format!("{value:?}");
    match field.name() {
        "message" => out.write_str(&printable(&value)),
        // The origin of events that come through the crate log.
        name if name.starts_with("log.") => Ok(()),
        name => write!(out, "{}={}", name.trim_start_matches("r#"), printable(&value)),
    }
}

/// Makes lines printable on their way to another writer.
struct Printable<W>(W);

impl<W: Write> Write for Printable<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        // One call holds complete lines.
        self.0.write_all(printable_lines(&String::from_utf8_lossy(bytes)).as_bytes())?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Mutex};

    use super::*;
    use crate::locks::lock;

    #[derive(Clone, Default)]
    struct Memory(Arc<Mutex<Vec<u8>>>);

    impl Write for Memory {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            lock(&self.0).extend(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_filter_that_cannot_be_read_is_named_and_not_used() {
        for value in ["info", "WARN", "off", "", "warn,heliostat_bus=debug", "error,heliostat_bus", "hyper=info"] {
            assert_eq!(filter_of(Some(value)).1, None, "{value:?}");
        }
        assert_eq!(filter_of(None).1, None);
        for value in ["verbos", "heliostat=info,verbos"] {
            let (filter, problem) = filter_of(Some(value));
            assert_eq!((filter.to_string(), value), (usual_filter(), value));
            assert!(problem.expect("refused").contains("\"verbos\" is no level"), "{value}");
        }
        let (filter, problem) = filter_of(Some("heliostat=loud"));
        assert_eq!(filter.to_string(), usual_filter());
        let problem = problem.expect("refused");
        assert!(problem.starts_with("the variable RUST_LOG is not used: ") && problem.ends_with("=debug"), "{problem}");
    }

    fn usual_filter() -> String {
        EnvFilter::new(DEFAULT_FILTER).to_string()
    }

    #[test]
    fn an_event_is_one_line_without_escape_sequences_in_both_formats() {
        let hostile = "\u{1b}[2J\u{9b}31m\nfaked line";
        let memory = Memory::default();
        let (text, json) = (memory.clone(), memory.clone());
        let text = tracing_subscriber::fmt()
            .with_ansi(false)
            .fmt_fields(debug_fn(write_field).delimited(" "))
            .with_writer(move || text.clone())
            .finish();
        let json = tracing_subscriber::fmt().json().with_writer(move || Printable(json.clone())).finish();
        let event = || tracing::warn!(room = hostile, "policy {hostile}");
        tracing::subscriber::with_default(text, event);
        tracing::subscriber::with_default(json, event);
        let bytes = lock(&memory.0).clone();
        let lines = String::from_utf8(bytes).expect("the log is text");
        assert_eq!(lines.lines().count(), 2, "{lines}");
        assert!(lines.contains("policy \\u001b[2J\\u009b31m\\u000afaked line"), "{lines}");
        assert_eq!(printable_lines(&lines), lines, "no control character is left");
    }
}
