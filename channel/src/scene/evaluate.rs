//! What the users receive at given angles of the mirrors.

use super::Scene;
use crate::diffuse::tilt_counts;
use crate::mirrors::MirrorAngles;
use crate::model::ChannelModel;
use crate::receiver::BRANCHES_MAX;
use crate::specular::{Plate, detected, received};

impl Scene {
    /// Gain that each user receives over all mirrors at these angles. Dimensionless. `out`: shape K.
    ///
    /// The true evaluation: light that falls on a user whom the mirror was not meant for counts, the panel is averaged over its points,
    /// blocked legs bring nothing. With several branches this is the combined gain of the reflected light alone.
    ///
    /// # Panics
    /// When `angles` has not one entry a mirror or `out` not one a user.
    pub fn irs_gain(&self, model: &ChannelModel, angles: &MirrorAngles, out: &mut [f64]) {
        self.evaluate(model, angles, out, |_, reflected| self.combining.combine(reflected));
    }

    /// SINR of each user at these angles, linear: direct and reflected light together, branches combined. `out`: shape K.
    ///
    /// # Panics
    /// As [`Scene::irs_gain`].
    pub fn sinr(&self, model: &ChannelModel, angles: &MirrorAngles, out: &mut [f64]) {
        self.evaluate(model, angles, out, |user, gains| {
            let direct = &self.los_branch[user * self.branches..(user + 1) * self.branches];
            gains.iter_mut().zip(direct).for_each(|(gain, direct)| *gain += direct);
            model.budget.sinr(self.combining.combine(gains))
        });
    }

    /// Rate of each user at these angles in bit/s. `out`: shape K.
    ///
    /// # Panics
    /// As [`Scene::irs_gain`].
    pub fn rates_bps(&self, model: &ChannelModel, angles: &MirrorAngles, out: &mut [f64]) {
        self.sinr(model, angles, out);
        out.iter_mut().for_each(|value| *value = model.budget.rate_bps(*value, self.users));
    }

    /// Gain over each mirror at these angles. Dimensionless. `out`: shape K * M.
    ///
    /// # Panics
    /// When `angles` has not one entry a mirror or `out` not one a pair.
    pub fn irs_gain_each(&self, model: &ChannelModel, angles: &MirrorAngles, out: &mut [f64]) {
        assert_eq!(out.len(), self.users * self.mirrors, "one gain a pair");
        for (pair, out) in out.iter_mut().enumerate() {
            let mut gains = [0.0; BRANCHES_MAX];
            self.pair(model, angles, (pair / self.mirrors, pair % self.mirrors), &mut gains[..self.branches]);
            *out = self.combining.combine(&gains[..self.branches]);
        }
    }

    fn evaluate(
        &self,
        model: &ChannelModel,
        angles: &MirrorAngles,
        out: &mut [f64],
        finish: impl Fn(usize, &mut [f64]) -> f64,
    ) {
        assert_eq!(out.len(), self.users, "one value a user");
        for (user, out) in out.iter_mut().enumerate() {
            let mut gains = [0.0; BRANCHES_MAX];
            for mirror in 0..self.mirrors {
                self.pair(model, angles, (user, mirror), &mut gains[..self.branches]);
            }
            *out = finish(user, &mut gains[..self.branches]);
        }
    }

    fn pair(&self, model: &ChannelModel, angles: &MirrorAngles, (user, mirror): (usize, usize), gains: &mut [f64]) {
        if !self.leg_visible[user * self.mirrors + mirror] {
            return;
        }
        if let Some(reading) = model.mode.reading() {
            let pair = user * self.mirrors + mirror;
            let normal = model.mirrors.normal(angles.roll[mirror], angles.yaw[mirror]);
            let tilt = normal.dot(&self.directions[pair]);
            for (index, (gain, branch)) in gains.iter_mut().zip(&model.receiver.branches).enumerate() {
                let coefficient = if self.branches == 1 {
                    self.steering_gain[pair]
                } else {
                    self.steering_branch[(user * self.branches + index) * self.mirrors + mirror]
                };
                if tilt_counts(reading, tilt, branch) {
                    *gain += coefficient * tilt;
                }
            }
            return;
        }
        let panel = &model.panels[self.serving[user]];
        let plate = Plate::of(&model.mirrors, mirror, angles.roll[mirror], angles.yaw[mirror]);
        let front = model.mirrors.spec().reflectivity * panel.front;
        for point in &panel.points {
            if let Some(path) = plate.path(point, &self.positions[user]) {
                let share = front * received(&path, panel.order);
                for ((gain, branch), known) in gains.iter_mut().zip(&model.receiver.branches).zip(&model.detectors) {
                    *gain += share * known.concentrator_gain * detected(&path.towards_mirror, branch);
                }
            }
        }
    }
}
