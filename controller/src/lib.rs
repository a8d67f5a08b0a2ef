//! The central unit: from reports about a room to mirror angles, within the deadline.

pub mod observation;
pub mod policy;
