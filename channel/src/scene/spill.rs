//! Light of aimed mirrors that reaches other users than the one at whom the mirror is aimed.
//!
//! A mirror that is aimed at one user illuminates a spot. Every user within the spot receives its
//! light. [`Spill`] lists these gains for all pairs of user and mirror. The gains are those of
//! [`Scene::irs_gain_each`] at the angles of [`aim`](crate::decode::aim), to the last bit.
//!
//! A bound of the spot's size excludes most pairs of users, so that a room without close users
//! costs one comparison per pair. The equations of the paper have no spots: the list is then empty.

use super::Scene;
use super::kernel::{Turned, add_reflected};
use crate::aiming::bisect;
use crate::geometry::Vec3;
use crate::model::ChannelModel;
use crate::receiver::BRANCHES_MAX;
use crate::simd::with_widest_simd;
use crate::trig::{BLOCK, Lanes};

/// Largest number of other users per aim; with more, those with the largest gains count.
pub const SPILL_USERS_MAX: usize = 16;

/// Gain of one user over a mirror that is aimed at another user.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpilledGain {
    /// Index of the user that receives the light.
    pub user: usize,
    /// Combined over the branches; above 0, dimensionless.
    pub gain: f64,
}

/// The gains of other users than the one at whom a mirror is aimed; the buffers are reused.
///
/// Pairs of user and mirror without a steering gain have none: see [`Scene::steering_gain`].
#[derive(Clone, Debug, Default)]
pub struct Spill {
    mirrors: usize,
    gains: Vec<SpilledGain>,
    /// Index in `gains` of the first entry of each pair, and their number. Shape: K * M + 1, index
    /// k * M + m; empty where `gains` is.
    starts: Vec<usize>,
    extents: Vec<Extent>,
    /// Users that may be within a spot around the present user.
    near: Vec<usize>,
    /// For each of them, a number per mirror that is negative if no light can reach the user.
    slack: Vec<Lanes>,
}

/// Bounds of the paths between one user and all mirrors.
#[derive(Clone, Copy, Debug)]
struct Extent {
    /// Smallest inclination of a path, as the sine of the angle with a horizontal plane.
    least_inclination: f64,
    /// Largest distance of a lit point from the axis of a beam, at the distance of the user, in m.
    beam_radius_m: f64,
}

impl Spill {
    /// An empty list; allocates memory for this many users and mirrors.
    pub fn new(users: usize, mirrors: usize) -> Self {
        Self {
            mirrors,
            gains: Vec::with_capacity(Self::len_max(users, mirrors)),
            starts: Vec::with_capacity(users * mirrors + 1),
            extents: Vec::with_capacity(users),
            near: Vec::with_capacity(users),
            slack: Vec::with_capacity(users),
        }
    }

    /// Largest number of gains for this many users and mirrors.
    pub(crate) fn len_max(users: usize, mirrors: usize) -> usize {
        users.saturating_sub(1).min(SPILL_USERS_MAX) * users * mirrors
    }

    /// Computes the gains for the users of a scene.
    ///
    /// Does not allocate up to the number of users of [`Spill::new`].
    pub fn update(&mut self, model: &ChannelModel, scene: &Scene) {
        self.mirrors = scene.mirrors;
        self.gains.clear();
        self.starts.clear();
        if scene.paper {
            return;
        }
        self.extents.clear();
        self.extents.extend((0..scene.users).map(|user| Extent::of(model, scene, user)));
        for user in 0..scene.users {
            let (extents, near) = (&self.extents, &mut self.near);
            near.clear();
            near.extend((0..scene.users).filter(|other| may_share(scene, extents, user, *other)));
            if near.is_empty() {
                self.starts.extend(std::iter::repeat_n(self.gains.len(), self.mirrors));
            } else {
                with_widest_simd(
                    #[inline(always)]
                    || self.around(model, scene, user),
                );
            }
        }
        self.starts.push(self.gains.len());
        if self.gains.is_empty() {
            self.starts.clear();
        }
    }

    /// Whether no aimed mirror reaches a second user.
    pub fn is_empty(&self) -> bool {
        self.gains.is_empty()
    }

    /// The other users' gains over a mirror that is aimed at `user`, in the order of their indices.
    pub fn of(&self, user: usize, mirror: usize) -> &[SpilledGain] {
        let pair = user * self.mirrors + mirror;
        match self.starts.get(pair..pair + 2) {
            Some(bounds) => &self.gains[bounds[0]..bounds[1]],
            None => &[],
        }
    }

    /// Appends the gains of the users in `near` over each mirror that is aimed at `user`.
    #[inline(always)]
    fn around(&mut self, model: &ChannelModel, scene: &Scene, user: usize) {
        let position = scene.positions[user];
        let target = [0, 1, 2].map(|axis| [position[axis]; BLOCK]);
        for (index, first) in (0..self.mirrors).step_by(BLOCK).enumerate() {
            let to_led = model.directions_to_led(scene.serving[user], index);
            let (roll, yaw) = bisect(&model.mirrors, index, to_led, &target);
            let turned = Turned::at(&model.mirrors, &roll, &yaw, index);
            self.slack.clear();
            for other in &self.near {
                let source = turned.source(&model.panels[scene.serving[*other]]);
                self.slack.push(turned.candidates(&source, &scene.positions[*other]));
            }
            let aimed = user * self.mirrors + first;
            for lane in 0..BLOCK.min(self.mirrors - first) {
                let start = self.gains.len();
                self.starts.push(start);
                if scene.steering_gain[aimed + lane] <= 0.0 {
                    continue;
                }
                for (other, slack) in self.near.iter().zip(&self.slack) {
                    if slack[lane] >= 0.0 && scene.irs_path_clear[other * self.mirrors + first + lane] {
                        let mut gains = [0.0; BRANCHES_MAX];
                        let gains = &mut gains[..scene.branches];
                        let panel = &model.panels[scene.serving[*other]];
                        add_reflected(model, panel, &turned.plate(lane), &scene.positions[*other], gains);
                        keep(&mut self.gains, start, *other, scene.combining.combine(gains));
                    }
                }
            }
        }
    }
}

/// Appends a gain to the entries from `start` on; replaces the smallest once they are too many.
#[inline(always)]
fn keep(gains: &mut Vec<SpilledGain>, start: usize, user: usize, gain: f64) {
    if gain <= 0.0 {
        return;
    }
    if gains.len() - start == SPILL_USERS_MAX {
        let smallest = (start..gains.len()).fold(start, |a, b| if gains[b].gain < gains[a].gain { b } else { a });
        if gain <= gains[smallest].gain {
            return;
        }
        gains.remove(smallest);
    }
    gains.push(SpilledGain { user, gain });
}

impl Extent {
    fn of(model: &ChannelModel, scene: &Scene, user: usize) -> Self {
        let position = &scene.positions[user];
        let panel = &model.panels[scene.serving[user]];
        let (mirrors, columns) = (model.mirrors.positions(), model.mirrors.columns());
        let (lowest, highest) = (&mirrors[0], &mirrors[mirrors.len() - 1]);
        // A distance is a convex function of the mirror, so it is largest at a corner.
        let corners = [lowest, highest, &mirrors[columns - 1], &mirrors[mirrors.len() - columns]];
        let farthest = corners.map(|corner| (corner - position).norm()).into_iter().fold(0.0, f64::max);
        let rise = (lowest.z - position.z).max(position.z - highest.z).max(0.0);
        Self {
            least_inclination: rise / farthest,
            beam_radius_m: beam_radius_m(model, panel.nearest_mirror_m, panel.radius, farthest),
        }
    }
}

/// Bound of the distance between a lit point and the axis of the beam of a mirror, in m.
///
/// The axis leads from the image of the panel's centre through the mirror's centre c. A ray from
/// another point of the panel, at most r from its centre, meets the mirror at a point P at most h
/// from c, and continues to R = P + s (P - S'), where S' is the image of the point. The distance of
/// R from the axis is at most h + s (h + r). With the distances D1 from the panel's centre to the
/// mirror and D2 from c to R, s is at most (D2 + h) / (D1 - r - h).
fn beam_radius_m(model: &ChannelModel, nearest_mirror_m: f64, panel_radius_m: f64, farthest_m: f64) -> f64 {
    let spec = model.mirrors.spec();
    let half_diagonal_m = 0.5 * spec.mirror_width_m.hypot(spec.mirror_height_m);
    let before_m = nearest_mirror_m - panel_radius_m - half_diagonal_m;
    if before_m <= 0.0 {
        return f64::INFINITY;
    }
    half_diagonal_m + (farthest_m + half_diagonal_m) / before_m * (half_diagonal_m + panel_radius_m)
}

/// Whether a mirror that is aimed at `user` may illuminate another user, by a bound that never
/// rejects a lit one.
///
/// The axis of the beam passes through `user`, so the distance of the other user from the axis is
/// that of their difference, at least |horizontal part| sin(inclination) - |vertical part|.
/// A user of another LED receives that LED's light over the mirror in another direction, for which
/// the bound does not hold.
fn may_share(scene: &Scene, extents: &[Extent], user: usize, other: usize) -> bool {
    let apart: Vec3 = scene.positions[other] - scene.positions[user];
    let from_axis = apart.x.hypot(apart.y) * extents[user].least_inclination - apart.z.abs();
    user != other && (scene.serving[user] != scene.serving[other] || from_axis <= extents[other].beam_radius_m)
}
