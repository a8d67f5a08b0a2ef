//! Why a scenario cannot be used: what was wrong, where, and what was expected.

use std::path::Path;

use heliostat_files::{TomlError, excerpt};
use thiserror::Error;

use crate::builtin::BUILTIN_NAMES;
use crate::similar::{hint, similar};

/// Why a scenario cannot be used; each message states what was wrong, where, and what was expected.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ScenarioError {
    /// The text is not TOML, names a key that does not exist, or gives a key a value of another
    /// type.
    #[error("{origin}: {reason}")]
    Parse {
        /// The file's name, or the override.
        origin: String,
        /// What is refused, with its key, and with its line in a file.
        reason: TomlError,
    },
    /// The file cannot be read.
    #[error("scenario file {path} cannot be read: {message}{}", builtin(path))]
    Read {
        /// The file.
        path: String,
        /// The message of the operating system.
        message: String,
    },
    /// A value is outside its domain, or contradicts another value.
    #[error("{}{key} = {}: {expected}", place(line), excerpt(value))]
    Invalid {
        /// `table.key`.
        key: String,
        /// The value found.
        value: String,
        /// The expected values.
        expected: String,
        /// The line of the file that sets the key, if any.
        line: Option<usize>,
    },
    /// A key or value has another name now.
    #[error("{}{found} was renamed: expected {expected}", place(line))]
    Renamed {
        /// The old `table.key`, or `table.key = "value"`.
        found: String,
        /// The same by the new name.
        expected: String,
        /// The line of the file that sets the key, if any.
        line: Option<usize>,
    },
    /// More than one mirror array, where only one can be used.
    #[error("the scenario has {count} mirror arrays ([[mirrors]]): expected one ([mirrors])")]
    SeveralArrays {
        /// Number of arrays.
        count: usize,
    },
    /// An index of a mirror array that the scenario does not have.
    #[error("there is no mirror array {index}: expected an index from 0 to {}, since the scenario has {count}", count - 1)]
    NoSuchArray {
        /// The index.
        index: usize,
        /// Number of arrays, at least 1.
        count: usize,
    },
    /// An override is not of the form `table.key=value`.
    #[error("override \"{text}\": expected table.key=value, for example blockage.forced_users=2")]
    Override {
        /// The override as given.
        text: String,
    },
    /// An override selects an entry that a list does not have.
    #[error("{list} has no entry {index}: {}", entries(list, *count))]
    NoSuchEntry {
        /// The key of the list.
        list: String,
        /// The index from 0.
        index: usize,
        /// Number of entries that are written.
        count: usize,
    },
    /// There is no built-in scenario of this name.
    #[error(
        "no file and no built-in scenario \"{name}\": expected the path of a TOML file, or one of {}{}",
        BUILTIN_NAMES.join(", "),
        hint(name, BUILTIN_NAMES)
    )]
    UnknownBuiltin {
        /// The name given.
        name: String,
    },
}

/// The built-in scenario that a path may mean.
fn builtin(path: &str) -> String {
    let name = Path::new(path).file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
    let similar = similar(name, BUILTIN_NAMES);
    similar.map(|name| format!("; the built-in scenario {name} is named without folder and suffix")).unwrap_or_default()
}

/// How the entries of a list are given.
fn entries(list: &str, count: usize) -> String {
    match count {
        0 => format!("expected the complete list, as {list}=[...], since none is written"),
        count => format!("expected an index from 0 to {}", count - 1),
    }
}

fn place(line: &Option<usize>) -> String {
    line.map(|line| format!("line {line}: ")).unwrap_or_default()
}
