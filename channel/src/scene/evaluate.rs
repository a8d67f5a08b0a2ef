//! What the users receive at given angles of the mirrors.

use super::Scene;
use super::kernel::{Source, Turned, add_reflected, interleaved_sum, lanes};
use crate::diffuse::{Reading, tilt_least};
use crate::mirrors::MirrorAngles;
use crate::model::ChannelModel;
use crate::receiver::BRANCHES_MAX;
use crate::specular::Plate;
use crate::trig::{BLOCK, Lanes};
use crate::wide::widest;
use std::ops::Range;

/// Users that share one pass over the mirrors: the mirrors are turned once for all of them.
const GROUP: usize = 16;

/// Gains of a group of users, branch by branch.
type Gains = [[f64; BRANCHES_MAX]; GROUP];

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

    /// Gain over each mirror at these angles, combined over the branches. Dimensionless. `out`: shape K * M.
    ///
    /// # Panics
    /// When `angles` has not one entry a mirror or `out` not one a pair.
    pub fn irs_gain_each(&self, model: &ChannelModel, angles: &MirrorAngles, out: &mut [f64]) {
        assert_eq!(out.len(), self.users * self.mirrors, "one gain a pair");
        out.fill(0.0);
        widest(
            #[inline(always)]
            || {
                for first in (0..self.mirrors).step_by(BLOCK) {
                    let block = self.turn(model, angles, first);
                    for user in 0..self.users {
                        let row = &mut out[user * self.mirrors + first..][..block.lanes];
                        self.each_of_block(model, &block, user, row);
                    }
                }
            },
        );
    }

    /// Calls `finish` with each user's gain on each branch and writes what it returns.
    #[inline(always)]
    fn evaluate(
        &self,
        model: &ChannelModel,
        angles: &MirrorAngles,
        out: &mut [f64],
        finish: impl Fn(usize, &mut [f64]) -> f64,
    ) {
        assert_eq!(out.len(), self.users, "one value a user");
        for (index, out) in out.chunks_mut(GROUP).enumerate() {
            let first_user = index * GROUP;
            let mut gains: Gains = [[0.0; BRANCHES_MAX]; GROUP];
            let users = first_user..first_user + out.len();
            widest(
                #[inline(always)]
                || self.gather(model, angles, users, &mut gains),
            );
            for (offset, (out, gains)) in out.iter_mut().zip(&mut gains).enumerate() {
                *out = finish(first_user + offset, &mut gains[..self.branches]);
            }
        }
    }

    /// Sums the reflected light of a group of users over all mirrors.
    #[inline(always)]
    fn gather(&self, model: &ChannelModel, angles: &MirrorAngles, users: Range<usize>, gains: &mut Gains) {
        for first in (0..self.mirrors).step_by(BLOCK) {
            let block = self.turn(model, angles, first);
            for (user, gains) in users.clone().zip(gains.iter_mut()) {
                let gains = &mut gains[..self.branches];
                match model.mode.reading() {
                    None => self.each_hit(model, &block, user, |_, plate| {
                        let panel = &model.panels[self.serving[user]];
                        add_reflected(model, panel, plate, &self.positions[user], gains);
                    }),
                    Some(reading) => {
                        for (branch, gain) in gains.iter_mut().enumerate() {
                            let diffused = self.diffused(model, &block, (user, branch), reading);
                            *gain += interleaved_sum(&diffused[..block.lanes]);
                        }
                    }
                }
            }
        }
    }

    /// Writes one user's combined gain over each mirror of a block.
    #[inline(always)]
    fn each_of_block(&self, model: &ChannelModel, block: &Block, user: usize, row: &mut [f64]) {
        let Some(reading) = model.mode.reading() else {
            return self.each_hit(model, block, user, |lane, plate| {
                let mut gains = [0.0; BRANCHES_MAX];
                let gains = &mut gains[..self.branches];
                add_reflected(model, &model.panels[self.serving[user]], plate, &self.positions[user], gains);
                row[lane] = self.combining.combine(gains);
            });
        };
        for branch in 0..self.branches {
            let diffused = self.diffused(model, block, (user, branch), reading);
            row.iter_mut().zip(diffused).for_each(|(sum, gain)| *sum = self.combining.add(*sum, gain));
        }
        row.iter_mut().for_each(|sum| *sum = self.combining.finish(*sum, self.branches));
    }

    /// Calls `hit` for each visible mirror of a block whose light may reach the user.
    #[inline(always)]
    fn each_hit(&self, model: &ChannelModel, block: &Block, user: usize, mut hit: impl FnMut(usize, &Plate)) {
        let led = self.serving[user];
        let other;
        let source = if led == 0 {
            &block.source
        } else {
            other = block.turned.source(&model.panels[led]);
            &other
        };
        let candidates = block.turned.candidates(source, &self.positions[user]);
        let visible = &self.leg_visible[user * self.mirrors + block.first..][..block.lanes];
        for (lane, visible) in visible.iter().enumerate() {
            if candidates[lane] >= 0.0 && *visible {
                hit(lane, &block.turned.plate(lane));
            }
        }
    }

    /// Gains of a block of mirrors by eqs. (2) and (3) on one branch of one user: coefficient times tilt cosine.
    #[inline(always)]
    fn diffused(&self, model: &ChannelModel, block: &Block, (user, branch): (usize, usize), reading: Reading) -> Lanes {
        let pair = user * self.mirrors + block.first;
        let coefficients = if self.branches == 1 {
            lanes(&self.steering_gain[pair..][..block.lanes])
        } else {
            let start = (user * self.branches + branch) * self.mirrors + block.first;
            lanes(&self.steering_branch[start..][..block.lanes])
        };
        let distances = lanes(&self.inverse_distance[pair..][..block.lanes]);
        let cosines = block.turned.tilt_cosines(&self.positions[user], &distances);
        let least = tilt_least(reading, model.detectors[branch].fov_cosine);
        let mut gains = [0.0; BLOCK];
        for lane in 0..BLOCK {
            let counts = (cosines[lane] > 0.0) & (cosines[lane] >= least);
            gains[lane] = if counts { coefficients[lane] * cosines[lane] } else { 0.0 };
        }
        gains
    }

    /// Turns the block of mirrors that starts at index `first`.
    #[inline(always)]
    fn turn(&self, model: &ChannelModel, angles: &MirrorAngles, first: usize) -> Block {
        assert_eq!(angles.roll.len(), self.mirrors, "one roll a mirror");
        assert_eq!(angles.yaw.len(), self.mirrors, "one yaw a mirror");
        let turned = Turned::new(&model.mirrors, angles, first);
        let source = turned.source(&model.panels[0]);
        Block { first, lanes: BLOCK.min(self.mirrors - first), turned, source }
    }
}

/// Some mirrors at their angles.
struct Block {
    /// Index of the first mirror.
    first: usize,
    /// How many lanes are mirrors; the others repeat the last one.
    lanes: usize,
    turned: Turned,
    /// The first LED, which serves everybody in most rooms.
    source: Source,
}
