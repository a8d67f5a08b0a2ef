//! From a scene to a problem, and from a solution to the angles of the mirrors.

use super::{Problem, Solver};
use crate::decode::aim;
use crate::mirrors::MirrorAngles;
use crate::model::{ChannelModel, Mode};
use crate::scene::Scene;

/// How a policy searches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// [`Solver::fixed_point`].
    FixedPoint,
    /// [`Solver::greedy`].
    Greedy {
        /// Passes of single moves.
        passes: usize,
    },
    /// [`Solver::oracle`].
    Oracle,
}

/// What the users need, and what it costs not to give it.
#[derive(Clone, Copy, Debug)]
pub struct Need<'a> {
    /// Minimum rate of each user in bit/s; missing entries are 0. Shape: K.
    pub min_rate_bps: &'a [f64],
    /// Lambda of the objective: 0 is the plain sum rate, 50 meets a need wherever it can be met.
    pub qos_penalty: f64,
}

impl Need<'_> {
    /// Nobody needs anything: the plain sum rate.
    pub const NONE: Need<'static> = Need { min_rate_bps: &[], qos_penalty: 0.0 };
}

impl<'a> Problem<'a> {
    /// The problem that a scene poses.
    pub fn of_scene(model: &ChannelModel, scene: &'a Scene, need: &Need<'a>) -> Self {
        let users = scene.users();
        Self {
            users,
            mirrors: model.mirrors.len(),
            los: scene.los_gain(),
            steering: scene.steering_gain(),
            directions: match model.mode {
                Mode::Specular => None,
                Mode::Paper { .. } => Some(scene.directions()),
            },
            amplitude_scale: model.budget.amplitude_scale(),
            rate_scale_bps: model.budget.bandwidth_hz / users as f64,
            min_rate_bps: need.min_rate_bps,
            qos_penalty: need.qos_penalty,
        }
    }
}

impl Solver {
    /// Solves the problem that a scene poses and writes the angles of the mirrors, mechanical, in radians. Shape of `out`: M.
    ///
    /// Returns the objective in bit/s that the table of gains promises; the angles may give a little more, from spill.
    ///
    /// # Panics
    /// When solver, scene, model and `out` differ in the number of users or mirrors.
    pub fn solve(
        &mut self,
        model: &ChannelModel,
        scene: &Scene,
        need: &Need,
        method: Method,
        out: &mut MirrorAngles,
    ) -> f64 {
        let problem = Problem::of_scene(model, scene, need);
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
