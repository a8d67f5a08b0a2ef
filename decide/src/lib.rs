//! The decision core: reports and time in, mirror commands out.
//!
//! The core does no I/O. It reads no clock, opens no file, starts no thread and logs nothing. The caller owns sockets, clocks and threads,
//! and drives one [`Controller`](core::Controller) per room. The same core runs in the controller process, in lockstep, in the closed-loop
//! evaluation and in replay.
//!
//! ```text
//! reports -> inbox -> observer -> observation -> policy -> safety -> command
//! ```
//!
//! - [`inbox`]: the latest report of each stream; refuses stale, foreign and malformed reports ([`refusal`]).
//! - [`observer`]: turns the inbox into an [`observation`], which a policy reads.
//! - [`policy`]: proposes angles; [`safety`] bounds them.
//! - [`capabilities`]: compares the array with the scenario, and applies the emergency stop.
//! - [`core`]: connects these parts; [`outcome`] names their results.

pub mod capabilities;
pub mod core;
pub mod inbox;
pub mod observation;
pub mod observer;
pub mod outcome;
pub mod policy;
pub mod refusal;
pub mod safety;
