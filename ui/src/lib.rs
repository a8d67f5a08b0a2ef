//! What people see of a running room: the live page, the terminal view, and the buttons of both.
//!
//! Everything shown comes from the public topics of the contract, so a real room shows as well as a simulated one; everything
//! ordered goes out over public topics too. This crate knows neither the controller nor the simulator.
//!
//! - [`view`]: listens, and keeps the latest of every topic.
//! - [`figures`]: what page and terminal both show: rates, sums, times, counters.
//! - [`scene`]: what the page draws: mirrors, people, obstacles, shadows, beams.
//! - [`orders`]: what a button does, and the publishers that do it.
//! - [`server`]: the page on an address; [`guard`] keeps strangers' pages from pressing its buttons.
//! - [`terminal`]: the same figures on a terminal, or as plain lines.

mod assets;
mod error;
pub mod figures;
pub mod guard;
mod latency;
mod live;
pub mod orders;
pub mod scene;
pub mod server;
mod shadow;
pub mod terminal;
pub mod view;

pub use error::UiError;
pub use figures::Figures;
pub use orders::{Errand, Operator, Order};
pub use server::{Page, PageArgs, Server};
pub use terminal::Display;
pub use view::View;
