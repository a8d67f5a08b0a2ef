//! The input of a compact actor: one row of features for each user, and the history of the channel
//! residuals behind it.
//!
//! # Layout of a row, version 4
//! Vectors are in the user's [`Frame`]. No value depends on the size of the room, the number of
//! mirrors or users, or the wall of the array. A residual is the logarithm of a measured gain over
//! the expected one, at most 1.5 either way; the residual over the mirrors has a weight that grows
//! with the share of the mirrors that serve the user.
//!
//! | values | meaning |
//! | --- | --- |
//! | 2 | velocity in m/s |
//! | 1 | speed in m/s |
//! | 2 | 5 times the standard deviations of the place in m and of the velocity in m/s |
//! | 2 | mean of the believed unit vectors of the heading |
//! | 1 | probability that no unreported obstacle blocks the direct path |
//! | 4 | unit vector to the nearest LED (3), height component of that to the nearest array (1) |
//! | 2 | horizontal components of the believed normal of the receiver |
//! | 4 | last report: direct path shown, its residual, weight and weighted residual of the mirrors |
//! | 15 | means over [`MEMORY_S`]: time observed, share shown, direct residual, weight and residual of the mirrors |
//! | 5 | all users, this one included: measurements, mean and root mean square of the direct residual, then of the mirrors' |

use std::ops::Range;

use heliostat_channel::{ChannelModel, Orientation, Vec3};
use heliostat_proto::{MAX_USERS, Nanos};
use serde::{Deserialize, Serialize};

use crate::{
    belief::{Estimate, residual::GainResidual},
    observe::correction::{Correction, Explained, Frame},
};

/// Version of the rows; a compact actor made for another version is refused.
pub const EVIDENCE_VERSION: u32 = 4;

/// Length of a row.
pub const FEATURES: usize = 38;

/// Index of the direction to the LED in a row; the height component of that to the array follows.
pub const LED: usize = 8;

/// Index of the believed normal in a row.
pub const NORMAL: usize = 12;

/// The residuals and weights of the user's last report in a row.
pub const LAST_REPORT: Range<usize> = NORMAL + 2..NORMAL + 6;

/// The user's means over [`MEMORY_S`] in a row.
pub const MEANS: Range<usize> = LAST_REPORT.end..LAST_REPORT.end + MEAN_VALUES * MEMORY_S.len();

/// The residuals of all users in a row, its own user included.
pub const ALL_USERS: Range<usize> = MEANS.end..FEATURES;

/// Values of each mean.
const MEAN_VALUES: usize = 5;

/// The values of a row that change sign in a mirrored room: the second components of vectors.
pub const MIRRORED: [usize; 4] = [1, 6, 9, 13];

/// Time constants of the means of a user's residuals in s.
pub const MEMORY_S: [f64; 3] = [0.3, 1.5, 6.0];

/// Time constant in s of the means over all users, which show how receivers are held in this room.
const ROOM_MEMORY_S: f64 = 20.0;

/// Bound of a residual.
const RESIDUAL_MAX: f64 = 1.5;

/// Share of the mirrors that serve a user below which the residual over the mirrors is not used.
const SERVED: f64 = 0.02;

/// Share of the mirrors from which the residual over the mirrors has its full weight.
const SERVED_FULLY: f64 = 0.2;

/// A mean with less weight than this counts as one of this weight.
const WEIGHT_MIN: f64 = 0.02;

/// A user without a measurement for this time in ns is forgotten.
const FORGOTTEN_NS: Nanos = 2_000_000_000;

/// The residuals of one measurement, weights included: observed, shown, direct residual, weight and
/// residual of the mirrors.
type Sample = [f64; MEAN_VALUES];

/// What is remembered of one user.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Entry {
    user: u32,
    time_ns: Nanos,
    last: Sample,
    means: [Sample; 3],
}

/// The state of the history, as a recording holds it.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct EvidenceMemory {
    entries: Vec<Entry>,
    /// Sums over all users: direct measurements, residual and its square, the same of the mirrors.
    room: [f64; 6],
    time_ns: Nanos,
}

/// The history of the residuals, and the rows of the last observation. Its buffers are allocated
/// once.
#[derive(Clone, Debug)]
pub struct Evidence {
    history: EvidenceMemory,
    rows: Vec<[f32; FEATURES]>,
    frames: Vec<Frame>,
    corrections: Vec<Correction>,
}

impl Default for Evidence {
    fn default() -> Self {
        Self {
            history: EvidenceMemory { entries: Vec::with_capacity(MAX_USERS), ..EvidenceMemory::default() },
            rows: Vec::with_capacity(MAX_USERS),
            frames: Vec::with_capacity(MAX_USERS),
            corrections: Vec::with_capacity(MAX_USERS),
        }
    }
}

/// What a row shows of a user besides the residuals.
#[derive(Clone, Copy, Debug)]
pub struct Believed {
    /// Number of the user.
    pub user: u32,
    /// The belief for the time in which the command acts.
    pub estimate: Estimate,
    /// How the receiver is held.
    pub orientation: Orientation,
}

impl Evidence {
    /// Takes the residuals of a channel report.
    pub fn handle_channel(&mut self, time_ns: Nanos, residuals: &[GainResidual]) {
        let EvidenceMemory { entries, room, time_ns: last_ns } = &mut self.history;
        let elapsed_s = time_ns.saturating_sub(*last_ns) as f64 * 1e-9;
        let kept = (-elapsed_s / ROOM_MEMORY_S).exp();
        room.iter_mut().for_each(|sum| *sum *= kept);
        *last_ns = time_ns;
        for residual in residuals {
            let sample = sample(residual);
            let [_, shown, direct, weight, mirrors] = sample;
            let sums = [shown, direct, direct * direct, weight, mirrors, mirrors * mirrors / weight.max(WEIGHT_MIN)];
            room.iter_mut().zip(sums).for_each(|(sum, value)| *sum += value);
            if let Some(entry) = entries.iter_mut().find(|entry| entry.user == residual.user) {
                entry.handle(time_ns, sample);
            } else if entries.len() < MAX_USERS {
                entries.push(Entry { user: residual.user, time_ns, last: sample, means: [[0.0; MEAN_VALUES]; 3] });
            }
        }
        entries.retain(|entry| time_ns.saturating_sub(entry.time_ns) < FORGOTTEN_NS);
    }

    /// Forgets these users, since their numbers belong to others now.
    pub fn forget_users(&mut self, users: &[u32]) {
        self.history.entries.retain(|entry| !users.contains(&entry.user));
    }

    /// Forgets all users, since another source reports from now on.
    pub fn forget(&mut self) {
        self.history.entries.clear();
        self.history.room = [0.0; 6];
    }

    /// Starts the rows of an observation.
    pub fn begin(&mut self) {
        self.rows.clear();
        self.frames.clear();
        self.corrections.clear();
    }

    /// Adds the row of the next user.
    pub fn add(&mut self, model: &ChannelModel, believed: &Believed) {
        let Believed { user, estimate, orientation } = believed;
        let towards_array = towards(&estimate.position, nearest_array(model, &estimate.position));
        let leds = model.leds.iter().map(|led| led.position);
        let towards_led = towards(&estimate.position, nearest(&estimate.position, leds));
        let frame = Frame::towards(&towards_array);
        let [xx, _, yy] = estimate.position_cov_m2;
        let [along, left] = frame.of_room(&estimate.velocity);
        let [heading_along, heading_left] = frame.of_room(&estimate.heading);
        let [led_along, led_left] = frame.of_room(&towards_led);
        let [normal_along, normal_left] = frame.of_room(&orientation.normal());
        let speed = estimate.velocity.norm();
        let (place, velocity) = ((xx + yy).max(0.0).sqrt(), estimate.velocity_var_m2_s2.max(0.0).sqrt());
        let state = [along, left, speed, 5.0 * place, 5.0 * velocity, heading_along, heading_left];
        let scene = [estimate.direct_clear, led_along, led_left, towards_led.z, towards_array.z];
        let mut values =
            state.into_iter().chain(scene).chain([normal_along, normal_left]).chain(self.history.of(*user));
        let row = std::array::from_fn(|_| values.next().unwrap_or_default() as f32);
        self.rows.push(row);
        self.frames.push(frame);
        self.corrections.push(Correction::NONE);
    }

    /// The rows of the last observation. Shape: K * [`FEATURES`].
    pub fn rows(&self) -> &[[f32; FEATURES]] {
        &self.rows
    }

    /// The frame of each row. Shape: K.
    pub fn frames(&self) -> &[Frame] {
        &self.frames
    }

    /// The corrections of the last observation. Shape: K.
    pub fn corrections(&self) -> &[Correction] {
        &self.corrections
    }

    /// Decodes the outputs of a network as the corrections of all users. Shape of `outputs`: K *
    /// [`Correction::VALUES`], row-major. Other lengths leave the users without corrections.
    pub fn correct(&mut self, outputs: &[f32]) {
        let (rows, rest) = outputs.as_chunks();
        if rows.len() != self.rows.len() || !rest.is_empty() {
            return;
        }
        let users = self.rows.iter().zip(&self.frames).zip(rows);
        for (correction, ((row, frame), output)) in self.corrections.iter_mut().zip(users) {
            *correction = correction_of(row, frame, output);
        }
    }

    /// Leaves the users without corrections for whom `discarded` is true, in the order of the rows.
    pub fn discard_where(&mut self, discarded: impl Iterator<Item = bool>) {
        for (correction, discarded) in self.corrections.iter_mut().zip(discarded) {
            if discarded {
                *correction = Correction::NONE;
            }
        }
    }

    /// The present state.
    pub fn memory(&self) -> EvidenceMemory {
        self.history.clone()
    }

    /// Replaces the state; false where it is none.
    pub fn restore(&mut self, memory: &EvidenceMemory) -> bool {
        let values = |entry: &Entry| entry.last.into_iter().chain(entry.means.into_iter().flatten());
        let is_sound = memory.entries.len() <= MAX_USERS
            && memory.room.iter().copied().chain(memory.entries.iter().flat_map(values)).all(f64::is_finite);
        if is_sound {
            self.history.clone_from(memory);
            self.history.entries.reserve(MAX_USERS - memory.entries.len());
        }
        is_sound
    }
}

impl Entry {
    fn handle(&mut self, time_ns: Nanos, sample: Sample) {
        let elapsed_s = time_ns.saturating_sub(self.time_ns) as f64 * 1e-9;
        (self.time_ns, self.last) = (time_ns, sample);
        for (means, memory_s) in self.means.iter_mut().zip(MEMORY_S) {
            let kept = (-elapsed_s / memory_s).exp();
            means.iter_mut().zip(sample).for_each(|(mean, value)| *mean = kept * *mean + (1.0 - kept) * value);
        }
    }
}

impl EvidenceMemory {
    /// The features of a user's residuals and of all users.
    fn of(&self, user: u32) -> impl Iterator<Item = f64> {
        let unknown = Entry { user, time_ns: 0, last: [0.0; MEAN_VALUES], means: [[0.0; MEAN_VALUES]; 3] };
        let entry = self.entries.iter().find(|entry| entry.user == user).copied().unwrap_or(unknown);
        let [_, shown_last, direct, weight, mirrors] = entry.last;
        let means = entry.means.into_iter().flat_map(|[observed, shown, direct, weight, mirrors]| {
            [
                observed,
                shown / observed.max(WEIGHT_MIN),
                direct / shown.max(WEIGHT_MIN),
                weight,
                mirrors / weight.max(WEIGHT_MIN),
            ]
        });
        let [count, direct_sum, direct_squares, weights, mirror_sum, mirror_squares] = self.room;
        let (shown, served) = (count.max(WEIGHT_MIN), weights.max(WEIGHT_MIN));
        let room = [
            (count / 50.0).min(2.0),
            direct_sum / shown,
            (direct_squares / shown).sqrt(),
            mirror_sum / served,
            (mirror_squares / served).sqrt(),
        ];
        [shown_last, direct, weight, mirrors].into_iter().chain(means).chain(room)
    }
}

/// The correction that the output of a network makes for a row in a frame.
pub fn correction_of(row: &[f32; FEATURES], frame: &Frame, output: &[f32; Correction::VALUES]) -> Correction {
    let believed = [row[NORMAL], row[NORMAL + 1]].map(f64::from);
    Correction::decode(output, frame, (believed, &explained(row)))
}

/// What the residuals of a row show of the tilt, by the means of the middle memory.
fn explained(row: &[f32; FEATURES]) -> Explained {
    let value = |index: usize| f64::from(row[index]);
    let array_z = value(LED + 3);
    let array = Vec3::new((1.0 - array_z * array_z).max(0.0).sqrt(), 0.0, array_z);
    let [_, shown, direct, weight, mirrors] = std::array::from_fn(|offset| value(MEANS.start + MEAN_VALUES + offset));
    Explained {
        directions: [Vec3::new(value(LED), value(LED + 1), value(LED + 2)), array],
        residuals: [direct, mirrors],
        weights: [shown, weight],
    }
}

fn sample(residual: &GainResidual) -> Sample {
    let ratio = |[measured, expected]: [f64; 2]| {
        let sound = measured > 0.0 && expected > 0.0;
        if sound { (measured / expected).ln().clamp(-RESIDUAL_MAX, RESIDUAL_MAX) } else { -RESIDUAL_MAX }
    };
    let modelled = residual.los[1] > 0.0;
    let shown = f64::from(u8::from(modelled && residual.los_shown));
    let served = if residual.steering > 0.0 { residual.irs[1] / residual.steering } else { 0.0 };
    let weight = if served > SERVED { (served / SERVED_FULLY).min(1.0) } else { 0.0 };
    let direct = if shown > 0.0 { ratio(residual.los) } else { 0.0 };
    let mirrors = if weight > 0.0 { weight * ratio(residual.irs) } else { 0.0 };
    [f64::from(u8::from(modelled)), shown, direct, weight, mirrors]
}

fn nearest_array(model: &ChannelModel, position: &Vec3) -> Vec3 {
    let centre = |mirrors: &heliostat_channel::MirrorArray| {
        let positions = mirrors.positions();
        (positions[0] + positions[positions.len() - 1]) / 2.0
    };
    nearest(position, model.mirrors.arrays().iter().map(centre))
}

/// The nearest of some points; the position itself without any.
fn nearest(position: &Vec3, points: impl Iterator<Item = Vec3>) -> Vec3 {
    let distance = |point: &Vec3| (point - position).norm_squared();
    points.min_by(|one, other| distance(one).total_cmp(&distance(other))).unwrap_or(*position)
}

/// The unit vector from one point to another; zero for the same point.
fn towards(from: &Vec3, to: Vec3) -> Vec3 {
    let away = to - from;
    let length = away.norm();
    if length > 0.0 { away / length } else { Vec3::zeros() }
}
