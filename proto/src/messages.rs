//! Reports, commands, telemetry, status: what the running system says.
//!
//! Positions are in m in the room's frame (origin at the centre of the floor, z up), angles in rad and mechanical. The order
//! of fields is the order of bytes, so it never changes within a version.

use serde::{Deserialize, Serialize};

use crate::error::CodecError;
use crate::keys::NodeKind;
use crate::{Kind, MAX_TEXT, Nanos};

/// Who says it, how many times they spoke before, and when it was true.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stamp {
    /// Random id of the publishing instance; another after a restart.
    pub source: u64,
    /// Counts up by one with each message of this source on this key, from 1; a gap is a lost message.
    pub sequence: u64,
    /// When the content was sampled (not when it was sent).
    pub time_ns: Nanos,
}

/// One user as a tracker sees them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct UserState {
    /// Which user; the same number as long as they are in the room.
    pub user: u32,
    /// Where the detector is: x, y, z in m.
    pub position_m: [f32; 3],
    /// How the user moves along x and y in m/s; 0 where the tracker cannot tell.
    pub velocity_m_s: [f32; 2],
    /// The rate that this user needs in bit/s.
    pub min_rate_bps: f32,
}

/// Where the users are. The arrival of this report completes a tick and asks for a decision.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct UserReport {
    /// Source, sequence, time of the positions.
    pub stamp: Stamp,
    /// Number of the tick; a command names the tick that it answers.
    pub tick: u64,
    /// The users present.
    pub users: Vec<UserState>,
}

impl UserReport {
    /// Whether the report is about so many users.
    ///
    /// # Errors
    /// [`CodecError::WrongUsers`].
    pub fn check_users(&self, wanted: usize) -> Result<(), CodecError> {
        check_users(Kind::UserReport, self.users.len(), wanted)
    }
}

/// The light that one user receives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct UserChannel {
    /// Which user, as in [`UserState::user`].
    pub user: u32,
    /// Gain of the direct path, 0 when blocked; dimensionless.
    pub los_gain: f32,
    /// Gain over all mirrors; dimensionless.
    pub irs_gain: f32,
    /// Signal to noise and interference, linear.
    pub sinr: f32,
}

/// What light the users receive, as measured.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ChannelReport {
    /// Source, sequence, time of the measurement.
    pub stamp: Stamp,
    /// The tick in which it was measured.
    pub tick: u64,
    /// One entry a user.
    pub users: Vec<UserChannel>,
}

impl ChannelReport {
    /// Whether the report is about so many users.
    ///
    /// # Errors
    /// [`CodecError::WrongUsers`].
    pub fn check_users(&self, wanted: usize) -> Result<(), CodecError> {
        check_users(Kind::ChannelReport, self.users.len(), wanted)
    }
}

/// An upright cylinder that stands on the floor and stops light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Obstacle {
    /// Axis, x in m.
    pub x_m: f32,
    /// Axis, y in m.
    pub y_m: f32,
    /// Radius in m.
    pub radius_m: f32,
    /// Height above the floor in m.
    pub height_m: f32,
}

/// What stands in the room, as far as it is known.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ObstacleReport {
    /// Source, sequence, time.
    pub stamp: Stamp,
    /// All known obstacles; replaces those of the report before.
    pub obstacles: Vec<Obstacle>,
}

/// How the whole array is to turn.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MirrorCommand {
    /// Reign of the controller that sends it, at least 1; a driver that has followed a higher one refuses it.
    pub epoch: u64,
    /// Counts up from 1 within the epoch.
    pub sequence: u64,
    /// The tick of the [`UserReport`] that this command answers; 0 for none.
    pub answers: u64,
    /// When the command was made.
    pub time_ns: Nanos,
    /// How long after `time_ns` it may be applied and then held, in ms.
    pub validity_ms: u32,
    /// Roll of each mirror in rad, mechanical, in index order.
    pub roll: Vec<f32>,
    /// Yaw of each mirror in rad, mechanical, in index order; as many as `roll`.
    pub yaw: Vec<f32>,
}

impl MirrorCommand {
    /// Whether the command is for an array of so many mirrors.
    ///
    /// # Errors
    /// [`CodecError::WrongMirrors`].
    pub fn check_mirrors(&self, wanted: usize) -> Result<(), CodecError> {
        check_mirrors(Kind::MirrorCommand, self.roll.len(), wanted)
    }

    /// When the command stops being valid: from this moment on it is neither applied nor followed.
    pub fn expires_ns(&self) -> Nanos {
        self.time_ns.saturating_add(u64::from(self.validity_ms) * 1_000_000)
    }
}

/// What the array is doing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum ArrayState {
    /// At the park position: nothing commanded yet, or silence was too long.
    #[default]
    Parked,
    /// Turning to, or standing at, a command that is still valid.
    Following,
    /// The last command is no longer valid; the mirrors stay where they are for a while.
    Holding,
    /// An emergency stop is latched; commands are refused until it is re-armed.
    Stopped,
    /// The hardware cannot follow; the fault bits say why.
    Fault,
}

/// Bits of [`MirrorTelemetry::faults`].
pub mod fault {
    /// The device does not answer.
    pub const LINK: u32 = 1;
    /// At least one mirror does not follow; see [`unusable`](super::MirrorTelemetry::unusable).
    pub const MIRROR: u32 = 1 << 1;
    /// Too hot, or too cold.
    pub const TEMPERATURE: u32 = 1 << 2;
    /// Supply or drive voltage outside its range.
    pub const SUPPLY: u32 = 1 << 3;
    /// Calibration is missing or was refused.
    pub const CALIBRATION: u32 = 1 << 4;
    /// The driver's clock and the controller's differ by more than a command's validity.
    pub const CLOCK: u32 = 1 << 5;
}

/// What became of the commands that a driver received since it started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counters {
    /// Applied.
    pub accepted: u64,
    /// Of those, with at least one angle outside the range, which was clamped.
    pub clipped: u64,
    /// Of those accepted, came after the validity of the one before had run out: the array was holding or parked meanwhile.
    pub late: u64,
    /// Refused as malformed: undecodable, non-finite, or for another number of mirrors.
    pub rejected: u64,
    /// Refused because a command of a higher epoch was followed before.
    pub old_epoch: u64,
    /// Refused because this sequence or a later one of the epoch was followed before.
    pub old_sequence: u64,
    /// Refused because the validity had ended on arrival, or the command is from the future by more than
    /// [`CLOCK_LEAD_MAX_NS`](crate::CLOCK_LEAD_MAX_NS).
    pub expired: u64,
    /// Refused because an emergency stop is latched.
    pub stopped: u64,
}

impl Counters {
    /// All commands refused, whatever the reason.
    pub fn refused(&self) -> u64 {
        self.rejected + self.old_epoch + self.old_sequence + self.expired + self.stopped
    }
}

/// What the array does and has done.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MirrorTelemetry {
    /// Source, sequence, time at which the angles were read.
    pub stamp: Stamp,
    /// What the array is doing.
    pub state: ArrayState,
    /// Epoch of the command last applied; 0 before the first.
    pub epoch: u64,
    /// Sequence of the command last applied; 0 before the first.
    pub applied_sequence: u64,
    /// The tick that it answers.
    pub answers: u64,
    /// When it arrived.
    pub received_ns: Nanos,
    /// When it was handed to the mirrors.
    pub applied_ns: Nanos,
    /// Sequence of the calibration in use; 0 for none.
    pub calibration: u64,
    /// Bits of [`fault`].
    pub faults: u32,
    /// What became of the commands received.
    pub counters: Counters,
    /// Temperature of the array in degrees Celsius, where known.
    pub temperature_c: Option<f32>,
    /// Roll as commanded and clamped, rad; what the mirrors are asked to do.
    pub roll_commanded: Vec<f32>,
    /// Yaw as commanded and clamped, rad.
    pub yaw_commanded: Vec<f32>,
    /// Roll as measured, rad; empty where the hardware does not measure it.
    pub roll_measured: Vec<f32>,
    /// Yaw as measured, rad; empty where the hardware does not measure it.
    pub yaw_measured: Vec<f32>,
    /// Indices of the mirrors known not to follow, ascending.
    pub unusable: Vec<u32>,
}

impl MirrorTelemetry {
    /// Whether the telemetry is of an array of so many mirrors.
    ///
    /// # Errors
    /// [`CodecError::WrongMirrors`].
    pub fn check_mirrors(&self, wanted: usize) -> Result<(), CodecError> {
        check_mirrors(Kind::MirrorTelemetry, self.roll_commanded.len(), wanted)
    }
}

/// A distribution of times in us.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Quantiles {
    /// How many were measured.
    pub count: u64,
    /// Median.
    pub p50: f64,
    /// 90th percentile.
    pub p90: f64,
    /// 99th percentile.
    pub p99: f64,
    /// 99.9th percentile.
    pub p999: f64,
    /// Largest.
    pub max: f64,
}

/// How a process is doing, for people and for `demo`; nothing is decided by it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct NodeStatus {
    /// Source, sequence, time.
    pub stamp: Stamp,
    /// What sort of process.
    pub node: NodeKind,
    /// Name of the instance.
    pub name: String,
    /// Version of its software.
    pub software: String,
    /// What it is doing, in a word: "running", "waiting for users".
    pub state: String,
    /// Hash of the scenario that it works on; empty for none.
    pub scenario: String,
    /// Policy in use; empty where there is none.
    pub policy: String,
    /// When it started.
    pub started_ns: Nanos,
    /// Counts since the start, by name.
    pub counters: Vec<(String, u64)>,
    /// Present values, by name, with the unit in the name.
    pub gauges: Vec<(String, f64)>,
    /// Distributions since the start in us, by name: `decision`, `loop`, `age` and stages.
    pub timings: Vec<(String, Quantiles)>,
    /// The last thing that went wrong; empty while nothing did.
    pub last_problem: String,
}

impl NodeStatus {
    /// Notes what went wrong, cut to what a message may hold.
    pub fn set_problem(&mut self, problem: &str) {
        let end = (0..=problem.len().min(MAX_TEXT)).rev().find(|at| problem.is_char_boundary(*at)).unwrap_or(0);
        self.last_problem.clear();
        self.last_problem.push_str(&problem[..end]);
    }
}

/// One user as the simulator knows them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TruthUser {
    /// Which user.
    pub user: u32,
    /// Where the detector is: x, y, z in m.
    pub position_m: [f32; 3],
    /// Where the user faces, in rad about z from +x towards +y.
    pub heading_rad: f32,
    /// Whether the direct path is blocked, by whatever.
    pub los_blocked: bool,
    /// Whether it is off by order of the scenario.
    pub forced: bool,
    /// Gain of the direct path.
    pub los_gain: f32,
    /// Gain over all mirrors.
    pub irs_gain: f32,
    /// Signal to noise and interference, linear.
    pub sinr: f32,
    /// Rate in bit/s.
    pub rate_bps: f32,
    /// The rate that this user needs in bit/s.
    pub min_rate_bps: f32,
}

/// Sum rate in bit/s of the same moment under four hands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SumRates {
    /// As the mirrors stand.
    pub policy: f64,
    /// Without mirrors.
    pub no_irs: f64,
    /// With all mirrors flat.
    pub flat: f64,
    /// With the best angles that the solver finds, minimum rates first: a policy that lets a need go may exceed it.
    pub oracle: f64,
}

/// The simulated room as it is, for viewers only: a controller never reads it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RoomTruth {
    /// Source, sequence, time.
    pub stamp: Stamp,
    /// Number of the tick.
    pub tick: u64,
    /// The users.
    pub users: Vec<TruthUser>,
    /// What stands in the room, reported or not; without the users' bodies.
    pub obstacles: Vec<Obstacle>,
    /// What the policy gives, and what others would.
    pub sum_rate_bps: SumRates,
}

pub(crate) fn check_mirrors(kind: Kind, found: usize, wanted: usize) -> Result<(), CodecError> {
    if found == wanted { Ok(()) } else { Err(CodecError::WrongMirrors { kind, found, wanted }) }
}

fn check_users(kind: Kind, found: usize, wanted: usize) -> Result<(), CodecError> {
    if found == wanted { Ok(()) } else { Err(CodecError::WrongUsers { kind, found, wanted }) }
}
