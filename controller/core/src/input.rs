//! Input of the core: the latest report of each stream, and the reasons for refusing a report.

pub mod inbox;
pub mod refusal;
pub mod sequence;
