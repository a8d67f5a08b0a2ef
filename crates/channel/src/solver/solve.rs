//! The solver of problems of one size: it loads a problem, runs a method and keeps the solution.

use super::exhaustive;
use super::normals::NormalSearch;
use super::problem::{Problem, Solution, SolverError};
use super::search::Search;
use super::table::{Table, Utility};
use crate::geometry::Vec3;
use crate::scene::Spill;

/// A solver of problems of one size, with the last solution.
#[derive(Clone, Debug)]
pub struct Solver {
    users: usize,
    mirrors: usize,
    table: Table,
    utility: Utility,
    search: Search,
    normals: NormalSearch,
    /// The spill of the last scene.
    pub(super) spill: Spill,
    /// Weights of the last solution.
    weights: Vec<f64>,
    /// The former weights, while the users change.
    former_weights: Vec<f64>,
}

/// What the next solution starts from: the last one.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Start {
    /// Weights of the users. Shape: K.
    pub weights: Vec<f64>,
    /// The aim of each mirror, see [`Solver::served`]. Shape: M.
    pub served: Vec<usize>,
    /// The two users of each midpoint.
    pub midpoints: Vec<[usize; 2]>,
}

impl Solver {
    /// A solver for this many users and mirrors; allocates all memory.
    ///
    /// # Panics
    /// When the number of users or of mirrors is 0.
    pub fn new(users: usize, mirrors: usize) -> Self {
        assert!(users > 0 && mirrors > 0, "users: {users}, mirrors: {mirrors}, expected at least one of each");
        Self {
            users,
            mirrors,
            table: Table::new(users, mirrors),
            utility: Utility::new(users),
            search: Search::new(users, mirrors),
            normals: NormalSearch::new(users, mirrors),
            spill: Spill::new(users, mirrors),
            weights: vec![0.0; users],
            former_weights: vec![0.0; users],
        }
    }

    /// A solver for `users` users that can grow to `users_max` without an allocation; see
    /// [`Solver::change_users`].
    ///
    /// # Panics
    /// When the number of users or of mirrors is 0, or `users` is above `users_max`.
    pub fn with_capacity(users: usize, users_max: usize, mirrors: usize) -> Self {
        assert!(users <= users_max, "{users} users, expected at most {users_max}");
        let mut solver = Self::new(users_max, mirrors);
        solver.resize(users, |_| Some(0));
        solver.weights.truncate(users);
        solver
    }

    /// Changes the number of users and forgets the last solution; no effect for the present number.
    ///
    /// # Panics
    /// When the number is 0.
    pub fn set_users(&mut self, users: usize) {
        assert!(users > 0, "0 users: expected at least one");
        if users != self.users {
            self.weights.clear();
            self.weights.resize(users, 0.0);
            self.resize(users, |_| None);
        }
    }

    /// Changes the users: `former[k]` is the index that user k had, or `None` for a new one.
    ///
    /// The weights of the last solution move with their users, and a new user starts with the weight
    /// 0, for which a fixed point substitutes the neutral weight. Mirrors that served a user who has
    /// left serve user 0. Does not allocate up to the capacity.
    ///
    /// # Panics
    /// When `former` is empty.
    pub fn change_users(&mut self, former: &[Option<usize>]) {
        assert!(!former.is_empty(), "0 users: expected at least one");
        self.former_weights.clear();
        self.former_weights.extend_from_slice(&self.weights);
        let carried = former.iter().map(|index| index.map_or(0.0, |index| self.former_weights[index]));
        self.weights.clear();
        self.weights.extend(carried);
        self.resize(former.len(), |index| former.iter().position(|entry| *entry == Some(index)));
    }

    fn resize(&mut self, users: usize, now_at: impl Fn(usize) -> Option<usize>) {
        self.users = users;
        self.table.resize(users);
        self.utility.resize(users);
        self.search.resize(users, now_at);
        self.normals.resize(users);
    }

    /// Damped fixed point over the weights, from the weights of the last solution and from neutral
    /// ones.
    ///
    /// Neutral weights are w_k = 1 / sum_m a_km. The better of the two results is the solution.
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

    /// Fixed point and greedy fill, then `passes` of single moves, then the same with single users
    /// excluded.
    ///
    /// For a problem of normals this is the fixed point, which is near the optimum.
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

    /// The multi-start solver: a search from many starts, each to a local optimum.
    ///
    /// Assignment: for each subset of users (all 2^K - 1 up to K = 6, a few dozen nested ones
    /// above), a damped fixed point and a greedy fill among its users, then single moves among all
    /// users. The best few continue with pair swaps to a local optimum, and with pairs of moves if
    /// a minimum rate is penalised. Normals: the fixed point from single users, pairs of users,
    /// uniform and spread weights.
    ///
    /// The result does not depend on earlier calls. It is not proven to be optimal. With 9 mirrors
    /// and 3 users it equals [`Solver::exhaustive`]; with minimum rates there are rare exceptions.
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
    /// [`SolverError`] for more than [`ASSIGNMENTS_MAX`](super::ASSIGNMENTS_MAX) assignments, or
    /// for a problem of normals.
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

    /// The aim of each mirror in the last assignment: a user, or from K on a midpoint of
    /// [`Problem::spill`]; 0 for a mirror that reaches no user. Shape: M.
    pub fn served(&self) -> &[usize] {
        &self.search.best.served
    }

    /// One weight per user of the last solution: not negative, dimensionless. Shape: K.
    ///
    /// After [`Solver::fixed_point`] without spill, the aims are those of [`decode`](crate::decode::decode)
    /// for these weights. After the other methods the weights are the derivatives of the objective, and
    /// [`Solver::served`] is a refined assignment that no weights may reproduce.
    pub fn weights(&self) -> &[f64] {
        &self.weights
    }

    /// A start with memory for any of this solver.
    pub fn start_buffer(&self) -> Start {
        Start {
            weights: Vec::with_capacity(self.weights.capacity()),
            served: Vec::with_capacity(self.mirrors),
            midpoints: Vec::with_capacity(self.search.midpoints.capacity()),
        }
    }

    /// Copies what the next solution starts from. Does not allocate into a
    /// [`start_buffer`](Self::start_buffer).
    pub fn copy_start(&self, into: &mut Start) {
        into.weights.clone_from(&self.weights);
        into.served.clone_from(&self.search.best.served);
        into.midpoints.clone_from(&self.search.midpoints);
    }

    /// Lets the next solution begin at this start; false, without a change, where it is one of other
    /// users or mirrors.
    pub fn set_start(&mut self, start: &Start) -> bool {
        let Start { weights, served, midpoints } = start;
        let aims = self.users + midpoints.len();
        let fits = weights.len() == self.users
            && weights.iter().all(|weight| weight.is_finite())
            && served.len() == self.mirrors
            && served.iter().all(|aim| *aim < aims)
            && midpoints.iter().flatten().all(|user| *user < self.users);
        if fits {
            self.weights.copy_from_slice(weights);
            self.search.best.served.copy_from_slice(served);
            self.search.midpoints.clone_from(midpoints);
        }
        fits
    }

    /// The unit normal of each mirror in the last solution of a problem of normals; zero where no
    /// user is reached. Shape: M.
    pub fn normals(&self) -> &[Vec3] {
        &self.normals.best
    }

    /// Loads the problem; returns whether it is one of normals.
    fn load(&mut self, problem: &Problem) -> bool {
        let size = (problem.users, problem.mirrors);
        assert_eq!(size, (self.users, self.mirrors), "users and mirrors of the problem and of the solver");
        assert_eq!(problem.los_gain.len(), self.users, "one line-of-sight gain per user");
        assert_eq!(problem.steering_gain.len(), self.users * self.mirrors, "one steering gain per user and mirror");
        self.table.load(problem);
        self.search.follow_midpoints(&self.table);
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
