//! What can be wrong with a scenario.

use thiserror::Error;

/// Why a scenario cannot be used; each message says what was wrong, where, and what was wanted.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ScenarioError {
    /// The text is not TOML, names a key that does not exist, or gives a key a value of another type.
    #[error("{origin}: {message}")]
    Parse {
        /// The file's name, or the override.
        origin: String,
        /// The parser's account, with the line.
        message: String,
    },
    /// The file cannot be read.
    #[error("scenario file {path} cannot be read: {message}")]
    Read {
        /// The file.
        path: String,
        /// The operating system's account.
        message: String,
    },
    /// A value is outside its domain, or does not go with another.
    #[error("{}{key} = {value}: {wanted}", line.map(|line| format!("line {line}: ")).unwrap_or_default())]
    Invalid {
        /// `table.key`.
        key: String,
        /// The value found.
        value: String,
        /// What would be right.
        wanted: String,
        /// The line of the file, where the key stands in one.
        line: Option<usize>,
    },
    /// An override is not of the form `table.key=value`.
    #[error("override \"{text}\": wanted table.key=value, for example blockage.forced_users=2")]
    Override {
        /// The override as given.
        text: String,
    },
    /// There is no built-in scenario of this name.
    #[error("no built-in scenario \"{name}\"; there are {}", crate::BUILTIN_NAMES.join(", "))]
    UnknownBuiltin {
        /// The name asked for.
        name: String,
    },
}
