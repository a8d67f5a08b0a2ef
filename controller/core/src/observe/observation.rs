//! The input of a policy: the known state of the room, and its encoding as a flat vector for a
//! network.
//!
//! Training and serving fill the same [`Observation`] and encode it with the same
//! [`ObservationEncoder`]. Serving fills it from reports (see [`crate::observer`]), training from
//! the true state of a simulated room.
//!
//! # Layout of the vector, version 3
//! For a capacity of U users and M mirrors, all in f32; slots beyond the users present hold 0:
//!
//! | part | values | meaning |
//! | --- | --- | --- |
//! | mask | U | 1 where the slot holds a user |
//! | positions | 3 U | x, y, z of each user in m, room frame |
//! | LoS amplitude | U | s times the gain of the direct path |
//! | minimum rate | U | minimum rate times users over bandwidth, bit/s/Hz |
//! | steering amplitude | U M, user by user | s times the gain of each mirror if it were aimed at the user |
//! | angles | 2 M | roll of each mirror, then yaw of each mirror, as last commanded, rad |
//! | summary | 11 U | features of each user, column by column: see [`Summary`] |
//!
//! s is [`LinkBudget::amplitude_scale`](heliostat_channel::link::LinkBudget::amplitude_scale), in
//! which power, noise and responsivity multiply the gains. So amplitudes are dimensionless, and one
//! actor serves other powers and noise levels.

use std::ops::Range;

use heliostat_channel::{ChannelModel, Orientation, Scene, Vec3, blockage::Cylinder, mirrors::MirrorAngles, sharing};
use thiserror::Error;

/// Version of the vector's layout; an actor made for another version is refused.
///
/// Version 2 added the summary at the end; version 3 has it column by column, with balanced
/// weights.
pub const OBSERVATION_VERSION: u32 = 3;

/// Largest number of users of the shipped actors.
pub const USERS_CAPACITY: usize = 10;

/// Columns of the summary, each with a value for every slot.
///
/// a_km is the steering amplitude of mirror m towards user k. p_k = sqrt(M) / sum_m a_km is the
/// equal-share weight: with it, sum_m p_k a_km is the same for all users. q_k is the balanced
/// weight, which [`heliostat_channel::sharing::balance`] computes from p_k. A soft assignment is
/// the fraction of a mirror's light that a user receives;
/// [`heliostat_channel::sharing::amplitudes`] computes the users' amplitudes from it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Summary {
    /// 1 where the slot holds a user.
    Present,
    /// x in m; y and z follow.
    Place,
    /// Minimum rate times users over bandwidth, bit/s/Hz.
    Need = 4,
    /// Number of users.
    Users,
    /// ln(1 + direct amplitude).
    LogDirect,
    /// ln(1 + sum_m a_km): all mirrors serve the user, without the direct path.
    LogSteering,
    /// ln(1 + amplitude with the equal-share weights p).
    LogShared,
    /// ln(1 + amplitude with the balanced weights q).
    LogBalanced,
    /// ln q_k, with q scaled so that the mean of ln q is that of ln p.
    LogWeight,
}

impl Summary {
    /// Number of columns.
    pub const COLUMNS: usize = 11;
}

/// Keeps the weight finite for a user without a path to any mirror; far below any amplitude that
/// carries data.
const NO_AMPLITUDE: f32 = 1e-6;

/// One snapshot of the room: K users and M mirrors. Its buffers are reused from tick to tick.
#[derive(Clone, Debug)]
pub struct Observation {
    /// The tick that the reports belong to.
    pub tick: u64,
    /// K numbers of the users, all different; a policy keeps what it remembers of a user by it.
    pub ids: Vec<u32>,
    /// K positions in m, room frame.
    pub positions: Vec<Vec3>,
    /// K velocities in m/s, room frame.
    pub velocities: Vec<Vec3>,
    /// K minimum rates in bit/s.
    pub min_rate_bps: Vec<f64>,
    /// Blockage, LoS gains (measured where reported) and steering gains at these positions.
    pub scene: Scene,
    /// M angles as last commanded.
    pub angles: MirrorAngles,
}

/// The state of a room from which an [`Observation`] is filled: all slices but `blockers` hold K
/// entries.
#[derive(Clone, Copy, Debug, Default)]
pub struct RoomState<'a> {
    /// The tick that the state belongs to.
    pub tick: u64,
    /// Positions in m, room frame.
    pub positions: &'a [Vec3],
    /// How the users hold their receivers; absent: every receiver faces up.
    pub orientations: Option<&'a [Orientation]>,
    /// Velocities in m/s, room frame.
    pub velocities: &'a [Vec3],
    /// Minimum rates in bit/s.
    pub min_rate_bps: &'a [f64],
    /// Cylinders that block paths: obstacles and bodies.
    pub blockers: &'a [Cylinder],
    /// Users whose direct path is forced to be blocked.
    pub forced: &'a [bool],
    /// Gains of the direct path as measured; they replace the modelled ones.
    pub measured_los_gain: Option<&'a [f64]>,
}

impl Observation {
    /// An observation of the users 0 to `users` - 1 at the origin, with every mirror at (0, 0).
    pub fn new(model: &ChannelModel, users: usize) -> Self {
        let mirrors = model.mirrors.len();
        Self {
            tick: 0,
            ids: (0..users as u32).collect(),
            positions: vec![Vec3::zeros(); users],
            velocities: vec![Vec3::zeros(); users],
            min_rate_bps: vec![0.0; users],
            scene: Scene::new(model, users),
            angles: MirrorAngles::flat(mirrors),
        }
    }

    /// The observation that a vector describes: the users of the slots with a presence of 1.
    /// Velocities are zero.
    ///
    /// # Errors
    /// [`EncodeError`] where the vector has another length, or the array another size.
    pub fn of_vector(model: &ChannelModel, encoder: ObservationEncoder, vector: &[f32]) -> Result<Self, EncodeError> {
        encoder.check(0, model.mirrors.len(), vector)?;
        let slots: Vec<usize> = (0..encoder.users_max()).filter(|slot| vector[encoder.mask()][*slot] > 0.5).collect();
        let (users, mirrors) = (slots.len(), encoder.mirrors());
        let mut observation = Self::new(model, users);
        let wide = |range: Range<usize>| vector[range].iter().map(|value| f64::from(*value));
        let places: Vec<f64> = wide(encoder.positions()).collect();
        let [los, need, steering] = [encoder.los_amplitude(), encoder.min_rate(), encoder.steering_amplitude()]
            .map(|part| wide(part).collect::<Vec<_>>());
        let scale = model.budget.amplitude_scale();
        let of_slots =
            |values: &[f64], factor: f64| slots.iter().map(|slot| factor * values[*slot]).collect::<Vec<_>>();
        let state = RoomState {
            positions: &slots.iter().map(|slot| Vec3::from_column_slice(&places[3 * slot..][..3])).collect::<Vec<_>>(),
            velocities: &vec![Vec3::zeros(); users],
            min_rate_bps: &of_slots(&need, model.budget.bandwidth_hz / users.max(1) as f64),
            forced: &vec![false; users],
            measured_los_gain: Some(&of_slots(&los, 1.0 / scale)),
            ..RoomState::default()
        };
        observation.set_state(model, &state);
        let gains = slots.iter().flat_map(|slot| &steering[slot * mirrors..][..mirrors]).map(|gain| gain / scale);
        observation.scene.set_steering_gain(&gains.collect::<Vec<_>>());
        let angles: Vec<f64> = wide(encoder.angles()).collect();
        observation.angles.roll.copy_from_slice(&angles[..mirrors]);
        observation.angles.yaw.copy_from_slice(&angles[mirrors..]);
        Ok(observation)
    }

    /// The same, with memory for `users_max` users.
    pub fn with_capacity(model: &ChannelModel, users: usize, users_max: usize) -> Self {
        let mut observation = Self::new(model, users_max);
        observation.resize(users);
        observation
    }

    /// How many users the observation holds.
    pub fn users(&self) -> usize {
        self.positions.len()
    }

    /// How many mirrors the observation holds.
    pub fn mirrors(&self) -> usize {
        self.angles.roll.len()
    }

    /// Copies a state and recomputes blockage and gains for it. Does not allocate up to the largest
    /// number of users so far.
    ///
    /// A state of another number of users numbers them from 0; the caller may change `ids`.
    ///
    /// # Panics
    /// If the slices differ in their number of users.
    pub fn set_state(&mut self, model: &ChannelModel, state: &RoomState<'_>) {
        if state.positions.len() != self.users() {
            self.resize(state.positions.len());
        }
        self.tick = state.tick;
        self.positions.copy_from_slice(state.positions);
        self.velocities.copy_from_slice(state.velocities);
        self.min_rate_bps.copy_from_slice(state.min_rate_bps);
        match state.orientations {
            Some(held) => self.scene.update_turned(model, state.positions, held, state.blockers, state.forced),
            None => self.scene.update(model, state.positions, state.blockers, state.forced),
        }
        if let Some(gains) = state.measured_los_gain {
            self.scene.set_los_gain(gains);
        }
    }

    /// Changes the number of users, and numbers them from 0; the caller fills the lists and updates the
    /// scene.
    pub(super) fn resize(&mut self, users: usize) {
        self.ids.clear();
        self.ids.extend(0..users as u32);
        self.positions.resize(users, Vec3::zeros());
        self.velocities.resize(users, Vec3::zeros());
        self.min_rate_bps.resize(users, 0.0);
        self.scene.resize(users);
    }
}

/// Why an observation does not fit the vector.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum EncodeError {
    /// More users than slots.
    #[error("{users} users, expected at most {capacity} as in the actor")]
    Users {
        /// Users in the observation.
        users: usize,
        /// Slots of the vector.
        capacity: usize,
    },
    /// Another number of mirrors.
    #[error("an array of size {found}, expected {expected} as in the actor")]
    Mirrors {
        /// Mirrors in the observation.
        found: usize,
        /// Mirrors of the vector.
        expected: usize,
    },
    /// The buffer has another length than the vector.
    #[error("a buffer of length {found}, expected {expected} as in the vector")]
    Buffer {
        /// Length of the buffer.
        found: usize,
        /// Length of the vector.
        expected: usize,
    },
}

/// A part of the vector.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Part {
    /// Its name in files and in Python.
    pub name: &'static str,
    /// The indices of its values.
    pub values: Range<usize>,
    /// Its shape, row-major.
    pub shape: Vec<usize>,
}

/// Position and encoding of each part of the vector. The [module](self) has the layout.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ObservationEncoder {
    users_max: usize,
    mirrors: usize,
}

impl ObservationEncoder {
    /// An encoder for at most `users_max` users and exactly `mirrors` mirrors.
    pub fn new(users_max: usize, mirrors: usize) -> Self {
        Self { users_max, mirrors }
    }

    /// Largest number of users.
    pub fn users_max(&self) -> usize {
        self.users_max
    }

    /// Number of mirrors.
    pub fn mirrors(&self) -> usize {
        self.mirrors
    }

    /// Length of the vector: U (17 + M) + 2 M.
    #[expect(clippy::len_without_is_empty, reason = "the vector is never empty")]
    pub fn len(&self) -> usize {
        self.summary().end
    }

    /// The parts of the vector, in its order.
    pub fn parts(&self) -> [Part; 7] {
        let (users, mirrors) = (self.users_max, self.mirrors);
        let part = |name, values, shape: &[usize]| Part { name, values, shape: shape.to_vec() };
        [
            part("mask", self.mask(), &[users]),
            part("positions", self.positions(), &[users, 3]),
            part("los_amplitude", self.los_amplitude(), &[users]),
            part("min_rate", self.min_rate(), &[users]),
            part("steering_amplitude", self.steering_amplitude(), &[users, mirrors]),
            part("angles", self.angles(), &[2, mirrors]),
            part("summary", self.summary(), &[Summary::COLUMNS, users]),
        ]
    }

    /// 1 in each slot that holds a user.
    pub fn mask(&self) -> Range<usize> {
        0..self.users_max
    }

    /// The positions, user by user.
    pub fn positions(&self) -> Range<usize> {
        following(&self.mask(), 3 * self.users_max)
    }

    /// The amplitudes of the direct paths.
    pub fn los_amplitude(&self) -> Range<usize> {
        following(&self.positions(), self.users_max)
    }

    /// The users' minimum rates.
    pub fn min_rate(&self) -> Range<usize> {
        following(&self.los_amplitude(), self.users_max)
    }

    /// The steering amplitudes, user by user.
    pub fn steering_amplitude(&self) -> Range<usize> {
        following(&self.min_rate(), self.users_max * self.mirrors)
    }

    /// The angles, all roll and then all yaw.
    pub fn angles(&self) -> Range<usize> {
        following(&self.steering_amplitude(), 2 * self.mirrors)
    }

    /// The summary, column by column.
    pub fn summary(&self) -> Range<usize> {
        following(&self.angles(), Summary::COLUMNS * self.users_max)
    }

    /// A column of the summary.
    pub fn column(&self, column: usize) -> Range<usize> {
        let start = self.summary().start + column * self.users_max;
        start..start + self.users_max
    }

    /// Writes the vector of an observation, each user in the slot of the same index. Does not
    /// allocate.
    ///
    /// # Errors
    /// [`EncodeError`] where users, mirrors or buffer do not fit.
    pub fn encode(&self, model: &ChannelModel, observation: &Observation, out: &mut [f32]) -> Result<(), EncodeError> {
        self.encode_users(model, observation, 0..observation.users(), out)
    }

    /// Writes the vector with some users of an observation: the first of `chosen` in slot 0, and so
    /// on. Does not allocate.
    ///
    /// All users share the bandwidth, so the minimum rates are relative to the share of one of all.
    ///
    /// # Errors
    /// As [`encode`](Self::encode).
    ///
    /// # Panics
    /// If `chosen` has the index of no user.
    pub fn encode_users(
        &self,
        model: &ChannelModel,
        observation: &Observation,
        chosen: impl ExactSizeIterator<Item = usize>,
        out: &mut [f32],
    ) -> Result<(), EncodeError> {
        let users = chosen.len();
        self.check(users, observation.mirrors(), out)?;
        let amplitude_scale = model.budget.amplitude_scale();
        let min_rate_scale = observation.users() as f64 / model.budget.bandwidth_hz;
        out[..self.angles().start].fill(0.0);
        out[self.mask()][..users].fill(1.0);
        for (slot, user) in chosen.enumerate() {
            let pairs = user * self.mirrors..(user + 1) * self.mirrors;
            write_scaled(&mut out[self.positions()][3 * slot..][..3], observation.positions[user].as_slice(), 1.0);
            out[self.los_amplitude()][slot] = (amplitude_scale * observation.scene.los_gain()[user]) as f32;
            out[self.min_rate()][slot] = (min_rate_scale * observation.min_rate_bps[user]) as f32;
            let row = &mut out[self.steering_amplitude()][slot * self.mirrors..][..self.mirrors];
            write_scaled(row, &observation.scene.steering_gain()[pairs], amplitude_scale);
        }

        let (roll, yaw) = out[self.angles()].split_at_mut(self.mirrors);
        write_scaled(roll, &observation.angles.roll, 1.0);
        write_scaled(yaw, &observation.angles.yaw, 1.0);
        self.summarise(users, out);
        Ok(())
    }

    /// Writes the summary of `users` users from the other parts.
    fn summarise(&self, users: usize, out: &mut [f32]) {
        let (parts, summary) = out.split_at_mut(self.summary().start);
        summary.fill(0.0);
        let direct = &parts[self.los_amplitude()][..users];
        let min_rates = &parts[self.min_rate()][..users];
        let steering = &parts[self.steering_amplitude()][..users * self.mirrors];
        let mut columns = summary.chunks_exact_mut(self.users_max).map(|column| &mut column[..users]);
        let [present, x, y, z, min_rate, count, log_direct, log_steering, shared, balanced, weight] =
            std::array::from_fn::<_, { Summary::COLUMNS }, _>(|_| columns.next().expect("a column for each entry"));
        present.fill(1.0);
        count.fill(users as f32);
        min_rate.copy_from_slice(min_rates);
        let scale = (self.mirrors as f32).sqrt();
        for user in 0..users {
            let place = &parts[self.positions()][3 * user..][..3];
            (x[user], y[user], z[user]) = (place[0], place[1], place[2]);
            let total = interleaved_sum(&steering[user * self.mirrors..][..self.mirrors]);
            log_steering[user] = total.ln_1p();
            log_direct[user] = direct[user].ln_1p();
            weight[user] = scale / (total + NO_AMPLITUDE);
        }
        sharing::amplitudes(steering, direct, weight, shared);
        balanced.copy_from_slice(shared);
        let before = mean_log(weight);
        sharing::balance(steering, direct, min_rates, weight, balanced);
        let factor = before - mean_log(weight);
        for user in 0..users {
            shared[user] = shared[user].ln_1p();
            balanced[user] = balanced[user].ln_1p();
            weight[user] = weight[user].ln() + factor;
        }
    }

    fn check(&self, users: usize, mirrors: usize, out: &[f32]) -> Result<(), EncodeError> {
        if users > self.users_max {
            return Err(EncodeError::Users { users, capacity: self.users_max });
        }
        if mirrors != self.mirrors {
            return Err(EncodeError::Mirrors { found: mirrors, expected: self.mirrors });
        }
        if out.len() != self.len() {
            return Err(EncodeError::Buffer { found: out.len(), expected: self.len() });
        }
        Ok(())
    }
}

/// The mean of the values' logarithms.
fn mean_log(values: &[f32]) -> f32 {
    values.iter().map(|value| value.ln()).sum::<f32>() / values.len() as f32
}

/// Sum of a list in eight interleaved parts, an order that the compiler can vectorise.
fn interleaved_sum(values: &[f32]) -> f32 {
    let (full, rest) = values.as_chunks::<8>();
    let mut parts = [0.0; 8];
    for chunk in full {
        for (part, value) in parts.iter_mut().zip(chunk) {
            *part += value;
        }
    }
    parts.iter().sum::<f32>() + rest.iter().sum::<f32>()
}

/// The range of `length` values after `previous`.
fn following(previous: &Range<usize>, length: usize) -> Range<usize> {
    previous.end..previous.end + length
}

/// Writes `scale` times the values.
fn write_scaled(part: &mut [f32], values: &[f64], scale: f64) {
    for (slot, value) in part.iter_mut().zip(values) {
        *slot = (scale * value) as f32;
    }
}
