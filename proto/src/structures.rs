//! Structures that the fields of messages consist of.
//!
//! Positions are in m in the room's frame: origin at the centre of the floor, z up. Angles are in
//! rad and mechanical. `structure NAME in LIST` names the fields in refusals after the list that
//! holds the structure, for example `users.position_m`. The order of the fields is the order of
//! their bytes, so it never changes within a version.

use serde::{Deserialize, Serialize};

use crate::codec::{BufferFull, Reader, Writer};
use crate::enumerations::{FaultKind, InputKind};
use crate::error::CodecError;
use crate::fields::{
    Bounds, Place, Value, field_name, implement_value, is_covariance, is_rotation, ordered, same_length,
};
use crate::limits::{MAX_BRANCHES, MAX_MIRRORS, Nanos};

/// Defines structures with public fields, and reads, writes and checks them. Serde gives their fields by name, for
/// other notations than the bytes.
macro_rules! structures {
    ($(
        $(#[$meta:meta])*
        structure $structure:ident $(in $list:ident)? {
            $( $(#[$field_meta:meta])* $field:ident: $type:ty $(where $($rule:ident $(($limit:expr))?)and+)?, )*
        }
        $(requires { $($relation:ident($($of:ident),+)),+ $(,)? })?
    )*) => { $(
        $(#[$meta])*
        #[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct $structure {
            $( $(#[$field_meta])* pub $field: $type, )*
        }

        implement_value!(
            $structure, [$(in $list)?],
            { $( $field [$($($rule $(($limit))?)*)?] )* },
            [$($( $relation($($of),+) )*)?]
        );
    )* };
}

structures! {
    /// Origin, sequence number and time of a message.
    #[derive(Copy, Eq)]
    structure Stamp {
        /// Random id of the publishing instance; it differs after a restart.
        source: u64,
        /// Sequence number of this source on this key, from 1; a gap is a lost message.
        sequence: u64,
        /// Time at which the content was sampled, not sent, in ns.
        time_ns: Nanos,
    }

    /// Position, velocity and required rate of one user, as the tracker measured them.
    #[derive(Copy)]
    structure UserState in users {
        /// Number of the user; it does not change while the user is in the room.
        user: u32,
        /// Position x, y, z of the detector in m.
        position_m: [f32; 3],
        /// Velocity along x and y in m/s; 0 where the tracker does not measure it.
        velocity_m_s: [f32; 2],
        /// Minimum rate that this user requires, in bit/s.
        min_rate_bps: f32 where not_negative,
    }

    /// Measured channel gains and SINR of one user.
    #[derive(Copy)]
    structure UserChannel in users {
        /// Number of the user, as in [`UserState::user`].
        user: u32,
        /// Channel gain of the direct path, dimensionless; 0 when blocked.
        los_gain: f32,
        /// Channel gain over all mirrors, dimensionless.
        irs_gain: f32,
        /// Signal to interference and noise ratio, linear.
        sinr: f32,
    }

    /// Measured channel gains of the branches of one user's receiver.
    structure UserBranches in users {
        /// Number of the user, as in [`UserState::user`].
        user: u32,
        /// Channel gain of the direct path at each branch, dimensionless; 0 when blocked.
        los_gain: Vec<f32> where at_most(MAX_BRANCHES) and not_negative,
        /// Channel gain over all mirrors at each branch, dimensionless.
        irs_gain: Vec<f32> where at_most(MAX_BRANCHES) and not_negative,
    } requires { same_length(irs_gain, los_gain) }

    /// What one user's receiver tells about LEDs.
    #[derive(Copy)]
    structure UserLeds in users {
        /// Number of the user, as in [`UserState::user`].
        user: u32,
        /// Index of the LED that serves the user, in the order of the scenario; none where no direct path
        /// is clear, or where it is unknown.
        serving: Option<u32>,
        /// Whether the receiver measures each LED: it then detects no LED without an entry in `gains`.
        measures_each: bool,
    }

    /// Measured channel gain of the direct path from one LED to one user.
    #[derive(Copy)]
    structure LedGain in gains {
        /// Number of the user, as in [`UserState::user`].
        user: u32,
        /// Index of the LED, in the order of the scenario.
        led: u32,
        /// Channel gain, dimensionless.
        los_gain: f32 where not_negative,
    }

    /// How one user holds the receiver.
    #[derive(Copy)]
    structure UserOrientation in users {
        /// Number of the user, as in [`UserState::user`].
        user: u32,
        /// Rotation from the upright receiver to the receiver as it is held, in the room's frame:
        /// the unit quaternion w + x i + y j + z k.
        quaternion: [f32; 4],
    } requires { is_rotation(quaternion) }

    /// Name of an emergency stop: source and sequence number of its first message.
    #[derive(Copy, Eq, PartialOrd, Ord, Hash)]
    structure StopName in released {
        /// Source of the stop; 0 for a stop without sender.
        source: u64,
        /// Sequence number of the stop; 0 for a stop without sender.
        sequence: u64,
    }

    /// An emergency stop that an array has latched.
    #[derive(Eq)]
    structure LatchedStopReport in stops {
        /// Source of the stop; 0 for a stop without sender.
        source: u64,
        /// Sequence number of the stop; 0 for a stop without sender.
        sequence: u64,
        /// When it arrived at the array, in ns.
        arrived_ns: Nanos,
        /// Name of the operator who sent it.
        operator: String,
        /// Reason for it.
        reason: String,
    }

    /// An upright cylinder that stands on the floor and blocks light.
    #[derive(Copy)]
    structure Obstacle in obstacles {
        /// Position of the axis along x in m.
        x_m: f32,
        /// Position of the axis along y in m.
        y_m: f32,
        /// Radius in m.
        radius_m: f32 where not_negative,
        /// Height above the floor in m.
        height_m: f32 where not_negative,
    }

    /// Counters of the commands that a driver received since its start.
    #[derive(Copy, Eq)]
    structure Counters {
        /// Commands applied.
        accepted: u64,
        /// Accepted commands with at least one angle outside its range, which the driver clamped.
        clipped: u64,
        /// Accepted commands that arrived after the end of validity of the previous one, while the
        /// array held or was parked.
        late: u64,
        /// Commands refused as malformed: undecodable, not finite, or for another number of
        /// mirrors.
        rejected: u64,
        /// Commands refused because a command of a higher epoch was applied before.
        old_epoch: u64,
        /// Commands refused because this sequence number or a later one of the epoch was applied
        /// before.
        old_sequence: u64,
        /// Commands refused because their validity had ended on arrival, or because their time was
        /// later than now by more than [`CLOCK_LEAD_MAX_NS`](crate::CLOCK_LEAD_MAX_NS).
        expired: u64,
        /// Commands refused because an emergency stop is latched.
        stopped: u64,
    }

    /// Distribution of durations in us.
    #[derive(Copy)]
    structure Quantiles {
        /// Number of measurements.
        count: u64,
        /// Median in us.
        p50: f64,
        /// 90th percentile in us.
        p90: f64,
        /// 99th percentile in us.
        p99: f64,
        /// 99.9th percentile in us.
        p999: f64,
        /// Maximum in us.
        max: f64,
    }

    /// True state of one user of a simulated room.
    #[derive(Copy)]
    structure TruthUser in users {
        /// Number of the user.
        user: u32,
        /// Position x, y, z of the detector in m.
        position_m: [f32; 3],
        /// Heading of the user about z in rad, from +x towards +y.
        heading_rad: f32,
        /// Whether the direct path is blocked, for any reason.
        los_blocked: bool,
        /// Whether the scenario or an operator forces the direct path off.
        forced: bool,
        /// Channel gain of the direct path, dimensionless.
        los_gain: f32,
        /// Channel gain over all mirrors, dimensionless.
        irs_gain: f32,
        /// Signal to interference and noise ratio, linear.
        sinr: f32,
        /// Rate in bit/s.
        rate_bps: f32,
        /// Minimum rate that this user requires, in bit/s.
        min_rate_bps: f32 where not_negative,
    }

    /// What a controller believes about one user.
    #[derive(Copy)]
    structure UserBelief in users {
        /// Number of the user, as in [`UserState::user`].
        user: u32,
        /// Position x, y, z of the detector in m.
        position_m: [f32; 3],
        /// Velocity along x and y in m/s.
        velocity_m_s: [f32; 2],
        /// Variance of x in m2.
        xx_m2: f32 where not_negative,
        /// Covariance of x and y in m2.
        xy_m2: f32,
        /// Variance of y in m2.
        yy_m2: f32 where not_negative,
        /// Heading of the user about z in rad, from +x towards +y; meaningless where its certainty
        /// is 0.
        heading_rad: f32,
        /// Length of the mean heading vector, from 0 (unknown) to 1 (certain).
        heading_certainty: f32 where share,
        /// Probability that the direct path is blocked.
        blocked_probability: f32 where share,
    } requires { is_covariance(xy_m2, xx_m2, yy_m2) }

    /// One input of a controller: a message that it handled, or a decision.
    #[derive(Copy, Eq)]
    structure ControllerInput in inputs {
        /// What it is.
        input: InputKind,
        /// Source of the message; 0 for a decision.
        source: u64,
        /// Sequence number of the message; for telemetry of array n, n times 2^56 is added. For a
        /// decision that gave a command, bit n is set if array n got none; else 0.
        sequence: u64,
        /// Time of the controller's clock at which it handled the message or decided, in ns.
        time_ns: Nanos,
        /// Whether the decision gave a command; false for a message.
        command: bool,
    }

    /// Sum rates in bit/s of the same moment for the policy and three references.
    #[derive(Copy)]
    structure SumRates {
        /// Sum rate with the present mirror angles, in bit/s.
        policy: f64,
        /// Sum rate without mirrors, in bit/s.
        no_irs: f64,
        /// Sum rate with all mirrors flat, in bit/s.
        flat: f64,
        /// Sum rate in bit/s with the best angles of the solver, which satisfies minimum rates
        /// first. A policy that leaves a minimum rate unsatisfied can exceed it.
        oracle: f64,
    }

    /// Limits of one axis, the same for every mirror.
    #[derive(Copy)]
    structure AxisLimits {
        /// Smallest mechanical angle in rad.
        min_rad: f32,
        /// Largest mechanical angle in rad.
        max_rad: f32,
        /// Highest angular speed in rad/s; 0 where unknown.
        slew_rad_s: f32 where not_negative,
        /// Settling time after a small step in s; 0 where unknown.
        settling_s: f32 where not_negative,
        /// Smallest step in rad; 0 where unknown.
        resolution_rad: f32 where not_negative,
    } requires { ordered(min_rad, max_rad) }

    /// A fault, and the mirrors that have it.
    structure MirrorFault in faults {
        /// Kind of fault.
        fault: FaultKind,
        /// Duration of [`FaultKind::Offline`] and [`FaultKind::Reboot`], and delay of commands
        /// under [`FaultKind::Late`], in s; ignored by the others.
        seconds: f32 where not_negative,
        /// Share of all mirrors, from 0 to 1, rounded to a number of mirrors; used where `mirrors`
        /// is empty.
        share: f32 where share,
        /// Seed of the draw of that share; the same seed draws the same mirrors.
        seed: u64,
        /// Indices of the mirrors; empty where a share is drawn, or where the fault concerns the
        /// array as a whole.
        mirrors: Vec<u32> where at_most(MAX_MIRRORS),
    }
}

impl LatchedStopReport {
    /// The name of the stop.
    pub fn name(&self) -> StopName {
        StopName { source: self.source, sequence: self.sequence }
    }
}

impl StopName {
    /// Whether it is the other stop, or a later one of its sender, which replaces it.
    pub fn replaces(self, other: Self) -> bool {
        self == other || (self.is_of_sender(other) && self.sequence >= other.sequence)
    }

    /// Whether both are stops of one sender. The stop without sender, 0/0, has none.
    pub fn is_of_sender(self, other: Self) -> bool {
        let has_sender = |name: Self| name != Self::default();
        self.source == other.source && has_sender(self) && has_sender(other)
    }
}

impl std::fmt::Display for StopName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:016x}/{}", self.source, self.sequence)
    }
}

impl Counters {
    /// Number of commands refused, for all reasons.
    pub fn refused(&self) -> u64 {
        let counts = [self.rejected, self.old_epoch, self.old_sequence, self.expired, self.stopped];
        counts.into_iter().fold(0, u64::saturating_add)
    }
}
