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
//! - [`room_core`]: decodes payloads for the core, and encodes what it publishes.
//!
//! # Example
//!
//! A caller decodes a report, handles it, polls the command that is due, and sends it.
//!
//! ```
//! use heliostat_core::{
//!     core::{Controller, Decision, Due, Timing},
//!     inbox::Message,
//!     policy::Fixed,
//! };
//! use heliostat_proto::{Stamp, UserReport, UserState, decode_into, encode};
//! use heliostat_scenario::Scenario;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let scenario = Scenario::builtin("specular")?.with_overrides(&["users.count=1"])?;
//! let policy = Box::new(Fixed::flat(scenario.mirror_count()));
//! let mut controller = Controller::new(&scenario, scenario.channel_model()?, policy, 1);
//! controller.warm_up(0..2);
//!
//! // In a process the payloads come from the transport, and `now` from a clock.
//! let mut payloads = Vec::new();
//! for tick in 1..=3 {
//!     let stamp = Stamp { source: 7, sequence: tick, time_ns: tick * 10_000_000 };
//!     let user = UserState { position_m: [1.0, 0.5, 0.85], ..UserState::default() };
//!     let mut payload = Vec::new();
//!     encode(&UserReport { stamp, tick, users: vec![user] }, &mut payload)?;
//!     payloads.push((stamp.time_ns, payload));
//! }
//!
//! let (mut report, mut sent) = (UserReport::default(), Vec::new());
//! for (now, payload) in &payloads {
//!     decode_into(&mut report, payload)?;
//!     let decision = match controller.handle_message(*now, Message::Users(&mut report)) {
//!         Due::Command => controller.poll_command(*now, Timing::InTime, &mut |_stage| {}),
//!         Due::StaleCommand => controller.poll_stale_command(*now),
//!         Due::Nothing => continue,
//!     };
//!     if let Decision::Move { command, .. } = decision {
//!         encode(command, &mut sent)?;
//!     }
//! }
//! assert_eq!(controller.counters().commands, 3);
//! // No report for two seconds: the action of this scenario is `hold`, no command.
//! let silent_ns = payloads[2].0 + 2_000_000_000;
//! assert!(matches!(controller.poll_timeout_command(silent_ns), Some(Decision::Hold(_))));
//! # Ok(())
//! # }
//! ```

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
