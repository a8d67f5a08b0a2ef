//! Output of the core: bounded angles, decisions, counters, and the conditions under which commands
//! are withheld.

pub mod capabilities;
pub mod guard;
pub mod outcome;
pub mod safety;
pub mod tenure;
