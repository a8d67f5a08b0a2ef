//! Logs to standard error: standard output holds the summary only.

use std::io::{IsTerminal, stderr};

use tracing_subscriber::EnvFilter;

/// What is logged unless RUST_LOG says otherwise. Zenoh warns about discovery, which is switched off.
const DEFAULT_FILTER: &str = "warn,zenoh=error,heliostat=info";

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

impl LogArgs {
    /// Starts the log. Does nothing where another part of the process has started it.
    pub fn start(&self) {
        let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(DEFAULT_FILTER));
        // A closed standard error must not end a controller.
        let log = tracing_subscriber::fmt().with_env_filter(filter).with_writer(stderr).log_internal_errors(false);
        let started = match self.log_format {
            LogFormat::Text => log.with_ansi(stderr().is_terminal()).try_init(),
            LogFormat::Json => log.json().flatten_event(true).try_init(),
        };
        drop(started);
    }
}
