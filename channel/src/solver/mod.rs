//! Which mirror should serve whom: one solver behind the oracle and the model-based policies.
//!
//! Works on a table of gains, not on geometry, and for both families of channel.
//!
//! - **Assignment** (law of reflection): mirror m gives a_km to the one user k it is aimed at, so H_k = L_k + sum a_km over the
//!   mirrors of k.
//! - **Normals** (the paper's eqs. 2-3): H_k = L_k + sum_m c_km max(0, n_m . u_km), and the best normal of mirror m is the direction of
//!   sum_k w_k c_km u_km with the same few weights w_k for all mirrors.
//!
//! Either way the objective is problem P of the paper with its constraint (8a) as a penalty,
//! sum_k [R_k - lambda max(0, R_min,k - R_k)] with R_k = B/K log2(1 + (s H_k)^2), and at an optimum w_k is its derivative by H_k.
//! [`Problem::qos_penalty`] is lambda: 0 gives the plain sum rate, 50 the oracle with QoS.
//!
//! | method | what it does | for |
//! | --- | --- | --- |
//! | [`Solver::fixed_point`] | damped fixed point over the weights, from the last weights and from neutral ones | a policy |
//! | [`Solver::greedy`] | the same and a fill, passes of single moves, and leaving users out | a policy |
//! | [`Solver::oracle`] | both from all subsets of users, then moves, swaps and pairs of moves to a local optimum | the yardstick |
//! | [`Solver::exhaustive`] | every assignment | checking the oracle |
//!
//! What is left out: the spill of one user's spot onto another. The true gain of the angles can therefore be a little larger than
//! the solution says, and where two users stand in one spot, some 0.2 m apart, an aim that serves both is not looked for. With
//! several receiver branches the table's combined gains are used as if they added up, which is exact for a single branch and an
//! approximation for several.
//!
//! The oracle does not depend on what was solved before; the other two do. Nothing here draws a random number, and nothing
//! allocates after [`Solver::new`].

mod assignment;
mod bind;
mod exhaustive;
mod normals;
mod search;
mod starts;
mod table;

use crate::Vec3;
use normals::NormalSearch;
use search::Search;
pub(crate) use table::slope;
use table::{Table, Utility};
use thiserror::Error;

pub use bind::{Method, Need};
pub use exhaustive::ASSIGNMENTS_MAX;

/// Lambda of the oracle with minimum rates, and of policies that keep them: so large that a need is met wherever it can be.
pub const QOS_PENALTY: f64 = 50.0;

/// One problem to solve: gains, scales and needs of K users and M mirrors.
///
/// A gain that is negative or not a number counts as none.
#[derive(Clone, Copy, Debug)]
pub struct Problem<'a> {
    /// Number of users K.
    pub users: usize,
    /// Number of mirrors M.
    pub mirrors: usize,
    /// Gain of each user's direct path, dimensionless. Shape: K.
    pub los: &'a [f64],
    /// What each mirror can give each user, dimensionless. Shape: K * M, index k * M + m.
    pub steering: &'a [f64],
    /// Unit vectors from mirror to user, for the problem of normals; `None` for the problem of assignment. Shape: K * M.
    pub directions: Option<&'a [Vec3]>,
    /// Scale s: a gain H gives the rate B/K log2(1 + (s H)^2).
    pub amplitude_scale: f64,
    /// B/K in Hz.
    pub rate_scale_bps: f64,
    /// Minimum rate of each user in bit/s; missing entries are 0. Shape: K.
    pub min_rate_bps: &'a [f64],
    /// Lambda: what a missing bit/s costs, in bit/s. 0 is the plain sum rate.
    pub qos_penalty: f64,
}

/// What a solution is worth by the table it was computed from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solution {
    /// Sum of rates less the penalty, in bit/s.
    pub objective_bps: f64,
    /// Sum of rates in bit/s.
    pub sum_rate_bps: f64,
}

/// Why a problem cannot be searched exhaustively.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum SolverError {
    /// Too many assignments.
    #[error(
        "{users} users and {mirrors} mirrors have {assignments:e} assignments, but at most {ASSIGNMENTS_MAX:e} can be tried"
    )]
    TooMany {
        /// Number of users.
        users: usize,
        /// Number of mirrors.
        mirrors: usize,
        /// users to the power of mirrors.
        assignments: f64,
    },
    /// Normals are continuous: there is nothing to enumerate.
    #[error("normals of mirrors are continuous, but an exhaustive search needs an assignment")]
    Continuous,
}

/// Solves problems of one size and remembers the last solution.
#[derive(Clone, Debug)]
pub struct Solver {
    users: usize,
    mirrors: usize,
    table: Table,
    utility: Utility,
    search: Search,
    normals: NormalSearch,
    /// Weights of the last solution.
    weights: Vec<f64>,
}

impl Solver {
    /// A solver for this many users and mirrors; all memory is taken here.
    ///
    /// # Panics
    /// When there is no user or no mirror.
    pub fn new(users: usize, mirrors: usize) -> Self {
        assert!(users > 0 && mirrors > 0, "a solver needs a user and a mirror, but has {users} and {mirrors}");
        Self {
            users,
            mirrors,
            table: Table::new(users, mirrors),
            utility: Utility::new(users),
            search: Search::new(users, mirrors),
            normals: NormalSearch::new(users, mirrors),
            weights: vec![0.0; users],
        }
    }

    /// Damped fixed point over the weights, from those of the last solution and from neutral ones.
    ///
    /// # Panics
    /// When the problem has another size than the solver.
    pub fn fixed_point(&mut self, problem: &Problem) -> Solution {
        if self.load(problem) {
            self.normals.fixed_point(&self.table, &self.utility, &mut self.weights);
        } else {
            self.search.fixed_point(&self.table, &self.utility, &mut self.weights);
        }
        self.solution(problem)
    }

    /// Fixed point and greedy fill, then passes of single moves, then the same without one user or another.
    ///
    /// In the problem of normals this is the fixed point, which is near the optimum there.
    ///
    /// # Panics
    /// When the problem has another size than the solver.
    pub fn greedy(&mut self, problem: &Problem, passes: usize) -> Solution {
        if self.load(problem) {
            self.normals.fixed_point(&self.table, &self.utility, &mut self.weights);
        } else {
            self.search.greedy(&self.table, &self.utility, &mut self.weights, passes);
        }
        self.solution(problem)
    }

    /// The yardstick: many starts, each to a local optimum. The result does not depend on earlier calls.
    ///
    /// Assignment: for each subset of users (all 2^K - 1 up to K = 6; at most a few dozen nested ones above) a damped
    /// fixed point and a greedy fill among its users and single moves among all; the best few continue with pair swaps, and with any two moves at once when a rate is
    /// penalised, until nothing helps. It is a search and no proof: with 9 mirrors and 3 users it finds what
    /// [`Solver::exhaustive`] finds, except in about 1 of 200 rooms where a minimum rate is penalised. Normals: the fixed point from each user, pairs of users, uniform and spread weights.
    ///
    /// # Panics
    /// When the problem has another size than the solver.
    pub fn oracle(&mut self, problem: &Problem) -> Solution {
        if self.load(problem) {
            self.normals.oracle(&self.table, &self.utility, &mut self.weights);
        } else {
            self.search.oracle(&self.table, &self.utility, &mut self.weights);
        }
        self.solution(problem)
    }

    /// The best of all assignments, for few mirrors and users.
    ///
    /// # Errors
    /// [`SolverError`] when there are more than [`ASSIGNMENTS_MAX`] assignments, or the problem is one of normals.
    ///
    /// # Panics
    /// When the problem has another size than the solver.
    pub fn exhaustive(&mut self, problem: &Problem) -> Result<Solution, SolverError> {
        if self.load(problem) {
            return Err(SolverError::Continuous);
        }
        exhaustive::search(&self.table, &self.utility, &mut self.search.best)?;
        self.search.slopes(&self.utility, &mut self.weights);
        Ok(self.solution(problem))
    }

    /// The user each mirror serves in the last solution of an assignment; 0 for a mirror that reaches nobody. Shape: M.
    pub fn served(&self) -> &[usize] {
        &self.search.best.served
    }

    /// One weight a user, of the last solution: not negative, dimensionless. Shape: K.
    ///
    /// After [`Solver::fixed_point`] mirror m serves argmax_k w_k a_km. After the other methods of an assignment the weights are the derivatives
    /// of the objective, and [`Solver::served`] has been refined beyond what weights can say.
    pub fn weights(&self) -> &[f64] {
        &self.weights
    }

    /// Lets the next solution start as if these had been the last one's weights. Shape: K.
    ///
    /// # Panics
    /// When there is not one weight a user.
    pub fn set_weights(&mut self, weights: &[f64]) {
        self.weights.copy_from_slice(weights);
    }

    /// The unit normal of each mirror in the last solution of a problem of normals, zero where it does not matter. Shape: M.
    pub fn normals(&self) -> &[Vec3] {
        &self.normals.best
    }

    /// Reads the problem; whether it is one of normals.
    fn load(&mut self, problem: &Problem) -> bool {
        let size = (problem.users, problem.mirrors);
        assert_eq!(size, (self.users, self.mirrors), "users and mirrors of the problem and of the solver");
        assert_eq!(problem.los.len(), self.users, "one direct gain a user");
        assert_eq!(problem.steering.len(), self.users * self.mirrors, "one gain a user and mirror");
        self.table.load(problem);
        self.utility.load(problem);
        for weight in &mut self.weights {
            if !(weight.is_finite() && *weight >= 0.0) {
                *weight = 0.0;
            }
        }
        if let Some(directions) = problem.directions {
            self.normals.load(&self.table, directions);
        }
        problem.directions.is_some()
    }

    fn solution(&self, problem: &Problem) -> Solution {
        let amplitude =
            if problem.directions.is_some() { &self.normals.best_amplitude } else { &self.search.best.amplitude };
        Solution {
            objective_bps: self.utility.objective_bps(amplitude),
            sum_rate_bps: self.utility.sum_rate_bps(amplitude),
        }
    }
}
