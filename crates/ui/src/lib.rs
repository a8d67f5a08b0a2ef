//! The live page and the terminal view of a running room, and the buttons of the page.
//!
//! All displayed data comes from the public topics of the contract, and all orders are published on
//! public topics. A real room is therefore displayed like a simulated one. This crate depends on
//! neither the controller nor the simulator.
//!
//! - [`view`]: subscribes to every topic, and keeps the latest message of each.
//! - `array_reports`: the telemetry of all arrays as that of one; `array_faults`: what ends the faults that they report.
//! - `shown_room`: the room that is drawn: announced, given, or the default.
//! - [`in_charge`]: what the mirrors follow, and why it is not the policy.
//! - [`figures`]: rates, sums, times and counters for the page and the terminal.
//! - [`sums`]: the sum rates, their name, and those of the past.
//! - [`scene`]: mirrors, users, obstacles and blocked areas for the page's 3-D view.
//! - [`belief`]: where the controller believes a user to be, as an ellipse.
//! - [`orders`]: the orders of the page's buttons, and their publishers.
//! - `rights`: which of these orders the certificate of the page permits.
//! - `rooms`: which rooms have processes, where the own one has none.
//! - `notes`: what is wrong in the room and lasts, with what to do; `causes`: what follows from it.
//! - `event_log`: what happened in the room, with times.
//! - [`order_log`]: the answers to these orders; [`stop_state`]: how far a stop has come.
//! - [`floor`]: the rate over the floor, for the heat map.
//! - [`stop_switch`]: the emergency stop and its release, for the page and the command line; `stop_watch`: what the arrays
//!   report of it; `stop_words`: both in words.
//! - [`server`]: the HTTP server of the page; [`guard`] refuses requests from other pages.
//! - [`terminal`]: the same figures on a terminal, or as plain lines; [`status`]: once, with what is wrong.

mod array_faults;
mod array_reports;
mod assets;
pub mod belief;
mod blocked_area;
mod causes;
pub mod controllers;
mod error;
mod event_log;
mod expiry;
pub mod figures;
pub mod floor;
pub mod guard;
pub mod in_charge;
mod latency;
mod live;
mod notes;
mod order;
mod order_answer;
pub mod order_log;
mod order_publisher;
pub mod orders;
mod page;
mod problems;
mod rights;
mod rooms;
pub mod scene;
pub mod server;
mod shown_room;
pub mod status;
pub mod stop_state;
pub mod stop_switch;
mod stop_watch;
mod stop_words;
pub mod sums;
mod telemetry_ages;
pub mod terminal;
mod token;
pub mod view;

pub use error::UiError;
pub use figures::Figures;
pub use guard::PublicAddress;
pub use order::StopLabel;
pub use order::{Order, ProcessOrder};
pub use orders::Operator;
pub use page::{NetworkFile, Page, PoliciesOf, PolicyChoice};
pub use rights::Rights;
pub use rooms::find_absent_room;
pub use server::{PageArgs, Place, Server};
pub use shown_room::GeometrySource;
pub use stop_switch::StopSwitch;
pub use stop_words::{UNKNOWN_ARRAYS, still_stopped, stop_in_words};
pub use terminal::Display;
pub use view::View;
