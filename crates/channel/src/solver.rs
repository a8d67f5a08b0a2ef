//! Assignment of mirrors to users: the solver of the oracle and of the model-based policies.
//!
//! The solver works on a table of gains, not on geometry, and supports both families of channel
//! models.
//!
//! - **Assignment** (law of reflection): mirror m has one aim, a user or a midpoint between close
//!   users, and gives user k the gain g_km of that aim: H_k = L_k + sum_m g_km. For the user at whom
//!   it is aimed, this is the steering gain a_km. For others, [`Spill`](crate::scene::Spill) lists the
//!   gain; most have none.
//! - **Normals** (the paper's eqs. 2 and 3): H_k = L_k + sum_m c_km max(0, n_m . u_km). The best
//!   normal of mirror m has the direction of sum_k w_k c_km u_km, with the same K weights w_k for
//!   all mirrors.
//!
//! The objective is problem P of the paper with constraint (8a) as a penalty: sum_k [R_k - lambda
//! max(0, R_min,k - R_k)] with R_k = B/K log2(1 + (s H_k)^2). At an optimum, w_k is the derivative
//! of the objective by H_k. [`Problem::qos_penalty`] is lambda: 0 gives the sum rate.
//!
//! | method | search | use |
//! | --- | --- | --- |
//! | [`Solver::fixed_point`] | damped fixed point over the weights, from the last weights and from neutral ones | a policy |
//! | [`Solver::greedy`] | fixed point and greedy fill, passes of single moves, exclusion of users | a policy |
//! | [`Solver::oracle`] | both from all subsets of users, then moves, swaps and pairs of moves to a local optimum; the best of them | the reference |
//! | [`Solver::exhaustive`] | every assignment of aims | a check of the oracle |
//!
//! # Limits
//! The aims are points: users, and the midpoints of the closest pairs. Swaps and pairs of moves
//! choose among users only. With several receiver branches, the combined gains are added as if
//! combining were linear. That is exact for one branch and an approximation for several.
//!
//! The oracle does not depend on earlier problems; fixed point and greedy search do. The solver
//! draws no random number, and nothing allocates after [`Solver::new`].
//!
//! ```
//! use heliostat_channel::{Problem, Solver};
//!
//! // Two users, three mirrors: each row is one user's gain per mirror.
//! let steering = [3e-7, 2e-7, 0.0, 0.0, 1e-7, 4e-7];
//! let problem = Problem {
//!     users: 2,
//!     mirrors: 3,
//!     los_gain: &[0.0, 0.0],
//!     steering_gain: &steering,
//!     directions: None,
//!     spill: None,
//!     amplitude_scale: 1e7,
//!     rate_scale_bps: 10e6,
//!     min_rate_bps: &[],
//!     qos_penalty: 0.0,
//! };
//! let mut solver = Solver::new(2, 3);
//! let oracle = solver.oracle(&problem);
//! assert_eq!(solver.served(), [0, 0, 1]);
//! assert_eq!(solver.exhaustive(&problem)?, oracle);
//! # Ok::<(), heliostat_channel::SolverError>(())
//! ```

mod assignment;
mod bind;
mod exhaustive;
mod normals;
mod problem;
mod search;
mod solve;
mod spill_table;
mod starts;
mod table;

pub use bind::Method;
pub use problem::{ASSIGNMENTS_MAX, MinimumRates, Problem, QOS_PENALTY, Solution, SolverError};
pub use solve::{Solver, Start};
pub(crate) use table::slope;
