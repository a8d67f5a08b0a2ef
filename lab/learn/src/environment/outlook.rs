//! What a command would give in the true room if the receivers were believed to be held otherwise:
//! the numbers from which the true future rate follows as a function of the corrections.

use heliostat_channel::{ChannelModel, MirrorAngles, Vec3, decode};
use heliostat_core::correction::{Frame, upward};
use heliostat_core::evidence::{FEATURES, LED, NORMAL};
use heliostat_room::SimulatedRoom;

use super::reported::Future;

/// One decision. Amplitudes are dimensionless, as in [`heliostat_channel::sharing`]; K users and M
/// mirrors. Vectors are in the frame of the user's row.
#[derive(Clone, Debug, PartialEq)]
pub struct Outlook {
    /// Rows of the actor. Shape: K * [`FEATURES`].
    pub rows: Vec<[f32; FEATURES]>,
    /// Normals of the receivers as the command has assumed them, corrections included. Shape: K.
    pub assumed: Vec<[f64; 3]>,
    /// Unit vectors from the users to the nearest LED. Shape: K.
    pub to_led: Vec<[f64; 3]>,
    /// Unit vectors from the users to the mirrors. Shape: K * M.
    pub to_mirrors: Vec<[f64; 3]>,
    /// Believed amplitude of the direct path for the assumed normals. Shape: K.
    pub direct: Vec<f32>,
    /// Believed amplitude of each mirror that is aimed at the user. Shape: K * M.
    pub steering: Vec<f32>,
    /// Minimum rates in bit/s/Hz of a user's band. Shape: K.
    pub min_rate: Vec<f32>,
    /// True future amplitude of the direct path. Shape: K.
    pub true_direct: Vec<f32>,
    /// True future amplitude for user k of mirror m when the controller aims it at user j, errors
    /// of belief and mounting included. Index (k K + j) M + m.
    pub crossed: Vec<f32>,
}

impl Outlook {
    /// The numbers of a decision; `model` is the channel that the controller assumes.
    pub fn of(future: &Future<'_>, model: &ChannelModel) -> Self {
        let seen = future.room.observation();
        let scale = model.budget.amplitude_scale();
        let frames = future.evidence.frames();
        let rows = future.evidence.rows().to_vec();
        let corrections = future.evidence.corrections().iter();
        let assumed = rows.iter().zip(frames).zip(corrections).map(|((row, frame), correction)| {
            let change = frame.of_room(&correction.tilt());
            upward([f64::from(row[NORMAL]) + change[0], f64::from(row[NORMAL + 1]) + change[1]]).into()
        });
        let mirrors: Vec<Vec3> = model.mirrors.arrays().iter().flat_map(|array| array.positions()).copied().collect();
        let to_mirrors = seen.positions.iter().zip(frames).flat_map(|(position, frame)| {
            mirrors.iter().map(move |mirror| in_frame(frame, &(mirror - position).normalize()))
        });
        let narrow = |gains: &[f64]| -> Vec<f32> { gains.iter().map(|gain| (scale * gain) as f32).collect() };
        let (direct, steering) = (narrow(seen.scene.los_gain()), narrow(seen.scene.steering_gain()));
        let of_band = seen.users() as f64 / model.budget.bandwidth_hz;
        let min_rate: Vec<f32> = seen.min_rate_bps.iter().map(|rate| (of_band * rate) as f32).collect();
        let true_direct = narrow(future.world.scene().los_gain());
        Self {
            assumed: assumed.collect(),
            to_led: rows.iter().map(|row| std::array::from_fn(|axis| f64::from(row[LED + axis]))).collect(),
            to_mirrors: to_mirrors.collect(),
            true_direct: future.indices.iter().map(|index| true_direct[*index]).collect(),
            crossed: crossed(future, model),
            rows,
            direct,
            steering,
            min_rate,
        }
    }

    /// Number of users.
    pub fn users(&self) -> usize {
        self.rows.len()
    }

    /// Number of mirrors.
    pub fn mirrors(&self) -> usize {
        self.steering.len() / self.users().max(1)
    }
}

fn in_frame(frame: &Frame, vector: &Vec3) -> [f64; 3] {
    let [along, left] = frame.of_room(vector);
    [along, left, vector.z]
}

fn crossed(future: &Future<'_>, model: &ChannelModel) -> Vec<f32> {
    let (seen, truth) = (&future.room.observation().scene, &future.world);
    let (users, mirrors) = (seen.users(), seen.mirrors());
    let scale = truth.model().budget.amplitude_scale();
    let offsets = offsets(future.room.room());
    let mut angles = MirrorAngles::flat(mirrors);
    let mut gains = vec![0.0; truth.users().len() * mirrors];
    let mut table = vec![0.0; users * users * mirrors];
    for target in 0..users {
        decode::aim(model, seen, &vec![target; mirrors], &mut angles);
        angles.roll.iter_mut().zip(&offsets.roll).for_each(|(angle, offset)| *angle += offset);
        angles.yaw.iter_mut().zip(&offsets.yaw).for_each(|(angle, offset)| *angle += offset);
        truth.scene().irs_gain_each(truth.model(), &angles, &mut gains);
        for (user, index) in future.indices.iter().enumerate() {
            let row = &mut table[(user * users + target) * mirrors..][..mirrors];
            let gains = &gains[index * mirrors..][..mirrors];
            row.iter_mut().zip(gains).for_each(|(value, gain)| *value = (scale * gain) as f32);
        }
    }
    table
}

/// The errors of the mirrors' mounting: where they point less what their drives measure, in rad.
fn offsets(room: &SimulatedRoom) -> MirrorAngles {
    let mut all = MirrorAngles { roll: Vec::new(), yaw: Vec::new() };
    for array in 0..room.arrays() {
        let (points, measured) = (room.actuator(array).angles(), room.actuator(array).measured());
        let less = |(points, measured): (&f64, &f64)| points - measured;
        all.roll.extend(points.roll.iter().zip(&measured.roll).map(less));
        all.yaw.extend(points.yaw.iter().zip(&measured.yaw).map(less));
    }
    all
}
