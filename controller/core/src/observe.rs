//! From the inbox to the observation that a policy reads.

pub mod observation;
pub mod observer;
pub mod prediction;
pub mod selection;
pub mod slots;
