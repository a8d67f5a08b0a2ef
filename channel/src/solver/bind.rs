//! From a scene to a problem, and from a solution to the angles of the mirrors.

use super::problem::{MinimumRates, Problem};
use super::solve::Solver;
use crate::decode::aim;
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
    /// The problem of a scene: its gains, the link budget and the minimum rates.
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
            amplitude_scale: model.budget.amplitude_scale(),
            rate_scale_bps: model.budget.bandwidth_hz / users as f64,
            min_rate_bps: min_rates.min_rate_bps,
            qos_penalty: min_rates.qos_penalty,
        }
    }
}

impl Solver {
    /// Solves the problem of a scene and writes the angles of the mirrors.
    ///
    /// Returns the objective in bit/s by the table of gains. The angles can give slightly more, by
    /// light that reaches other users.
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
        let problem = Problem::of_scene(model, scene, min_rates);
        let solution = match method {
            Method::FixedPoint => self.fixed_point(&problem),
            Method::Greedy { passes } => self.greedy(&problem, passes),
            Method::Oracle => self.oracle(&problem),
        };
        self.write_angles(model, scene, out);
        solution.objective_bps
    }

    fn write_angles(&self, model: &ChannelModel, scene: &Scene, out: &mut MirrorAngles) {
        if model.mode == Mode::Specular {
            aim(model, scene, self.served(), out);
            return;
        }
        for (m, normal) in self.normals().iter().enumerate() {
            let matters = normal.norm_squared() > 0.0;
            (out.roll[m], out.yaw[m]) = if matters { model.mirrors.angles_of(normal) } else { (0.0, 0.0) };
        }
    }
}
