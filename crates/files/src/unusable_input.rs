//! The mark of an error that what a user typed or named has caused, for libraries without a transport too.

use std::error::Error;
use std::fmt;

/// What a user typed or named cannot be used: the source, or the context, of an error about it. A program exits with
/// status 2 then.
#[derive(Clone, Debug)]
pub struct UnusableInput(String);

impl UnusableInput {
    /// A message that names the input and what it cannot be used for.
    pub fn new(message: impl Into<String>) -> Self {
        Self(message.into())
    }
}

impl fmt::Display for UnusableInput {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl Error for UnusableInput {}
