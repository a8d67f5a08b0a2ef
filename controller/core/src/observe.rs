//! From the inbox to the observation that a policy reads.

pub mod angle_state;
pub mod codeword_state;
pub(crate) mod lead;
pub mod observation;
pub mod observer;
pub mod selection;
pub mod slots;
pub mod target_user;
