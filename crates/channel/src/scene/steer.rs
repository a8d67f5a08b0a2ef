//! The table of steering gains: the gain of each mirror for each user when it is aimed at that
//! user.

use super::Scene;
use super::aimed::Aimed;
use super::kernel::add_reflected;
use crate::arrays::{MirrorArrays, Surfaces};
use crate::diffuse::Reading;
use crate::geometry::Vec3;
use crate::model::{ChannelModel, Detector, Panel};
use crate::receiver::BRANCHES_MAX;
use crate::specular::{Plate, bisector};
use crate::trig::{BLOCK, Lanes};

/// Vectors from one detector to a block of mirrors, in m.
struct ToMirrors {
    x: Lanes,
    y: Lanes,
    z: Lanes,
    squared: Lanes,
    distance: Lanes,
}

impl Scene {
    /// Writes the steering gains of one user for one LED; mirrors with a blocked path get zero.
    #[inline(always)]
    pub(super) fn steer(&mut self, model: &ChannelModel, user: usize, led: usize) {
        let row = user * self.mirrors..(user + 1) * self.mirrors;
        self.path_weight[row.clone()].fill(1.0);
        for (array, mirrors) in model.mirrors.ranges() {
            let in_front = (self.positions[user] - array.positions()[0]).dot(&array.inward()) > 0.0;
            let pairs = row.start + mirrors.start..row.start + mirrors.end;
            self.can_aim[pairs.clone()].fill(in_front);
            if !in_front {
                self.irs_path_clear[pairs].fill(false);
            }
        }
        let panel = &model.panels[led];
        match model.mode.reading() {
            None if panel.points.len() == 1 => self.steer_point(model, user, panel),
            None => self.steer_panel(model, user, panel),
            Some(reading) => self.steer_paper(model, user, panel, reading),
        }
        for (gain, visible) in self.steering_gain[row.clone()].iter_mut().zip(&self.irs_path_clear[row]) {
            *gain = if *visible { *gain } else { 0.0 };
        }
    }

    /// Specular, point LED: the ray of an aimed mirror always reaches the user, so the gain does
    /// not depend on the angles.
    ///
    /// rho (n + 1) A_r T_s cos^n(irradiance_angle) / (2 pi (D1 + D2)^2) times the combined
    /// incidence cosines.
    #[inline(always)]
    fn steer_point(&mut self, model: &ChannelModel, user: usize, panel: &Panel) {
        let position = self.positions[user];
        let branches = &self.detectors[user * self.branches..(user + 1) * self.branches];
        let row = &mut self.steering_gain[user * self.mirrors..(user + 1) * self.mirrors];
        for (index, out) in row.chunks_mut(BLOCK).enumerate() {
            let to_mirrors = ToMirrors::new(&model.mirrors, index, &position);
            let mut combined = [0.0; BLOCK];
            for branch in branches {
                let facing = to_mirrors.facing(branch).map(|facing| branch.concentrator_gain * facing);
                self.combining.add_each(&mut combined, &facing);
            }
            self.combining.finish_each(&mut combined, self.branches);
            let (to_led, emitted) = (&panel.distance[index], &panel.towards_mirror[index]);
            let mut gains = [0.0; BLOCK];
            for lane in 0..BLOCK {
                let length = to_led[lane] + to_mirrors.distance[lane];
                gains[lane] = combined[lane] * emitted[lane] / (to_mirrors.distance[lane] * length * length);
            }
            out.copy_from_slice(&gains[..out.len()]);
        }
    }

    /// Specular, panel of finite size: block by block for mirrors that reflect the complete panel,
    /// else exactly one by one.
    #[inline(always)]
    fn steer_panel(&mut self, model: &ChannelModel, user: usize, panel: &Panel) {
        let position = self.positions[user];
        let few = panel.order == 1.0 && !panel.few_lanes.is_empty();
        for first in (0..self.mirrors).step_by(BLOCK) {
            let (mut complete, mut dark, mut combined) = ([false; BLOCK], [false; BLOCK], [0.0; BLOCK]);
            if few {
                let mut aimed = Aimed::new(model, panel, first, &position);
                for branch in self.held(user).branches {
                    self.combining.add_each(&mut combined, &aimed.gains(panel, branch));
                }
                self.combining.finish_each(&mut combined, self.branches);
                (complete, dark) = (aimed.complete, aimed.dark);
            }
            for lane in 0..BLOCK.min(self.mirrors - first) {
                let pair = user * self.mirrors + first + lane;
                self.steering_gain[pair] = if complete[lane] {
                    combined[lane]
                } else if !dark[lane] && self.irs_path_clear[pair] && panel.towards_mirror[first / BLOCK][lane] > 0.0 {
                    self.aimed_exactly(model, panel, first + lane, user)
                } else {
                    0.0
                };
            }
        }
    }

    /// Combined gain of one mirror that is aimed at a user, by the exact evaluation.
    #[inline(always)]
    fn aimed_exactly(&self, model: &ChannelModel, panel: &Panel, mirror: usize, user: usize) -> f64 {
        let mut gains = [0.0; BRANCHES_MAX];
        let gains = &mut gains[..self.branches];
        if let Some(normal) = bisector(&model.mirrors.positions()[mirror], &panel.centre, &self.positions[user]) {
            let plate = Plate::facing(&model.mirrors, mirror, &normal);
            add_reflected(model.mirrors.reflectivity(mirror), panel, &plate, self.held(user), gains);
        }
        self.combining.combine(gains)
    }

    /// Paper: illumination times collection, see [`diffuse`](crate::diffuse); stores directions and
    /// distances for the evaluation.
    #[inline(always)]
    fn steer_paper(&mut self, model: &ChannelModel, user: usize, panel: &Panel, reading: Reading) {
        let position = self.positions[user];
        let factor = model.receiver.detector_area_m2 * model.receiver.filter_gain;
        for first in (0..self.mirrors).step_by(BLOCK) {
            let to_mirrors = ToMirrors::new(&model.mirrors, first / BLOCK, &position);
            let illumination = &panel.towards_mirror[first / BLOCK];
            let lanes = BLOCK.min(self.mirrors - first);
            let mut combined = [0.0; BLOCK];
            for index in 0..self.branches {
                let branch = self.detectors[user * self.branches + index];
                let facing = match reading {
                    Reading::Sensible => to_mirrors.facing(&branch),
                    Reading::Literal => to_mirrors.against(model.mirrors.surfaces(first / BLOCK)),
                };
                let mut gains = [0.0; BLOCK];
                for lane in 0..BLOCK {
                    let volume = to_mirrors.squared[lane] * to_mirrors.distance[lane];
                    gains[lane] = factor * branch.concentrator_gain * illumination[lane] * facing[lane] / volume;
                }
                self.combining.add_each(&mut combined, &gains);
                if self.branches > 1 {
                    let start = (user * self.branches + index) * self.mirrors + first;
                    let visible = &self.irs_path_clear[user * self.mirrors + first..][..lanes];
                    for (lane, visible) in visible.iter().enumerate() {
                        self.steering_branch[start + lane] = if *visible { gains[lane] } else { 0.0 };
                    }
                }
            }
            self.combining.finish_each(&mut combined, self.branches);
            for (lane, combined) in combined[..lanes].iter().enumerate() {
                let pair = user * self.mirrors + first + lane;
                self.steering_gain[pair] = *combined;
                let inverse = 1.0 / to_mirrors.distance[lane];
                self.inverse_distance[pair] = inverse;
                self.directions[pair] =
                    -inverse * Vec3::new(to_mirrors.x[lane], to_mirrors.y[lane], to_mirrors.z[lane]);
            }
        }
    }
}

impl ToMirrors {
    #[inline(always)]
    fn new(mirrors: &MirrorArrays, block: usize, detector: &Vec3) -> Self {
        let [x, y, z] = mirrors.block(block).map(|lanes| *lanes);
        let mut to_mirrors = Self { x, y, z, squared: [0.0; BLOCK], distance: [0.0; BLOCK] };
        for lane in 0..BLOCK {
            to_mirrors.x[lane] -= detector.x;
            to_mirrors.y[lane] -= detector.y;
            to_mirrors.z[lane] -= detector.z;
            to_mirrors.squared[lane] = to_mirrors.x[lane] * to_mirrors.x[lane]
                + to_mirrors.y[lane] * to_mirrors.y[lane]
                + to_mirrors.z[lane] * to_mirrors.z[lane];
            to_mirrors.distance[lane] = to_mirrors.squared[lane].sqrt();
        }
        to_mirrors
    }

    /// Distance times incidence cosine on a branch in m, zero outside its field of view.
    #[inline(always)]
    #[expect(clippy::needless_range_loop, reason = "one index into several arrays is what the compiler vectorises")]
    fn facing(&self, branch: &Detector) -> Lanes {
        let least = branch.fov_cosine * branch.fov_cosine;
        let mut facing = [0.0; BLOCK];
        for lane in 0..BLOCK {
            let along =
                branch.normal.x * self.x[lane] + branch.normal.y * self.y[lane] + branch.normal.z * self.z[lane];
            let detected = (along > 0.0) & (along * along >= least * self.squared[lane]);
            facing[lane] = if detected { along } else { 0.0 };
        }
        facing
    }

    /// Distance times cosine from the wall's normal in m, zero behind the wall.
    #[inline(always)]
    #[expect(clippy::needless_range_loop, reason = "one index into several arrays is what the compiler vectorises")]
    fn against(&self, surfaces: &Surfaces) -> Lanes {
        let mut facing = [0.0; BLOCK];
        for lane in 0..BLOCK {
            // The inward normal of a wall is (sin, -cos, 0).
            let along = surfaces.wall_sin[lane] * self.x[lane] - surfaces.wall_cos[lane] * self.y[lane];
            facing[lane] = (-along).max(0.0);
        }
        facing
    }
}
