//! One snapshot of the room: every gain of every user, computed in one pass over contiguous arrays.
//!
//! [`Scene::update`] takes the positions of users and blockers and fills the tables; [`Scene::irs_gain`] and its
//! companions then evaluate any angles of the mirrors. Tables of users and mirrors are user-major: index k * M + m. No function allocates after
//! [`Scene::new`].
//!
//! A position from which no light can arrive (behind the mirror wall, at or above the LED, not a number) has gain zero; it is no error here.

mod aimed;
mod evaluate;
pub(crate) mod kernel;
mod legs;
mod reach;
mod steer;
mod update;

use crate::Vec3;
use crate::model::ChannelModel;
use crate::receiver::Combining;

/// One snapshot: K users, M mirrors. Buffers are reused.
#[derive(Clone, Debug)]
pub struct Scene {
    users: usize,
    mirrors: usize,
    branches: usize,
    /// [`Combining::Best`] for a single branch, where there is nothing to combine.
    combining: Combining,
    positions: Vec<Vec3>,
    /// Index of the LED that serves each user. Shape: K.
    serving: Vec<usize>,
    /// Combined gain of the direct path, zero when blocked. Shape: K.
    los_gain: Vec<f64>,
    los_blocked: Vec<bool>,
    /// Gain of each branch, zero when blocked. Shape: K * B.
    los_branch: Vec<f64>,
    /// The same with nothing in the way. Shape: K * B.
    los_clear: Vec<f64>,
    /// Whether the path from an LED to a mirror is clear. Shape: L * M.
    led_leg: Vec<bool>,
    /// Whether both legs are clear. Shape: K * M.
    leg_visible: Vec<bool>,
    /// Shape: K * M.
    steering_gain: Vec<f64>,
    /// Paper mode with several branches: coefficient of each branch. Shape: K * B * M, else empty.
    steering_branch: Vec<f64>,
    /// Paper mode: unit vectors from mirror to user. Shape: K * M, else empty.
    directions: Vec<Vec3>,
    /// Paper mode: 1 / D2 in 1/m. Shape: K * M, else empty.
    inverse_distance: Vec<f64>,
}

impl Scene {
    /// An empty scene for this many users: every gain zero until the first [`Scene::update`].
    pub fn new(model: &ChannelModel, users: usize) -> Self {
        let (mirrors, branches) = (model.mirrors.len(), model.receiver.branches.len());
        let paper = model.mode.reading().is_some();
        let paper_pairs = if paper { users * mirrors } else { 0 };
        Self {
            users,
            mirrors,
            branches,
            combining: if branches == 1 { Combining::Best } else { model.receiver.combining },
            positions: vec![Vec3::zeros(); users],
            serving: vec![0; users],
            los_gain: vec![0.0; users],
            los_blocked: vec![false; users],
            los_branch: vec![0.0; users * branches],
            los_clear: vec![0.0; users * branches],
            led_leg: vec![true; model.leds.len() * mirrors],
            leg_visible: vec![false; users * mirrors],
            steering_gain: vec![0.0; users * mirrors],
            steering_branch: vec![0.0; if branches > 1 { paper_pairs * branches } else { 0 }],
            directions: vec![Vec3::zeros(); paper_pairs],
            inverse_distance: vec![0.0; paper_pairs],
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
    /// The LED with the largest direct gain; where every direct path is blocked, the one whose light the array can bring most of.
    pub fn serving(&self) -> &[usize] {
        &self.serving
    }

    /// Gain of each user's direct path, combined over the branches; zero when blocked. Dimensionless. Shape: K.
    pub fn los_gain(&self) -> &[f64] {
        &self.los_gain
    }

    /// Whether each user's direct path to the serving LED is off, by force or by a cylinder. Shape: K.
    pub fn los_blocked(&self) -> &[bool] {
        &self.los_blocked
    }

    /// Replaces the direct gains by measured ones, until the next update. Dimensionless. Shape: K.
    ///
    /// With several branches the measured gain is shared among them as the clear direct path would be, and equally where
    /// that path is outside every field of view.
    ///
    /// # Panics
    /// When there is not one gain a user.
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

    /// Takes mirrors out of what can be decided, as if their legs were blocked, until the next update. An index beyond the array
    /// changes nothing.
    pub fn leave_out(&mut self, mirrors: &[u32]) {
        for mirror in mirrors.iter().map(|mirror| *mirror as usize).filter(|mirror| *mirror < self.mirrors) {
            for user in 0..self.users {
                let pair = user * self.mirrors + mirror;
                self.leg_visible[pair] = false;
                self.steering_gain[pair] = 0.0;
            }
            for gain in self.steering_branch.iter_mut().skip(mirror).step_by(self.mirrors) {
                *gain = 0.0;
            }
        }
    }

    /// Whether both legs over each mirror, LED to mirror and mirror to user, are clear; false behind the mirror wall. Shape: K * M.
    pub fn leg_visible(&self) -> &[bool] {
        &self.leg_visible
    }

    /// What each mirror can give each user. Dimensionless. Shape: K * M.
    ///
    /// Specular: the gain of mirror m to user k when it is aimed at k. Paper: the coefficient c_km of max(0, n_m . u_km).
    /// Zero where a leg is blocked or the light arrives outside the field of view. Combined over the branches.
    pub fn steering_gain(&self) -> &[f64] {
        &self.steering_gain
    }

    /// Paper mode: unit vectors u_km from mirror to user. Shape: K * M; empty in specular mode.
    pub fn directions(&self) -> &[Vec3] {
        &self.directions
    }
}
