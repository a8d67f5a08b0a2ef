//! Logs to standard error, so that standard output holds the summary alone.

use std::io::{IsTerminal, stderr};

use tracing_subscriber::EnvFilter;

/// How a line of the log is written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum LogFormat {
    /// For people
    #[default]
    Text,
    /// One JSON object a line
    Json,
}

/// The flag by which a process is told how to log.
#[derive(Clone, Copy, Debug, Default, clap::Args)]
pub struct LogArgs {
    /// How the log on standard error is written; the variable RUST_LOG chooses how much
    #[arg(long, value_enum, default_value_t)]
    pub log_format: LogFormat,
}

impl LogArgs {
    /// Begins to log: `default` unless RUST_LOG says otherwise. Does nothing where a part of the process has begun already.
    pub fn begin(&self, default: &str) {
        let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(default));
        // Nobody need read the log: a standard error that is gone must not end a controller.
        let log = tracing_subscriber::fmt().with_env_filter(filter).with_writer(stderr).log_internal_errors(false);
        let begun = match self.log_format {
            LogFormat::Text => log.with_ansi(stderr().is_terminal()).try_init(),
            LogFormat::Json => log.json().flatten_event(true).try_init(),
        };
        drop(begun);
    }
}
