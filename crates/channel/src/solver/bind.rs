//! From a scene to a problem, and from a solution to the angles of the mirrors.

use super::problem::{MinimumRates, Problem, SolverError};
use super::solve::Solver;
use crate::decode::aim_at;
use crate::mirrors::MirrorAngles;
use crate::model::{ChannelModel, Mode};
use crate::scene::Scene;

/// The search method of a policy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// [`Solver::fixed_point`].
    FixedPoint,
    /// [`Solver::greedy`].
    Greedy {
        /// Number of passes of single moves.
        passes: usize,
    },
    /// [`Solver::oracle`].
    Oracle,
}

impl<'a> Problem<'a> {
    /// The problem of a scene: its gains, the link budget and the minimum rates, without spill.
    ///
    /// [`Solver::solve`] adds the spill.
    pub fn of_scene(model: &ChannelModel, scene: &'a Scene, min_rates: &MinimumRates<'a>) -> Self {
        let users = scene.users();
        Self {
            users,
            mirrors: model.mirrors.len(),
            los_gain: scene.los_gain(),
            steering_gain: scene.steering_gain(),
            directions: match model.mode {
                Mode::Specular => None,
                Mode::Paper { .. } => Some(scene.directions()),
            },
            spill: None,
            amplitude_scale: model.budget.amplitude_scale(),
            rate_scale_bps: model.budget.bandwidth_hz / users as f64,
            min_rate_bps: min_rates.min_rate_bps,
            qos_penalty: min_rates.qos_penalty,
        }
    }
}

impl Solver {
    /// Solves the problem of a scene and writes the angles of the mirrors. The fixed point leaves
    /// the spill out, since that takes several times as long as all else; the other methods count it.
    ///
    /// Returns the objective in bit/s, without light that is not counted. By the law of reflection it is that of the angles, up to
    /// rounding; with several receiver branches, to the approximation of [`crate::solver`].
    ///
    /// `out`: mechanical angles in radians. Shape: M.
    ///
    /// # Panics
    /// When solver, scene, model and `out` differ in the number of users or mirrors.
    pub fn solve(
        &mut self,
        model: &ChannelModel,
        scene: &Scene,
        min_rates: &MinimumRates,
        method: Method,
        out: &mut MirrorAngles,
    ) -> f64 {
        let spilled = method != Method::FixedPoint;
        let solution = self.with_spill(model, scene, min_rates, spilled, |solver, problem| match method {
            Method::FixedPoint => solver.fixed_point(problem),
            Method::Greedy { passes } => solver.greedy(problem, passes),
            Method::Oracle => solver.oracle(problem),
        });
        self.write_angles(model, out);
        solution.objective_bps
    }

    /// As [`Solver::solve`], by [`Solver::exhaustive`].
    ///
    /// # Errors
    /// As [`Solver::exhaustive`].
    ///
    /// # Panics
    /// As [`Solver::solve`].
    pub fn solve_exhaustively(
        &mut self,
        model: &ChannelModel,
        scene: &Scene,
        min_rates: &MinimumRates,
        out: &mut MirrorAngles,
    ) -> Result<f64, SolverError> {
        let solution = self.with_spill(model, scene, min_rates, true, |solver, problem| solver.exhaustive(problem))?;
        self.write_angles(model, out);
        Ok(solution.objective_bps)
    }

    /// Calls `solve` with the problem of a scene, with or without its spill.
    fn with_spill<T>(
        &mut self,
        model: &ChannelModel,
        scene: &Scene,
        min_rates: &MinimumRates,
        spilled: bool,
        solve: impl FnOnce(&mut Self, &Problem) -> T,
    ) -> T {
        // Taken out, so that the problem can borrow it; an empty list does not allocate.
        let mut spill = std::mem::take(&mut self.spill);
        if spilled {
            spill.update(model, scene);
        } else {
            spill.clear(scene);
        }
        let solved = solve(self, &Problem { spill: Some(&spill), ..Problem::of_scene(model, scene, min_rates) });
        self.spill = spill;
        solved
    }

    fn write_angles(&self, model: &ChannelModel, out: &mut MirrorAngles) {
        if model.mode == Mode::Specular {
            aim_at(model, &self.spill, self.served(), out);
            return;
        }
        for (m, normal) in self.normals().iter().enumerate() {
            let matters = normal.norm_squared() > 0.0;
            (out.roll[m], out.yaw[m]) = if matters { model.mirrors.angles_of(m, normal) } else { (0.0, 0.0) };
        }
    }
}
