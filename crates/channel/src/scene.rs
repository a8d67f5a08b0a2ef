//! One snapshot of the room: the gains of all users, computed in one pass over contiguous arrays.
//!
//! [`Scene::update`] computes tables from the positions of users and blockers. [`Scene::irs_gain`],
//! [`Scene::sinr`] and [`Scene::rates_bps`] then evaluate any angles of the mirrors. Tables over
//! users and mirrors are user-major: index k * M + m. No function allocates after [`Scene::new`].
//! [`Spill`] has the gains of users near the one at whom a mirror is aimed.
//!
//! A position that no light can reach (behind the mirror wall, at or above the LED, not a number)
//! has gain zero and is not an error. [`decode`](crate::decode) has an example.

mod aimed;
mod evaluate;
mod kernel;
mod reach;
mod reflected;
mod spill;
mod steer;
mod update;
mod visibility;

use self::kernel::Held;
use crate::geometry::Vec3;
use crate::model::{ChannelModel, Detector};
use crate::receiver::Combining;

pub use spill::{MIDPOINTS_MAX, SPILL_USERS_MAX, Spill, SpilledGain};

/// Gains of K users and M mirrors at one moment; the buffers are reused.
#[derive(Clone, Debug)]
pub struct Scene {
    users: usize,
    mirrors: usize,
    branches: usize,
    /// Whether the model is one of the paper's, which needs more tables.
    paper: bool,
    /// [`Combining::Best`] for a single branch, since all rules are then equal.
    combining: Combining,
    positions: Vec<Vec3>,
    /// The branches of each user's receiver, as the user holds it. Shape: K * B.
    detectors: Vec<Detector>,
    /// Index of the LED that serves each user. Shape: K.
    serving: Vec<usize>,
    /// Combined line-of-sight gain, zero when blocked. Shape: K.
    los_gain: Vec<f64>,
    los_blocked: Vec<bool>,
    /// Line-of-sight gain of each branch, zero when blocked. Shape: K * B.
    los_branch: Vec<f64>,
    /// The same without blockage. Shape: K * B.
    los_clear: Vec<f64>,
    /// Whether the path from an LED to a mirror is clear. Shape: L * M.
    led_path_clear: Vec<bool>,
    /// Whether the paths LED-mirror and mirror-user are both clear. Shape: K * M.
    irs_path_clear: Vec<bool>,
    /// See [`Scene::steering_gain`]. Shape: K * M.
    steering_gain: Vec<f64>,
    /// Factors of [`Scene::weigh_columns`] on the gains of each path. Shape: K * M.
    path_weight: Vec<f64>,
    /// Whether each mirror can be aimed at each user within its range, even where the path is
    /// blocked. Shape: K * M.
    can_aim: Vec<bool>,
    /// Paper mode with several branches: coefficient of each branch. Shape: K * B * M, else empty.
    steering_branch: Vec<f64>,
    /// Paper mode: unit vectors from mirror to user. Shape: K * M, else empty.
    directions: Vec<Vec3>,
    /// Paper mode: 1 / D2 in 1/m. Shape: K * M, else empty.
    inverse_distance: Vec<f64>,
}

impl Scene {
    /// A scene for this many users; every gain is zero until the first [`Scene::update`].
    pub fn new(model: &ChannelModel, users: usize) -> Self {
        let (mirrors, branches) = (model.mirrors.len(), model.receiver.branches.len());
        let paper = model.mode.reading().is_some();
        let paper_pairs = if paper { users * mirrors } else { 0 };
        Self {
            users,
            mirrors,
            branches,
            paper,
            combining: if branches == 1 { Combining::Best } else { model.receiver.combining },
            positions: vec![Vec3::zeros(); users],
            detectors: model.detectors.repeat(users),
            serving: vec![0; users],
            los_gain: vec![0.0; users],
            los_blocked: vec![false; users],
            los_branch: vec![0.0; users * branches],
            los_clear: vec![0.0; users * branches],
            led_path_clear: vec![true; model.leds.len() * mirrors],
            irs_path_clear: vec![false; users * mirrors],
            steering_gain: vec![0.0; users * mirrors],
            path_weight: vec![1.0; users * mirrors],
            can_aim: vec![false; users * mirrors],
            steering_branch: vec![0.0; if branches > 1 { paper_pairs * branches } else { 0 }],
            directions: vec![Vec3::zeros(); paper_pairs],
            inverse_distance: vec![0.0; paper_pairs],
        }
    }

    /// Changes the number of users; gains are undefined until the next [`Scene::update`].
    ///
    /// Allocates only beyond the largest number of users so far.
    pub fn resize(&mut self, users: usize) {
        let (pairs, branches) = (users * self.mirrors, users * self.branches);
        let paper_pairs = if self.paper { pairs } else { 0 };
        self.users = users;
        self.positions.resize(users, Vec3::zeros());
        self.serving.resize(users, 0);
        self.los_gain.resize(users, 0.0);
        self.los_blocked.resize(users, false);
        self.detectors.resize(branches, Detector::default());
        self.los_branch.resize(branches, 0.0);
        self.los_clear.resize(branches, 0.0);
        self.irs_path_clear.resize(pairs, false);
        self.steering_gain.resize(pairs, 0.0);
        self.path_weight.resize(pairs, 1.0);
        self.can_aim.resize(pairs, false);
        self.steering_branch.resize(if self.branches > 1 { paper_pairs * self.branches } else { 0 }, 0.0);
        self.directions.resize(paper_pairs, Vec3::zeros());
        self.inverse_distance.resize(paper_pairs, 0.0);
    }

    /// The receiver of one user.
    #[inline(always)]
    fn held(&self, user: usize) -> Held<'_> {
        Held {
            position: &self.positions[user],
            branches: &self.detectors[user * self.branches..(user + 1) * self.branches],
        }
    }

    /// Number of users K.
    pub fn users(&self) -> usize {
        self.users
    }

    /// Number of mirrors M.
    pub fn mirrors(&self) -> usize {
        self.mirrors
    }

    /// Position of each user's receiver in m. Shape: K.
    pub fn positions(&self) -> &[Vec3] {
        &self.positions
    }

    /// Index of the LED that serves each user. Shape: K.
    ///
    /// This is the LED with the largest unblocked line-of-sight gain. If every line-of-sight path
    /// is blocked, it is the LED with the largest sum of steering gains.
    pub fn serving(&self) -> &[usize] {
        &self.serving
    }

    /// Line-of-sight gain of each user, combined over the branches; zero when blocked. Shape: K.
    /// Units: dimensionless.
    pub fn los_gain(&self) -> &[f64] {
        &self.los_gain
    }

    /// The same gain at each branch, before the branches are combined. Shape: K * B.
    pub fn los_branch_gain(&self) -> &[f64] {
        &self.los_branch
    }

    /// Whether the line-of-sight path from the serving LED to each user is blocked, by a cylinder
    /// or by force. Shape: K.
    pub fn los_blocked(&self) -> &[bool] {
        &self.los_blocked
    }

    /// Replaces the steering gains until the next update. Shape: K M, user by user. Units:
    /// dimensionless.
    ///
    /// # Panics
    /// When `gains` has another length.
    pub fn set_steering_gain(&mut self, gains: &[f64]) {
        self.steering_gain.copy_from_slice(gains);
    }

    /// Replaces the line-of-sight gains by measured ones until the next update. Shape: K. Units:
    /// dimensionless.
    ///
    /// A measured gain is divided among several branches in proportion to the unblocked
    /// line-of-sight gains. It is divided equally if the LED is outside every field of view.
    ///
    /// # Panics
    /// When `gains` does not have one entry per user.
    pub fn set_los_gain(&mut self, gains: &[f64]) {
        self.los_gain.copy_from_slice(gains);
        for (user, gain) in gains.iter().enumerate() {
            let range = user * self.branches..(user + 1) * self.branches;
            let branch = &mut self.los_branch[range.clone()];
            branch.copy_from_slice(&self.los_clear[range]);
            if self.combining.combine(branch) == 0.0 {
                branch.fill(1.0);
            }
            let share = gain / self.combining.combine(branch);
            branch.iter_mut().for_each(|value| *value *= share);
        }
    }

    /// Replaces the blockage of one user's line-of-sight path by an observed one until the next
    /// update; a clear path has its modelled gain.
    ///
    /// # Panics
    /// When there is no such user.
    pub fn set_los_blocked(&mut self, user: usize, blocked: bool) {
        let range = user * self.branches..(user + 1) * self.branches;
        let branch = &mut self.los_branch[range.clone()];
        if blocked {
            branch.fill(0.0);
        } else {
            branch.copy_from_slice(&self.los_clear[range]);
        }
        self.los_gain[user] = self.combining.combine(branch);
        self.los_blocked[user] = blocked;
    }

    /// Sets the steering gains of these mirrors to zero until the next update, as if their paths
    /// were blocked.
    ///
    /// An index beyond the last mirror has no effect.
    pub fn exclude_mirrors(&mut self, mirrors: &[u32]) {
        self.exclude(mirrors.iter().map(|mirror| *mirror as usize));
    }

    /// The same for any list of indices, for example those of an array.
    pub fn exclude(&mut self, mirrors: impl Iterator<Item = usize>) {
        let count = self.mirrors;
        for mirror in mirrors.filter(|mirror| *mirror < count) {
            for user in 0..self.users {
                let pair = user * self.mirrors + mirror;
                self.irs_path_clear[pair] = false;
                self.steering_gain[pair] = 0.0;
                self.can_aim[pair] = false;
            }
            for gain in self.steering_branch.iter_mut().skip(mirror).step_by(self.mirrors) {
                *gain = 0.0;
            }
        }
    }

    /// Multiplies a user's steering gains, and its gains in [`Spill`], by a factor for each column of
    /// mirrors until the next update: the probability that the path is clear. Shape: columns of all
    /// arrays, array after array.
    ///
    /// # Panics
    /// When `factors` does not have one entry per column of the model's arrays.
    pub fn weigh_columns(&mut self, model: &ChannelModel, user: usize, factors: &[f64]) {
        assert_eq!(model.mirrors.columns(), factors.len(), "one factor per column");
        let weigh = |gains: &mut [f64]| {
            for ((_, mirrors), (_, columns)) in model.mirrors.ranges().zip(model.mirrors.column_ranges()) {
                for row in gains[mirrors].chunks_exact_mut(columns.len()) {
                    row.iter_mut().zip(&factors[columns.clone()]).for_each(|(gain, factor)| *gain *= factor);
                }
            }
        };
        weigh(&mut self.steering_gain[user * self.mirrors..][..self.mirrors]);
        weigh(&mut self.path_weight[user * self.mirrors..][..self.mirrors]);
        if !self.steering_branch.is_empty() {
            let branches = self.branches * self.mirrors;
            self.steering_branch[user * branches..][..branches].chunks_exact_mut(self.mirrors).for_each(weigh);
        }
    }

    /// Whether the paths LED-mirror and mirror-user are both clear; false for a user behind the
    /// wall of the mirror. Shape: K * M.
    pub fn irs_path_clear(&self) -> &[bool] {
        &self.irs_path_clear
    }

    /// Steering gain of each user and mirror, combined over the branches. Shape: K * M. Units:
    /// dimensionless.
    ///
    /// Specular: the gain of mirror m for user k when the mirror is aimed at the user. Paper: the
    /// coefficient c_km of max(0, n_m . u_km). Zero where a path is blocked or the light arrives
    /// outside the field of view.
    pub fn steering_gain(&self) -> &[f64] {
        &self.steering_gain
    }

    /// Unit vectors u_km from mirror to user in paper mode. Shape: K * M; empty in specular mode.
    pub fn directions(&self) -> &[Vec3] {
        &self.directions
    }
}
