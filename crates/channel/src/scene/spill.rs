//! Light of aimed mirrors that reaches several users.
//!
//! A mirror that is aimed at a point illuminates a spot around it, and every user within the spot
//! receives its light. [`Spill`] lists these gains for all pairs of aim and mirror. The aims are the
//! users, and the midpoints between close users. The gains are those of [`Scene::irs_gain_each`] at
//! the angles of [`aim`](crate::decode::aim), to the last bit.
//!
//! A bound of the spot's size excludes most pairs of users, so that a room without close users
//! costs one comparison per pair. The equations of the paper have no spots: the list is then empty.

use super::Scene;
use super::kernel::{Turned, add_reflected};
use super::reflected::Reflected;
use crate::aiming::bisect;
use crate::geometry::Vec3;
use crate::mirrors::MirrorArray;
use crate::model::ChannelModel;
use crate::receiver::BRANCHES_MAX;
use crate::simd::with_widest_simd;
use crate::trig::{BLOCK, Lanes};

/// Largest number of other users per aim; with more, those with the largest gains count.
pub const SPILL_USERS_MAX: usize = 16;

/// Largest number of midpoints; of more pairs of close users, those with the smallest distances
/// count.
pub const MIDPOINTS_MAX: usize = 16;

/// Gain of one user over a mirror that is aimed at another point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpilledGain {
    /// Index of the user that receives the light.
    pub user: usize,
    /// Combined over the branches; above 0, dimensionless.
    pub gain: f64,
}

/// The gains of users at whom a mirror is not aimed; the buffers are reused.
///
/// The first K aims are the users, the others are midpoints between two close users of the same LED.
/// A mirror has no gains at an aim outside its range: see [`Scene::restrict_to_range`]. It has none
/// either where it reaches one user only, with no larger gain than it has when aimed at that user.
#[derive(Clone, Debug, Default)]
pub struct Spill {
    mirrors: usize,
    gains: Vec<SpilledGain>,
    /// Index in `gains` of the first entry of each pair, and the number of gains. Shape: A * M + 1,
    /// index a * M + m; empty where `gains` is.
    starts: Vec<usize>,
    /// The points of the aims. Shape: A.
    points: Vec<Vec3>,
    /// The LED whose light each aim receives. Shape: A.
    leds: Vec<usize>,
    /// The users of each midpoint. Shape: A - K.
    midpoints: Vec<[usize; 2]>,
    /// Shape: A.
    extents: Vec<Extent>,
    /// Pairs of close users, with the square of their distance in m2.
    close: Vec<(f64, [usize; 2])>,
    /// Users that may be within the spot of the present aim.
    near: Vec<usize>,
    /// Those that may be within the spots of the present block of mirrors.
    near_block: Vec<usize>,
    /// For each of those, the gains over a block of mirrors.
    block: Vec<Lanes>,
}

/// Bounds of the paths between one aim and all mirrors.
#[derive(Clone, Copy, Debug)]
struct Extent {
    /// Smallest inclination of a path, as the sine of the angle with a horizontal plane.
    least_inclination: f64,
    /// Largest distance of a lit point from the axis of a beam, at the distance of the aim, in m.
    beam_radius_m: f64,
}

impl Spill {
    /// An empty list; allocates memory for this many users and mirrors.
    pub fn new(users: usize, mirrors: usize) -> Self {
        let aims = users + MIDPOINTS_MAX;
        Self {
            mirrors,
            gains: Vec::with_capacity(Self::len_max(users, mirrors)),
            starts: Vec::with_capacity(aims * mirrors + 1),
            points: Vec::with_capacity(aims),
            leds: Vec::with_capacity(aims),
            midpoints: Vec::with_capacity(MIDPOINTS_MAX),
            extents: Vec::with_capacity(aims),
            close: Vec::with_capacity(users * users.saturating_sub(1) / 2),
            near: Vec::with_capacity(users),
            near_block: Vec::with_capacity(users),
            block: Vec::with_capacity(users),
        }
    }

    /// Largest number of gains for this many users and mirrors.
    pub(crate) fn len_max(users: usize, mirrors: usize) -> usize {
        let others = users.saturating_sub(1).min(SPILL_USERS_MAX);
        (others * users + users.min(SPILL_USERS_MAX) * MIDPOINTS_MAX) * mirrors
    }

    /// Computes aims and gains for the users of a scene.
    ///
    /// Does not allocate up to the number of users of [`Spill::new`].
    pub fn update(&mut self, model: &ChannelModel, scene: &Scene) {
        self.clear(scene);
        if scene.paper {
            return;
        }
        let extents = scene.positions.iter().zip(&scene.serving);
        self.extents.extend(extents.map(|(position, led)| Extent::of(model, position, *led)));
        self.find_midpoints(model, scene);
        for aim in 0..self.points.len() {
            self.near.clear();
            for other in 0..scene.users {
                if other != aim && self.may_reach(model, aim, other) {
                    self.near.push(other);
                }
            }
            if self.near.is_empty() {
                self.starts.extend(std::iter::repeat_n(self.gains.len(), self.mirrors));
            } else {
                with_widest_simd(
                    #[inline(always)]
                    || self.around(model, scene, aim),
                );
            }
        }
        self.starts.push(self.gains.len());
        if self.gains.is_empty() {
            self.clear(scene);
        }
    }

    /// Leaves the users as the only aims, without gains.
    pub fn clear(&mut self, scene: &Scene) {
        self.mirrors = scene.mirrors;
        self.gains.clear();
        self.starts.clear();
        self.extents.clear();
        self.midpoints.clear();
        self.points.clear();
        self.points.extend_from_slice(&scene.positions);
        self.leds.clear();
        self.leds.extend_from_slice(&scene.serving);
    }

    /// Adds the midpoints between close users.
    fn find_midpoints(&mut self, model: &ChannelModel, scene: &Scene) {
        self.close.clear();
        for user in 0..scene.users {
            for other in user + 1..scene.users {
                let near = self.may_reach(model, user, other) || self.may_reach(model, other, user);
                if near && self.leds[user] == self.leds[other] {
                    let apart = (self.points[other] - self.points[user]).norm_squared();
                    self.close.push((apart, [user, other]));
                }
            }
        }
        if self.close.len() > MIDPOINTS_MAX {
            // The indices break ties, so that the order depends on the scene only.
            self.close.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            self.close.truncate(MIDPOINTS_MAX);
        }
        for (_, [user, other]) in &self.close {
            let (point, led) = (0.5 * (self.points[*user] + self.points[*other]), self.leds[*user]);
            self.points.push(point);
            self.leds.push(led);
            self.midpoints.push([*user, *other]);
            self.extents.push(Extent::of(model, &point, led));
        }
    }

    /// Whether no mirror that is aimed at a user reaches a second user.
    pub fn is_empty(&self) -> bool {
        self.gains.is_empty()
    }

    /// The users of each midpoint; the first midpoint is the aim K.
    pub fn midpoints(&self) -> &[[usize; 2]] {
        &self.midpoints
    }

    /// The points of the aims in m. Shape: A.
    pub fn points(&self) -> &[Vec3] {
        &self.points
    }

    /// Index of the LED whose light a mirror reflects to each aim. Shape: A.
    pub fn leds(&self) -> &[usize] {
        &self.leds
    }

    /// The gains over one mirror at an aim, in the order of the users, without the user that is the
    /// aim.
    pub fn of(&self, aim: usize, mirror: usize) -> &[SpilledGain] {
        let pair = aim * self.mirrors + mirror;
        match self.starts.get(pair..pair + 2) {
            Some(bounds) => &self.gains[bounds[0]..bounds[1]],
            None => &[],
        }
    }

    /// Whether a mirror can be aimed at one user, or at both users of a midpoint.
    #[inline(always)]
    fn can_aim(&self, scene: &Scene, aim: usize, mirror: usize) -> bool {
        let can_aim = |user: usize| scene.can_aim[user * self.mirrors + mirror];
        match aim.checked_sub(scene.users) {
            Some(index) => self.midpoints[index].into_iter().all(can_aim),
            None => can_aim(aim),
        }
    }

    /// Whether the gains from `start` on make a point an aim of a mirror: those of two users, or a
    /// gain above that of aiming at the only user.
    fn is_useful(&self, scene: &Scene, aim: usize, mirror: usize, start: usize) -> bool {
        let steering = |user: usize| scene.steering_gain[user * self.mirrors + mirror];
        match &self.gains[start..] {
            [] => true,
            [only] => aim < scene.users && steering(aim) > 0.0 || only.gain > steering(only.user),
            _ => true,
        }
    }

    /// Appends the gains of the users in `near` over each mirror at an aim.
    #[inline(always)]
    fn around(&mut self, model: &ChannelModel, scene: &Scene, aim: usize) {
        let target = [0, 1, 2].map(|axis| [self.points[aim][axis]; BLOCK]);
        for (index, first) in (0..self.mirrors).step_by(BLOCK).enumerate() {
            let lanes = BLOCK.min(self.mirrors - first);
            self.near_block.clear();
            for other in &self.near {
                if self.may_reach_over(model, index, aim, *other) {
                    self.near_block.push(*other);
                }
            }
            if self.near_block.is_empty() {
                self.starts.extend(std::iter::repeat_n(self.gains.len(), lanes));
                continue;
            }
            let to_led = model.directions_to_led(self.leds[aim], index);
            let (roll, yaw) = bisect(&model.mirrors, index, to_led, &target);
            let turned = Turned::at(&model.mirrors, &roll, &yaw, index);
            self.block.clear();
            for other in &self.near_block {
                self.block.push(gains_of_block(model, scene, &turned, *other, index));
            }
            for lane in 0..lanes {
                let start = self.gains.len();
                self.starts.push(start);
                if !self.can_aim(scene, aim, first + lane) {
                    continue;
                }
                for (other, gains) in self.near_block.iter().zip(&self.block) {
                    let weight = scene.path_weight[other * self.mirrors + first + lane];
                    keep(&mut self.gains, start, *other, weight * gains[lane]);
                }
                if !self.is_useful(scene, aim, first + lane, start) {
                    self.gains.truncate(start);
                }
            }
        }
    }

    /// Whether a mirror at an aim may illuminate a user, by a bound that never rejects a lit one.
    ///
    /// The axis of the beam passes through the aim, so the distance of the user from the axis is that
    /// of their difference, at least |horizontal part| sin(inclination) - |vertical part|. A user of
    /// another LED receives that LED's light over the mirror in another direction, for which the
    /// bound does not hold.
    fn may_reach(&self, model: &ChannelModel, aim: usize, user: usize) -> bool {
        if self.leds[aim] != self.leds[user] {
            return true;
        }
        let (apart, radius) = (self.points[user] - self.points[aim], self.extents[user].beam_radius_m);
        let from_axis = apart.x.hypot(apart.y) * self.extents[aim].least_inclination - apart.z.abs();
        from_axis <= radius
            && (0..model.mirrors.len().div_ceil(BLOCK)).any(|block| self.may_reach_over(model, block, aim, user))
    }

    /// The same for a block of mirrors.
    #[inline(always)]
    fn may_reach_over(&self, model: &ChannelModel, block: usize, aim: usize, user: usize) -> bool {
        let (apart, radius) = (self.points[user] - self.points[aim], self.extents[user].beam_radius_m);
        self.leds[aim] != self.leds[user] || any_beam_within(model, block, &self.points[aim], &apart, radius)
    }
}

/// Whether the axis of any beam of a block of mirrors to an aim passes within a radius of the point
/// at `apart` from the aim, all in m.
///
/// The distance of the point from an axis with direction t is sqrt(|apart|^2 - (apart . t)^2 / |t|^2).
#[inline(always)]
#[expect(clippy::needless_range_loop, reason = "one index into several arrays is what the compiler vectorises")]
fn any_beam_within(model: &ChannelModel, block: usize, aim: &Vec3, apart: &Vec3, radius: f64) -> bool {
    let centre = model.mirrors.block(block);
    let beyond = apart.norm_squared() - radius * radius;
    let mut largest = f64::NEG_INFINITY;
    for lane in 0..BLOCK {
        let beam = [0, 1, 2].map(|axis: usize| aim[axis] - centre[axis][lane]);
        let squared = beam[0] * beam[0] + beam[1] * beam[1] + beam[2] * beam[2];
        let along = beam[0] * apart.x + beam[1] * apart.y + beam[2] * apart.z;
        let slack = along * along - beyond * squared;
        largest = if slack > largest { slack } else { largest };
    }
    largest >= 0.0
}

/// Gains of one user over a block of mirrors at their angles, combined over the branches.
#[inline(always)]
fn gains_of_block(model: &ChannelModel, scene: &Scene, turned: &Turned, user: usize, index: usize) -> Lanes {
    let (panel, position) = (&model.panels[scene.serving[user]], &scene.positions[user]);
    let mut combined = [0.0; BLOCK];
    let slack = turned.candidates(&turned.source(panel), position);
    if !slack.iter().any(|slack| *slack >= 0.0) {
        return combined;
    }
    let complete = match Reflected::new(turned, panel, position) {
        Some(mut reflected) => {
            for branch in scene.held(user).branches {
                scene.combining.add_each(&mut combined, &reflected.gains(panel, branch));
            }
            scene.combining.finish_each(&mut combined, scene.branches);
            reflected.complete
        }
        None => [false; BLOCK],
    };
    let visible = &scene.irs_path_clear[user * scene.mirrors + index * BLOCK..];
    for lane in 0..BLOCK {
        let reached = slack[lane] >= 0.0 && visible.get(lane).is_some_and(|visible| *visible);
        if !reached {
            combined[lane] = 0.0;
        } else if !complete[lane] {
            let mut gains = [0.0; BRANCHES_MAX];
            let gains = &mut gains[..scene.branches];
            add_reflected(turned.surfaces.reflectivity[lane], panel, &turned.plate(lane), scene.held(user), gains);
            combined[lane] = scene.combining.combine(gains);
        }
    }
    combined
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
    fn of(model: &ChannelModel, position: &Vec3, led: usize) -> Self {
        let panel = &model.panels[led];
        let (mut farthest, mut lowest_z, mut highest_z) = (0.0, f64::INFINITY, f64::NEG_INFINITY);
        for array in model.mirrors.arrays() {
            let (mirrors, columns) = (array.positions(), array.columns());
            let (lowest, highest) = (&mirrors[0], &mirrors[mirrors.len() - 1]);
            // A distance is a convex function of the mirror, so it is largest at a corner.
            let corners = [lowest, highest, &mirrors[columns - 1], &mirrors[mirrors.len() - columns]];
            farthest = corners.map(|corner| (corner - position).norm()).into_iter().fold(farthest, f64::max);
            (lowest_z, highest_z) = (lowest.z.min(lowest_z), highest.z.max(highest_z));
        }
        let rise = (lowest_z - position.z).max(position.z - highest_z).max(0.0);
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
    let half_diagonal = |array: &MirrorArray| 0.5 * array.spec().mirror_width_m.hypot(array.spec().mirror_height_m);
    let half_diagonal_m = model.mirrors.arrays().iter().map(half_diagonal).fold(0.0, f64::max);
    let before_m = nearest_mirror_m - panel_radius_m - half_diagonal_m;
    if before_m <= 0.0 {
        return f64::INFINITY;
    }
    half_diagonal_m + (farthest_m + half_diagonal_m) / before_m * (half_diagonal_m + panel_radius_m)
}
