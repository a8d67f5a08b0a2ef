//! Channel physics of a mirror-array optical wireless link: geometry, gain, SINR, rate and bit
//! error rate.
//!
//! LED panels on the ceiling of a room transmit data to mobile users. Arrays of small mirrors on
//! walls, each with two angles, reflect light to users whose direct path is blocked. This crate
//! computes the gain of each path, and from it SINR, rate and bit error rate. [`Scene`] treats all
//! users and mirrors in one pass.
//!
//! It is not a ray tracer: walls are black, a path has at most one reflection, mirrors do not shade
//! each other, and light has no wavelength and no delay spread. The crate reads no clock, opens no
//! file and draws no random number. It contains no messages, files or policies.
//!
//! Units are metres, radians, watts and amperes. The frame has its origin at the centre of the
//! floor, z up. A gain is the optical power on the detector (times filter and concentrator gain)
//! over the optical power of the LED: dimensionless.
//!
//! # Modules
//! - [`geometry`]: points, directions and their errors; [`angle`]: mechanical and optical angles as
//!   different types.
//! - [`domain`]: checks of numbers; [`error`]: why a model cannot be built.
//! - [`emitter`], [`receiver`], [`mirrors`], [`arrays`]: the equipment of a room.
//! - [`orientation`]: how a user holds the receiver.
//! - [`blockage`]: cylinders that block paths.
//! - [`los`], [`specular`], [`diffuse`]: the gain of one path; reference implementations.
//! - [`link`]: noise, SINR, rate, bit error rate, fairness.
//! - [`model`]: the equipment and the link budget, checked, as one [`ChannelModel`].
//! - [`scene`]: all users and mirrors at once, without allocation.
//! - [`decode`]: from weights of users to angles of mirrors.
//! - [`sharing`]: a smooth approximation of decoder and solver, for policies.
//! - [`solver`]: the assignment of mirrors to users: the oracle and the model-based policies.

mod aiming;
pub mod angle;
pub mod arrays;
pub mod blockage;
pub mod decode;
pub mod diffuse;
pub mod domain;
pub mod emitter;
pub mod error;
pub mod floor_normal;
pub mod geometry;
pub mod link;
pub mod los;
pub mod mirrors;
pub mod model;
pub mod orientation;
mod quadrature;
pub mod receiver;
pub mod scene;
pub mod sharing;
pub mod simd;
pub mod solver;
pub mod specular;
mod trig;

pub use angle::{Mechanical, Optical};
pub use arrays::MirrorArrays;
pub use blockage::{Body, Cylinder};
pub use emitter::Led;
pub use error::ChannelError;
pub use geometry::{GeometryError, Vec3};
pub use link::{LinkBudget, NoiseBudget, PowerLaw, ber_ook, jain};
pub use mirrors::{ArraySpec, MirrorAngles, MirrorArray, Wall};
pub use model::{ChannelModel, Mode};
pub use orientation::Orientation;
pub use receiver::{Branch, Combining, Receiver};
pub use scene::Scene;
pub use solver::{Method, MinimumRates, Problem, Solution, Solver, SolverError};
