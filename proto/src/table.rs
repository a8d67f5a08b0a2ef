//! The table of messages: the only place where a message or one of its fields is written down.
//!
//! Three files expand the table: `kind.rs` to [`Kind`](crate::Kind), `messages.rs` to the structs
//! with their readers, writers and checks, and `keys.rs` to the methods of [`Room`](crate::Room)
//! that give the keys. The order of the fields is the order of their bytes, so it never changes
//! within a version.
//!
//! # How to write a message
//! ```text
//! /// Battery charge of a tracker.
//! message BatteryReport(kind: 23, name: "battery report", key: battery = "battery") {
//!     /// Source, sequence, time of the measurement.
//!     stamp: Stamp,
//!     /// Charge of each cell, from 0 to 1.
//!     charge: Vec<f32> where at_most(MAX_ENTRIES) and share,
//!     /// Capacity of each cell in Wh.
//!     capacity_wh: Vec<f32> where at_most(MAX_ENTRIES) and not_negative,
//! } requires { same_length(capacity_wh, charge) }
//! ```
//! This yields `Kind::BatteryReport`, `struct BatteryReport` with public fields, `encode` and
//! `decode` for it, and `Room::battery()`. CONTRACT.md and the golden bytes in `tests/proto/golden.rs`
//! need their entries too.
//!
//! - The type of a field is a number, a bool, a text, an `Option`, an array, a `Vec`, a pair, or a
//!   type of `structures.rs` or `enumerations.rs`. Every `f32` and `f64` must be finite, every text at most
//!   [`MAX_TEXT`](crate::MAX_TEXT) bytes long. The type implies both rules; `text_at_most` sets
//!   another length.
//! - `where` adds rules for one field: the methods of `Bounds` in `fields.rs`. A `Vec` needs
//!   `at_most`.
//! - `requires` adds rules that involve several fields: functions at the end of `fields.rs`.

/// Calls the macro with the given name on the whole table.
macro_rules! message_table {
    ($expand:ident) => {
        $expand! {
            /// Positions of the users; its arrival completes a tick and triggers a decision.
            message UserReport(kind: 1, name: "user report", key: users = "users") {
                /// Source, sequence, time of the positions.
                stamp: Stamp,
                /// Number of the tick; the command that this report triggers repeats it.
                tick: u64,
                /// The users present.
                users: Vec<UserState> where at_most(MAX_USERS),
            }

            /// Measured channel gains and SINR of the users.
            message ChannelReport(kind: 2, name: "channel report", key: channel = "channel") {
                /// Source, sequence, time of the measurement.
                stamp: Stamp,
                /// Number of the tick of the measurement.
                tick: u64,
                /// One entry for each user.
                users: Vec<UserChannel> where at_most(MAX_USERS),
            }

            /// Obstacles in the room, as far as the tracker knows them.
            message ObstacleReport(kind: 3, name: "obstacle report", key: obstacles = "obstacles") {
                /// Source, sequence, time of the measurement.
                stamp: Stamp,
                /// All known obstacles; they replace those of the previous report.
                obstacles: Vec<Obstacle> where at_most(MAX_OBSTACLES),
            }

            /// Angles for every mirror of the array.
            message MirrorCommand(kind: 4, name: "mirror command", key: command = "mirrors/command") {
                /// Epoch of the sending controller, at least 1. A driver refuses epochs lower than
                /// the highest it applied.
                epoch: u64,
                /// Sequence number within the epoch, from 1.
                sequence: u64,
                /// Tick of the [`UserReport`] that triggered this command; 0 for none.
                answers: u64,
                /// Time at which the controller made the command, in ns.
                time_ns: Nanos,
                /// Duration in ms after `time_ns` for which a driver may apply and then hold the
                /// command.
                validity_ms: u32,
                /// Mechanical roll of each mirror in rad, in index order.
                roll: Vec<f32> where at_most(MAX_MIRRORS),
                /// Mechanical yaw of each mirror in rad, in index order.
                yaw: Vec<f32> where at_most(MAX_MIRRORS),
            } requires { same_length(yaw, roll) }

            /// State and angles of the array, and counters of the commands it received.
            message MirrorTelemetry(kind: 5, name: "mirror telemetry", key: telemetry = "mirrors/telemetry") {
                /// Source, sequence, time at which the driver read the angles.
                stamp: Stamp,
                /// State of the array.
                state: ArrayState,
                /// Epoch of the command last applied; 0 before the first.
                epoch: u64,
                /// Sequence number of the command last applied; 0 before the first.
                applied_sequence: u64,
                /// Tick of the report that triggered the command last applied.
                answers: u64,
                /// Time at which that command arrived, in ns.
                received_ns: Nanos,
                /// Time at which the driver passed that command to the mirrors, in ns.
                applied_ns: Nanos,
                /// Sequence number of the calibration in use; 0 for none.
                calibration: u64,
                /// Bits of [`fault`](crate::messages::fault).
                faults: u32,
                /// Counters of the commands received.
                counters: Counters,
                /// Temperature of the array in degrees Celsius; none where unknown.
                temperature_c: Option<f32>,
                /// Commanded roll after clamping, in rad.
                roll_commanded: Vec<f32> where at_most(MAX_MIRRORS),
                /// Commanded yaw after clamping, in rad.
                yaw_commanded: Vec<f32> where at_most(MAX_MIRRORS),
                /// Measured roll in rad; empty where the hardware does not measure it.
                roll_measured: Vec<f32> where at_most(MAX_MIRRORS),
                /// Measured yaw in rad; empty where the hardware does not measure it.
                yaw_measured: Vec<f32> where at_most(MAX_MIRRORS),
                /// Indices of the mirrors known not to follow commands, ascending.
                unusable: Vec<u32> where at_most(MAX_MIRRORS),
            } requires {
                same_length(yaw_commanded, roll_commanded),
                same_length_or_empty(roll_measured, roll_commanded),
                same_length_or_empty(yaw_measured, roll_commanded),
            }

            /// Status of a process for operators and the command line; no decision depends on it.
            message NodeStatus(kind: 6, name: "node status", key: status(node: NodeKind) = "status/{node}") {
                /// Source, sequence, time.
                stamp: Stamp,
                /// Kind of process.
                node: NodeKind,
                /// Name of the instance.
                name: String,
                /// Version of its software.
                software: String,
                /// Present activity in a few words, for example "running" or "waiting for users".
                state: String,
                /// Hash of the scenario in use; empty for none.
                scenario: String,
                /// Policy in use; empty for none.
                policy: String,
                /// Time at which the process started, in ns.
                started_ns: Nanos,
                /// Counts since the start, by name.
                counters: Vec<(String, u64)> where at_most(MAX_ENTRIES),
                /// Present values, by name; the name ends in the unit.
                gauges: Vec<(String, f64)> where at_most(MAX_ENTRIES),
                /// Distributions since the start in us, by name: `decision`, `loop`, `age` and
                /// stages.
                timings: Vec<(String, Quantiles)> where at_most(MAX_ENTRIES),
                /// The latest problem; empty where there was none.
                last_problem: String,
            }

            /// True state of a simulated room, for viewers only; a controller never reads it.
            message RoomTruth(kind: 7, name: "room truth", key: truth = "truth") {
                /// Source, sequence, time.
                stamp: Stamp,
                /// Number of the tick.
                tick: u64,
                /// The users.
                users: Vec<TruthUser> where at_most(MAX_USERS),
                /// All obstacles, reported or not; the users' bodies are not among them.
                obstacles: Vec<Obstacle> where at_most(MAX_OBSTACLES),
                /// Sum rates of the policy and of three references.
                sum_rate_bps: SumRates,
            }

            /// Properties of an array; a driver announces them at its start, every second, and on
            /// request.
            message Capabilities(kind: 8, name: "capabilities message", key: capabilities = "mirrors/capabilities") {
                /// Source, sequence, time.
                stamp: Stamp,
                /// Maker and model of the hardware.
                hardware: String,
                /// Name and version of the driver.
                driver: String,
                /// Number of rows of mirrors; row 0 is the lowest.
                rows: u32,
                /// Number of columns of mirrors; mirror index = row * columns + column.
                columns: u32,
                /// Limits of roll.
                roll: AxisLimits,
                /// Limits of yaw.
                yaw: AxisLimits,
                /// Whether the hardware measures its angles.
                feedback: Feedback,
                /// Clock from which the driver counts the validity of a command.
                validity_clock: ValidityClock,
                /// Highest rate of commands in Hz; 0 where unknown.
                command_rate_max_hz: f32 where not_negative,
                /// Duration in ms for which the mirrors hold after the end of validity, before they
                /// park.
                park_after_ms: u32,
                /// Roll and yaw of the park position in rad.
                park_rad: [f32; 2],
            } requires { mirrors_within_limit(rows, columns) }

            /// Stops an array, or allows it to move again; the stop is latched until a later
            /// re-arm.
            #[derive(Eq)]
            message EmergencyStop(kind: 9, name: "emergency stop", key: stop = "mirrors/stop") {
                /// Source, sequence, time. A re-arm counts only when its time is later than that of
                /// the last stop.
                stamp: Stamp,
                /// Stop or re-arm.
                action: StopAction,
                /// Name of the operator who sends it.
                operator: String,
                /// Reason for it.
                reason: String,
            }

            /// Corrections for the mounting of each mirror: the device is set to `gain * angle +
            /// offset`.
            message Calibration(kind: 10, name: "calibration", key: calibration = "mirrors/calibration") {
                /// Source, sequence, time; telemetry repeats the sequence number of the calibration
                /// in use.
                stamp: Stamp,
                /// Offset of roll of each mirror in rad.
                roll_offset_rad: Vec<f32> where at_most(MAX_MIRRORS),
                /// Gain of roll of each mirror, dimensionless; 1 changes nothing.
                roll_gain: Vec<f32> where at_most(MAX_MIRRORS),
                /// Offset of yaw of each mirror in rad.
                yaw_offset_rad: Vec<f32> where at_most(MAX_MIRRORS),
                /// Gain of yaw of each mirror, dimensionless; 1 changes nothing.
                yaw_gain: Vec<f32> where at_most(MAX_MIRRORS),
            } requires {
                same_length(roll_gain, roll_offset_rad),
                same_length(yaw_offset_rad, roll_offset_rad),
                same_length(yaw_gain, roll_offset_rad),
            }

            /// A change in a simulated room; absent fields change nothing. A real room has no such
            /// key.
            message SimulatorControl(kind: 11, name: "simulator control", key: simulator_control = "sim/control") {
                /// Source, sequence, time.
                stamp: Stamp,
                /// Number of users, counted from the first, whose direct path is forced off; all
                /// other paths are on.
                forced_users: Option<u32>,
                /// Transmitted optical power in W.
                power_w: Option<f32> where not_negative,
                /// Lowest and highest walking speed in m/s; 0 and 0 make every user stand still.
                speed_m_s: Option<[f32; 2]> where not_negative,
                /// Faults of the mirrors, applied in this order.
                faults: Vec<MirrorFault> where at_most(MAX_ENTRIES),
            }

            /// A change of the policy of a running controller.
            #[derive(Eq)]
            message ControllerControl(
                kind: 12, name: "controller control", key: controller_control = "controller/control"
            ) {
                /// Source, sequence, time.
                stamp: Stamp,
                /// Name of the new policy, as on the controller's command line.
                policy: String,
            }

            /// Releases one emergency stop, which it names; the clocks of operator and array do not
            /// matter.
            #[derive(Eq)]
            message Rearm(kind: 13, name: "re-arm", key: rearm = "mirrors/rearm") {
                /// Source, sequence, time.
                stamp: Stamp,
                /// Source of the stop that it releases, as in the [`SafetyReport`].
                stop_source: u64,
                /// Sequence number of that stop.
                stop_sequence: u64,
                /// Name of the operator who sends it.
                operator: String,
                /// Reason for it.
                reason: String,
            }

            /// The emergency stop in force, and the bounds that the array enforces on commands.
            #[derive(Eq)]
            message SafetyReport(kind: 14, name: "safety report", key: safety = "mirrors/safety") {
                /// Source, sequence, time.
                stamp: Stamp,
                /// Whether a stop is latched.
                stopped: bool,
                /// Source of the latched stop; 0 for none, or where the stop has no sender.
                stop_source: u64,
                /// Sequence number of the latched stop; 0 for none, or where the stop has no sender.
                stop_sequence: u64,
                /// Time at which the latched stop arrived, in ns; 0 for none.
                stopped_ns: Nanos,
                /// Name of the operator who sent the latched stop.
                operator: String,
                /// Reason for the latched stop.
                reason: String,
                /// Highest epoch of an accepted command; 0 before the first.
                epoch: u64,
                /// Longest validity in ms; a command with a longer one is refused.
                validity_max_ms: u32,
                /// Largest lead of an epoch over UTC in ms, or over the highest accepted epoch.
                epoch_lead_max: u64,
                /// Largest difference between the sequence numbers of two accepted commands of an epoch.
                sequence_step_max: u64,
            }

            /// Geometry and channel of a room, by the scenario of the process that publishes it.
            #[derive(Eq)]
            message RoomGeometry(kind: 15, name: "room geometry", key: geometry(node: NodeKind) = "geometry/{node}") {
                /// Source, sequence, time.
                stamp: Stamp,
                /// The tables of a scenario file that describe room, channel, LEDs, array,
                /// receiver, noise, bandwidth and bodies, as TOML.
                scenario: String where text_at_most(MAX_GEOMETRY),
            }

            /// Where the controller believes the users to be, for viewers and recorders.
            message BeliefReport(kind: 16, name: "belief report", key: belief = "controller/belief") {
                /// Source, sequence, time of the decision for which the controller used the belief.
                stamp: Stamp,
                /// Tick of the [`UserReport`] of that decision.
                tick: u64,
                /// Time for which the belief holds, in ns: the middle of the interval in which the
                /// command of that decision is in force.
                holds_ns: Nanos,
                /// The users of that report.
                users: Vec<UserBelief> where at_most(MAX_USERS),
            }

            /// Everything that the later decisions of a controller depend on besides later messages,
            /// for a replay that begins while the controller runs.
            message ControllerMemory(kind: 17, name: "controller memory", key: controller_memory = "controller/memory") {
                /// Source, sequence, time of the decision after which the state holds.
                stamp: Stamp,
                /// Epoch of the controller.
                epoch: u64,
                /// Tick of the [`UserReport`] of that decision.
                tick: u64,
                /// Inputs in the order in which the controller handled them, since the state of the
                /// message with the sequence number before this one.
                inputs: Vec<ControllerInput> where at_most(MAX_INPUTS),
                /// The state, in a format of the controller's software.
                state: Vec<u8> where at_most(MAX_STATE),
            }

            /// How the users hold their receivers, as far as the receivers measure it.
            message OrientationReport(kind: 18, name: "orientation report", key: orientation = "orientation") {
                /// Source, sequence, time of the measurement.
                stamp: Stamp,
                /// One entry for each user whose orientation is known; the controller assumes the others.
                users: Vec<UserOrientation> where at_most(MAX_USERS),
            }

            /// Measured channel gains of each branch of the users' receivers.
            message BranchReport(kind: 19, name: "branch report", key: branches = "branches") {
                /// Source, sequence, time of the measurement.
                stamp: Stamp,
                /// Number of the tick of the measurement.
                tick: u64,
                /// One entry for each user whose receiver reports its branches.
                users: Vec<UserBranches> where at_most(MAX_USERS),
            }

            /// All emergency stops in force at an array, and whether its device has executed them.
            #[derive(Eq)]
            message StopReport(kind: 20, name: "stop report", key: stops = "mirrors/stops") {
                /// Source, sequence, time.
                stamp: Stamp,
                /// Whether the device has executed a stop since the last of these arrived, and still
                /// answers; false without a stop.
                device_stopped: bool,
                /// The stops in force, in the order of their arrival.
                stops: Vec<LatchedStopReport> where at_most(MAX_STOPS),
                /// The names of stops that a re-arm released here, the latest last.
                released: Vec<StopName> where at_most(MAX_STOPS),
                /// Why the device has not executed the stop; where it has, why the stop is not recorded;
                /// empty otherwise.
                problem: String,
            }

            /// A stop that a process holds, again for an array that has not reported it.
            #[derive(Eq)]
            message StopRepetition(
                kind: 21, name: "stop repetition", key: stop_repetition = "mirrors/stop-repetition"
            ) {
                /// Source, sequence, time of the process that repeats the stop.
                stamp: Stamp,
                /// Source of the stop.
                stop_source: u64,
                /// Sequence number of the stop.
                stop_sequence: u64,
                /// Name of the operator who sent the stop.
                operator: String,
                /// Reason for the stop.
                reason: String,
            }

            /// Which LEDs the users' receivers detect.
            message LedReport(kind: 22, name: "LED report", key: leds = "leds") {
                /// Source, sequence, time of the measurement.
                stamp: Stamp,
                /// Number of the tick of the measurement.
                tick: u64,
                /// One entry for each user whose receiver identifies LEDs.
                users: Vec<UserLeds> where at_most(MAX_USERS),
                /// The direct paths from which these receivers detect light.
                gains: Vec<LedGain> where at_most(MAX_LED_GAINS),
            }
        }
    };
}

pub(crate) use message_table;
