//! Shared parts of the tests across processes, and the packages of the build.
//!
//! - [`Process`]: a built program as a process.
//! - [`RoomObserver`]: a session that receives the messages of a room, and [`Latest`], those of one key.
//! - [`Browser`]: a browser with one page.
//! - [`PageServer`]: a server of the live page.
//! - [`Pauses`]: the longest pause of the machine.
//! - [`Turn`]: a turn of a test that computes for most of its time.
//! - [`PythonExample`]: an example in Python as a process.
//! - [`containers`]: a container engine with base images.
//! - [`faults`]: rooms of processes, faults, and the measurement of their effects.
//!
//! Tests see what a driver, a viewer or a user at the terminal sees; nothing here reaches into a
//! process.

mod browser;
pub mod containers;
pub mod faults;
mod live_page;
mod metrics;
mod observer;
pub mod packages;
mod pauses;
mod process;
mod python;
mod turn;
mod wait;

pub use browser::Browser;
pub use live_page::{PageServer, choose_theme};
pub use metrics::{fetch_metrics, sample_value};
pub use observer::{Latest, RoomObserver, encoded};
pub use pauses::Pauses;
pub use process::{Ended, Process, TWO_ARRAYS, golden_recording, number, programs, workspace};
pub use python::{PythonExample, python};
pub use turn::Turn;
pub use wait::wait_until;
