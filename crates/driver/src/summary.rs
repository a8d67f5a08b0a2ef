//! The result of a driver's run.

use std::collections::BTreeMap;
use std::fmt;

use heliostat_array::refusal_counts;
use heliostat_service::printable::printable;
use serde::Serialize;

/// The result of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Summary {
    /// Commands accepted.
    pub commands: u64,
    /// Of those, with an angle beyond the limits.
    pub clipped_commands: u64,
    /// Messages refused, by name.
    pub refused: BTreeMap<String, u64>,
    /// How often the device was connected.
    pub connections: u64,
    /// The last problem; empty if there was none.
    pub last_problem: String,
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "commands        {} ({} clipped)", self.commands, self.clipped_commands)?;
        writeln!(f, "device          connected {} times", self.connections)?;
        for (name, count) in &self.refused {
            writeln!(f, "{}", refusal_counts::line(name, *count))?;
        }
        if !self.last_problem.is_empty() {
            writeln!(f, "last problem    {}", printable(&self.last_problem))?;
        }
        Ok(())
    }
}
