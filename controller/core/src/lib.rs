//! The decision core: reports and time in, mirror commands out.
//!
//! The core performs no I/O. It reads no clock, opens no file, starts no thread and logs nothing.
//! The caller owns sockets, clocks and threads, and drives one [`RoomCore`](room_core::RoomCore) per
//! room with payloads, or its [`Controller`](core::Controller) with messages; [`room_core`] and
//! [`core`] describe the calling orders. The same core runs in the controller process, in lockstep,
//! in the closed-loop evaluation and in replay.
//!
//! ```text
//! input               observe                      policy     output
//! reports -> inbox -> observer -> observation ->   policy ->  safety -> decision
//! ```
//!
//! - [`inbox`]: the latest report of each stream; refuses stale, foreign and malformed reports
//!   ([`refusal`]).
//! - [`observer`]: turns the inbox into an [`observation`], which a policy reads.
//! - [`belief`]: where each user is at the time the command acts, from all reports so far.
//! - [`policy`]: proposes angles; [`safety`] limits them.
//! - [`capabilities`]: compares the array with the scenario. [`guard`] applies the emergency stop,
//!   and [`tenure`] chooses the epoch and stands by for another controller.
//! - [`core`]: connects these parts; [`outcome`] has their results.
//! - [`room_core`]: decodes payloads for the core, and encodes what it publishes, with an example.

pub mod belief;
pub mod core;
mod input;
mod observe;
mod output;
pub mod policy;
pub mod room_core;

pub use input::{inbox, refusal, sequence};
pub use observe::{angle_state, codeword_state, observation, observer, selection, slots, target_user};
pub use output::{capabilities, guard, outcome, safety, tenure};
