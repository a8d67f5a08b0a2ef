//! Channel physics of a mirror-array optical wireless link.
//!
//! One or several LED panels on the ceiling of a room send data to people who walk below. Where somebody stands in the light, an array of
//! small mirrors on a wall, each turned by two angles, can bring it back. This crate computes how much light arrives: from the geometry of
//! the room over channel gain, SINR and rate to bit error rate. `Scene` does it for all users and mirrors in one pass.
//!
//! It is not a ray tracer: the walls are black, a path has at most one reflection, mirrors do not shade each other, and light has no wavelength and no
//! delay spread. It reads no clock, opens nothing and draws no random number; it knows nothing of messages, files or policies.
//!
//! Inside, lengths are metres, angles radians, power watts and currents amperes. The frame has its origin at the centre of the floor, z up.
//! Gains are dimensionless: optical power on the detector (times filter and concentrator gain) over optical power of the LED.
//!
//! # Parts
//! - [`angle`]: mechanical and optical angles as different types.
//! - [`emitter`], [`receiver`], [`mirrors`]: what a room is equipped with.
//! - [`blockage`]: cylinders that interrupt paths.
//! - [`los`], [`specular`], [`diffuse`]: the gain of one path; reference implementations.
//! - [`link`]: noise, SINR, rate, bit error rate, fairness.
//! - [`model`]: the parts above, checked, as one [`ChannelModel`].
//! - [`scene`]: all users and mirrors at once, without allocation.
//! - [`decode`]: from weights of users to angles of mirrors.
//! - [`sharing`]: what shares of the mirrors give, and weights that balance them.
//! - [`solver`]: which mirror should serve whom; the oracle and what the model-based policies use.

pub mod angle;
pub mod blockage;
pub mod decode;
pub mod diffuse;
pub mod emitter;
pub mod error;
pub mod link;
pub mod los;
pub mod mirrors;
pub mod model;
mod quadrature;
pub mod receiver;
pub mod scene;
pub mod sharing;
pub mod solver;
pub mod specular;
mod trig;
mod wide;

pub use angle::{Mechanical, Optical};
pub use blockage::Cylinder;
pub use emitter::Led;
pub use error::{ChannelError, GeometryError};
pub use link::{LinkBudget, NoiseBudget, PowerLaw, ber_ook, jain};
pub use mirrors::{ArraySpec, MirrorAngles, MirrorArray, Wall};
pub use model::{ChannelModel, Mode};
pub use receiver::{Branch, Combining, Receiver};
pub use scene::Scene;
pub use solver::{Method, Need, Problem, Solution, Solver, SolverError};

/// A point or a direction in three dimensions, in m where it is a point.
pub type Vec3 = nalgebra::Vector3<f64>;
