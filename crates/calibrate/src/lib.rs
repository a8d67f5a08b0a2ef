//! Calibration of a mirror array in its room: which mirror to turn where, and what the readings say.
//!
//! One hand-held receiver stands at a few spots. One mirror at a time is turned to it, or half of a coded
//! group where the receiver's own noise dominates, and channel reports say how much light arrives. From these readings one estimate follows for everything that
//! moves the light: the offset of each axis of each mirror, the places and the half-power semi-angle
//! of the LEDs, the height and the shift of the tracker's frame, the detector's factor, and the spots
//! themselves.
//!
//! - [`session`]: the procedure, sans I/O: reports in, commands out.
//! - [`probes`]: which mirror is probed next, and where.
//! - [`optics`]: the light of one mirror with its derivatives.
//! - [`mod@fit`]: the joint estimate and its covariance.
//! - [`code`]: the patterns of coded groups, and the light of each of their mirrors.
//! - [`commander`]: the commands as those of a guest in the room: taking the lead, and giving it back.
//! - [`places`]: where the receiver stands, unless places are named.
//! - [`signal`]: whether single mirrors are bright enough for that.
//! - [`outcome`]: corrections, the measured room, and how sure both are.
//!
//! # Identifiability
//! The gain is flat inside a mirror's light, so the information is at the edges. The height of the
//! frame and a common error of all entered heights cannot be told apart. A shift of the LED and a
//! common offset of all mirrors nearly cancel: the offsets look less sure than the pointing is. So
//! [`outcome`] judges a mirror by its pointing.
//!
//! Nothing here reads a clock, opens a file or starts a thread.

pub mod code;
pub mod commander;
pub mod fit;
pub mod grid;
pub mod optics;
pub mod outcome;
pub mod parameters;
pub mod places;
pub mod probes;
pub mod session;
pub mod signal;
pub mod stand;

pub use outcome::{Measured, Outcome, Verdict};
pub use parameters::Prior;
pub use session::{Change, Log, Place, Progress, Session, Setup, SetupError, Stage};
