//! The description of one room: geometry, optics, users, reports and limits of the controller.
//!
//! [`Scenario`] is read once from TOML and is valid afterwards: unknown keys are refused, and every
//! value is checked against its domain. Each error message states line, key, value and the expected
//! values. Simulator, controller and trainer read the same file.
//!
//! [`ScenarioArgs`], the flags that all commands share, and [`Scenario::read_trace`] open files.
//!
//! # Modules
//! - [`tables`]: the tables that do not change while a room runs.
//! - [`mobility`]: how simulated users move.
//! - [`runtime`]: actuators and limits of the controller.
//! - [`streams`]: rates, latencies, noise, resolution and losses of the reports.
//! - [`mismatch`]: how the true room differs from the assumed one.
//! - [`renames`]: old names of keys and values; [`similar`]: known names that resemble a misspelt one.
//!
//! [`Scenario::channel_model`] converts degrees and square millimetres to the types of
//! `heliostat-channel`.
//!
//! ```
//! use heliostat_scenario::Scenario;
//!
//! let scenario = Scenario::from_toml("[mirrors]\nrows = 8\n")?;
//! assert_eq!(scenario.mirror_count(), 80);
//!
//! let error = Scenario::from_toml("[mirrors]\nrows = 0\n").unwrap_err();
//! assert!(error.to_string().starts_with("line 2: mirrors.rows = 0: expected an integer from 1 to 16: "));
//! # Ok::<(), heliostat_scenario::ScenarioError>(())
//! ```

mod args;
mod array_check;
mod blame;
mod build;
mod builtin;
mod check;
mod error;
mod geometry;
mod geometry_difference;
mod lines;
mod lists;
mod mirror_tables;
pub mod mismatch;
pub mod mobility;
mod mobility_check;
mod overrides;
mod problems;
pub mod renames;
pub mod runtime;
mod scenario;
pub mod streams;
pub mod tables;
mod trace;
mod user_orientation;

pub use args::{ScenarioArgs, ViewerScenarioArgs};
pub use builtin::{BUILTIN_NAMES, DEFAULT_SCENARIO, STUDY_SCENARIO};
pub use check::{POWER_W, RANGE_DEG, SPEED_M_S, USERS_MAX};
pub use error::ScenarioError;
pub use geometry_difference::{GeometryDifference, ROOM_DIFFERS, RoomDifference};
pub use heliostat_files::similar;
pub use mirror_tables::MirrorTables;
pub use mismatch::{Mismatch, MismatchKind, MismatchLevel, Spreads};
pub use mobility::*;
pub use overrides::override_keys;
pub use problems::{Checked, Problem};
pub use runtime::*;
pub use scenario::{Scenario, short_hash};
pub use streams::*;
pub use tables::*;
pub use trace::TraceFileError;
pub use user_orientation::{OrientationModel, UserOrientation};
