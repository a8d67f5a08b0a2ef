//! Evaluation of gains, SINR and rates at given angles of the mirrors.

use super::Scene;
use super::kernel::{Source, Turned, add_reflected, interleaved_sum, lanes};
use crate::diffuse::{Reading, tilt_least};
use crate::mirrors::MirrorAngles;
use crate::model::ChannelModel;
use crate::receiver::BRANCHES_MAX;
use crate::simd::with_widest_simd;
use crate::specular::Plate;
use crate::trig::{BLOCK, Lanes};
use std::ops::Range;

/// Number of users per pass over the mirrors; a pass computes the normals once for all of them.
const GROUP: usize = 16;

/// Gains of a group of users, branch by branch.
type Gains = [[f64; BRANCHES_MAX]; GROUP];

impl Scene {
    /// Gain of the reflected paths by way of all mirrors at these angles, H_IRS,k = sum_m H_km,
    /// combined over the branches.
    ///
    /// The sum includes light that reaches a user by way of a mirror aimed at another user. The
    /// panel is averaged over its points, and a blocked path has gain zero.
    ///
    /// `angles`: mechanical, in radians. Shape: M. `out`: dimensionless. Shape: K.
    ///
    /// # Panics
    /// When `angles` does not have one entry per mirror, or `out` one per user.
    pub fn irs_gain(&self, model: &ChannelModel, angles: &MirrorAngles, out: &mut [f64]) {
        self.evaluate(model, angles, out, |_, reflected| self.combining.combine(reflected));
    }

    /// The same gain at each branch of each receiver, before the branches are combined.
    ///
    /// `out`: dimensionless. Shape: K * B.
    ///
    /// # Panics
    /// When `angles` does not have one entry per mirror, or `out` one per branch of each user.
    pub fn irs_branch_gain(&self, model: &ChannelModel, angles: &MirrorAngles, out: &mut [f64]) {
        assert_eq!(out.len(), self.users * self.branches, "one value per branch of each user");
        self.each_user(model, angles, |user, gains| {
            out[user * self.branches..][..self.branches].copy_from_slice(gains)
        });
    }

    /// SINR of each user at these angles, from H_LoS + H_IRS of each branch; see
    /// [`LinkBudget::sinr`](crate::LinkBudget::sinr).
    ///
    /// Source: paper eq. (6). `out`: linear, dimensionless. Shape: K.
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

    /// Rate of each user at these angles; see
    /// [`LinkBudget::rate_bps`](crate::LinkBudget::rate_bps).
    ///
    /// Source: paper eq. (7). `out`: in bit/s. Shape: K.
    ///
    /// # Panics
    /// As [`Scene::irs_gain`].
    pub fn rates_bps(&self, model: &ChannelModel, angles: &MirrorAngles, out: &mut [f64]) {
        self.sinr(model, angles, out);
        out.iter_mut().for_each(|value| *value = model.budget.rate_bps(*value, self.users));
    }

    /// Gain of each reflected path at these angles, combined over the branches.
    ///
    /// `out`: dimensionless. Shape: K * M.
    ///
    /// # Panics
    /// When `angles` does not have one entry per mirror, or `out` one per pair of user and mirror.
    pub fn irs_gain_each(&self, model: &ChannelModel, angles: &MirrorAngles, out: &mut [f64]) {
        assert_eq!(out.len(), self.users * self.mirrors, "one gain per pair of user and mirror");
        out.fill(0.0);
        with_widest_simd(
            #[inline(always)]
            || {
                for first in (0..self.mirrors).step_by(BLOCK) {
                    let block = self.turn(model, angles, first, 0);
                    for user in 0..self.users {
                        let row = &mut out[user * self.mirrors + first..][..block.lanes];
                        self.each_of_block(model, &block, user, row);
                    }
                }
            },
        );
    }

    /// The same for one user. Shape of `out`: M.
    ///
    /// # Panics
    /// When `angles` or `out` does not have one entry per mirror, or when there is no such user.
    pub fn irs_gain_each_of(&self, model: &ChannelModel, angles: &MirrorAngles, user: usize, out: &mut [f64]) {
        assert_eq!(out.len(), self.mirrors, "one gain per mirror");
        out.fill(0.0);
        with_widest_simd(
            #[inline(always)]
            || {
                for first in (0..self.mirrors).step_by(BLOCK) {
                    let block = self.turn(model, angles, first, user);
                    self.each_of_block(model, &block, user, &mut out[first..][..block.lanes]);
                }
            },
        );
    }

    /// Calls `finish` with each user's gains per branch and writes the returned values.
    #[inline(always)]
    fn evaluate(
        &self,
        model: &ChannelModel,
        angles: &MirrorAngles,
        out: &mut [f64],
        finish: impl Fn(usize, &mut [f64]) -> f64,
    ) {
        assert_eq!(out.len(), self.users, "one value per user");
        self.each_user(model, angles, |user, gains| out[user] = finish(user, gains));
    }

    /// Calls `finish` with each user and the reflected gains of this user's branches.
    #[inline(always)]
    fn each_user(&self, model: &ChannelModel, angles: &MirrorAngles, mut finish: impl FnMut(usize, &mut [f64])) {
        for first_user in (0..self.users).step_by(GROUP) {
            let mut gains: Gains = [[0.0; BRANCHES_MAX]; GROUP];
            let users = first_user..self.users.min(first_user + GROUP);
            with_widest_simd(
                #[inline(always)]
                || self.gather(model, angles, users.clone(), &mut gains),
            );
            for (user, gains) in users.zip(&mut gains) {
                finish(user, &mut gains[..self.branches]);
            }
        }
    }

    /// Sums the reflected gains of a group of users over all mirrors.
    #[inline(always)]
    fn gather(&self, model: &ChannelModel, angles: &MirrorAngles, users: Range<usize>, gains: &mut Gains) {
        for first in (0..self.mirrors).step_by(BLOCK) {
            let block = self.turn(model, angles, first, users.start);
            for (user, gains) in users.clone().zip(gains.iter_mut()) {
                let gains = &mut gains[..self.branches];
                match model.mode.reading() {
                    None => self.each_hit(
                        model,
                        &block,
                        user,
                        #[inline(always)]
                        |lane, plate| {
                            let panel = &model.panels[self.serving[user]];
                            let reflectivity = model.mirrors.reflectivity(block.first + lane);
                            add_reflected(reflectivity, panel, plate, self.held(user), gains);
                        },
                    ),
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
            return self.each_hit(
                model,
                block,
                user,
                #[inline(always)]
                |lane, plate| {
                    let mut gains = [0.0; BRANCHES_MAX];
                    let gains = &mut gains[..self.branches];
                    let reflectivity = model.mirrors.reflectivity(block.first + lane);
                    add_reflected(reflectivity, &model.panels[self.serving[user]], plate, self.held(user), gains);
                    row[lane] = self.combining.combine(gains);
                },
            );
        };
        for branch in 0..self.branches {
            let diffused = self.diffused(model, block, (user, branch), reading);
            row.iter_mut().zip(diffused).for_each(|(sum, gain)| *sum = self.combining.add(*sum, gain));
        }
        row.iter_mut().for_each(|sum| *sum = self.combining.finish(*sum, self.branches));
    }

    /// Calls `hit` for each visible mirror of a block from which light may reach the user.
    #[inline(always)]
    fn each_hit(&self, model: &ChannelModel, block: &Block, user: usize, mut hit: impl FnMut(usize, &Plate)) {
        let led = self.serving[user];
        let other;
        let source = if led == block.led {
            &block.source
        } else {
            other = block.turned.source(&model.panels[led]);
            &other
        };
        let candidates = block.turned.candidates(source, &self.positions[user]);
        let visible = &self.irs_path_clear[user * self.mirrors + block.first..][..block.lanes];
        for (lane, visible) in visible.iter().enumerate() {
            if candidates[lane] >= 0.0 && *visible {
                hit(lane, &block.turned.plate(lane));
            }
        }
    }

    /// Gains of a block of mirrors by eqs. (2) and (3) on one branch of one user: coefficient times
    /// tilt cosine.
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

    /// Computes normals and axes of the block of mirrors that starts at index `first`, and the LED of
    /// a user relative to them.
    #[inline(always)]
    fn turn<'a>(&self, model: &'a ChannelModel, angles: &MirrorAngles, first: usize, user: usize) -> Block<'a> {
        assert_eq!(angles.roll.len(), self.mirrors, "one roll per mirror");
        assert_eq!(angles.yaw.len(), self.mirrors, "one yaw per mirror");
        let turned = Turned::new(&model.mirrors, angles, first);
        let led = self.serving.get(user).copied().unwrap_or(0);
        let source = turned.source(&model.panels[led]);
        Block { first, lanes: BLOCK.min(self.mirrors - first), turned, led, source }
    }
}

/// A block of mirrors at their angles.
struct Block<'a> {
    /// Index of the first mirror.
    first: usize,
    /// Number of lanes that are mirrors; the other lanes repeat the last mirror.
    lanes: usize,
    turned: Turned<'a>,
    /// The LED of the first user of a pass, which serves the others in many rooms.
    led: usize,
    source: Source,
}
