//! The optimization problem of a solver, its solution, and why it cannot be searched exhaustively.

use thiserror::Error;

use crate::geometry::Vec3;
use crate::scene::Spill;

/// Largest number of assignments (users to the power of mirrors) that an exhaustive search accepts.
pub const ASSIGNMENTS_MAX: f64 = 2e7;

/// Lambda of the oracle and the policies with minimum rates: large enough that every feasible
/// minimum rate is met.
pub const QOS_PENALTY: f64 = 50.0;

/// One problem: gains, scales and minimum rates of K users and M mirrors.
///
/// A gain that is negative or not finite counts as 0.
#[derive(Clone, Copy, Debug)]
pub struct Problem<'a> {
    /// Number of users K.
    pub users: usize,
    /// Number of mirrors M.
    pub mirrors: usize,
    /// Line-of-sight gain of each user, dimensionless. Shape: K.
    pub los_gain: &'a [f64],
    /// Steering gain of each user and mirror, dimensionless. Shape: K * M, index k * M + m.
    pub steering_gain: &'a [f64],
    /// Unit vectors from mirror to user, for the problem of normals; `None` for the problem of
    /// assignment. Shape: K * M.
    pub directions: Option<&'a [Vec3]>,
    /// Gains of other users than the one at whom a mirror is aimed; `None` to omit them, and for the
    /// problem of normals.
    pub spill: Option<&'a Spill>,
    /// Amplitude scale s: a gain H gives the rate B/K log2(1 + (s H)^2). Dimensionless.
    pub amplitude_scale: f64,
    /// B/K in Hz.
    pub rate_scale_bps: f64,
    /// Minimum rate of each user in bit/s; missing entries are 0. Shape: K.
    pub min_rate_bps: &'a [f64],
    /// Lambda: penalty per bit/s below the minimum rate, dimensionless. 0 gives the sum rate.
    pub qos_penalty: f64,
}

/// The value of a solution, by the table of gains.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solution {
    /// Sum of rates less the penalty, in bit/s.
    pub objective_bps: f64,
    /// Sum of rates in bit/s.
    pub sum_rate_bps: f64,
}

/// Why an exhaustive search is not possible.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum SolverError {
    /// Too many assignments.
    #[error(
        "too many assignments of mirrors ({mirrors}) to users ({users}): {assignments:.0e}, expected at most {ASSIGNMENTS_MAX:e}; use fewer users or mirrors"
    )]
    TooMany {
        /// Number of users.
        users: usize,
        /// Number of mirrors.
        mirrors: usize,
        /// users to the power of mirrors.
        assignments: f64,
    },
    /// The problem is one of normals, which are continuous.
    #[error("the normals of mirrors are continuous: expected a problem of assignment, as in the specular mode")]
    Continuous,
}

impl SolverError {
    /// Checks that an exhaustive search accepts this number of assignments.
    ///
    /// # Errors
    /// [`SolverError::TooMany`].
    pub fn check_assignments(users: usize, mirrors: usize) -> Result<(), Self> {
        let assignments = (users as f64).powf(mirrors as f64);
        if assignments > ASSIGNMENTS_MAX { Err(Self::TooMany { users, mirrors, assignments }) } else { Ok(()) }
    }
}

/// The minimum rates of the users, and the penalty for missing them.
#[derive(Clone, Copy, Debug)]
pub struct MinimumRates<'a> {
    /// Minimum rate of each user in bit/s; missing entries are 0. Shape: K.
    pub min_rate_bps: &'a [f64],
    /// Lambda of the objective: 0 gives the sum rate, [`QOS_PENALTY`] meets every feasible minimum
    /// rate.
    pub qos_penalty: f64,
}

impl MinimumRates<'_> {
    /// No minimum rates: the objective is the sum rate.
    pub const NONE: MinimumRates<'static> = MinimumRates { min_rate_bps: &[], qos_penalty: 0.0 };
}
