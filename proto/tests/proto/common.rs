//! One short message of each kind; CONTRACT.md shows the same ones.

use heliostat_proto::*;

/// 2026-01-02 03:04:05 UTC and 678 ms.
pub const TIME_NS: Nanos = 1_767_323_045_678_000_000;

pub fn stamp() -> Stamp {
    Stamp { source: 0x1234_5678_9abc_def0, sequence: 300, time_ns: TIME_NS }
}

pub fn user_report() -> UserReport {
    let user =
        UserState { user: 3, position_m: [1.5, -0.25, 0.85], velocity_m_s: [0.5, -1.0], min_rate_bps: 1_000_000.0 };
    UserReport { stamp: stamp(), tick: 1000, users: vec![user] }
}

pub fn channel_report() -> ChannelReport {
    let user = UserChannel { user: 3, los_gain: 0.0, irs_gain: 1.25e-6, sinr: 42.5 };
    ChannelReport { stamp: stamp(), tick: 1000, users: vec![user] }
}

pub fn obstacle_report() -> ObstacleReport {
    ObstacleReport { stamp: stamp(), obstacles: vec![obstacle()] }
}

pub fn obstacle() -> Obstacle {
    Obstacle { x_m: -1.0, y_m: 2.0, radius_m: 0.25, height_m: 1.75 }
}

pub fn mirror_command() -> MirrorCommand {
    MirrorCommand {
        epoch: 7,
        sequence: 300,
        answers: 1000,
        time_ns: TIME_NS,
        validity_ms: 200,
        roll: vec![0.125, -0.5],
        yaw: vec![0.0, 0.25],
    }
}

pub fn mirror_telemetry() -> MirrorTelemetry {
    MirrorTelemetry {
        stamp: stamp(),
        state: ArrayState::Following,
        epoch: 7,
        applied_sequence: 300,
        answers: 1000,
        received_ns: TIME_NS + 1_000_000,
        applied_ns: TIME_NS + 1_500_000,
        calibration: 2,
        faults: messages::fault::MIRROR,
        counters: Counters {
            accepted: 299,
            clipped: 4,
            late: 1,
            rejected: 2,
            old_epoch: 0,
            old_sequence: 5,
            expired: 6,
            stopped: 0,
        },
        temperature_c: Some(36.5),
        roll_commanded: vec![0.125, -0.5],
        yaw_commanded: vec![0.0, 0.25],
        roll_measured: vec![0.125, -0.375],
        yaw_measured: vec![],
        unusable: vec![1],
    }
}

pub fn node_status() -> NodeStatus {
    NodeStatus {
        stamp: stamp(),
        node: NodeKind::SimNode,
        name: "room A".into(),
        software: "0.1.0".into(),
        state: "running".into(),
        scenario: "c0ffee".into(),
        policy: String::new(),
        started_ns: TIME_NS,
        counters: vec![("ticks".into(), 1000)],
        gauges: vec![("speed_m_s".into(), 1.5)],
        timings: vec![(
            "loop".into(),
            Quantiles { count: 2, p50: 100.0, p90: 150.0, p99: 150.0, p999: 150.0, max: 150.0 },
        )],
        last_problem: "µ".into(),
    }
}

pub fn room_truth() -> RoomTruth {
    let user = TruthUser {
        user: 3,
        position_m: [1.5, -0.25, 0.85],
        heading_rad: 0.5,
        los_blocked: true,
        forced: false,
        los_gain: 0.0,
        irs_gain: 1.25e-6,
        sinr: 42.5,
        rate_bps: 2.5e6,
        min_rate_bps: 1_000_000.0,
    };
    RoomTruth {
        stamp: stamp(),
        tick: 1000,
        users: vec![user],
        obstacles: vec![obstacle()],
        sum_rate_bps: SumRates { policy: 2.5e6, no_irs: 0.0, flat: 1e6, oracle: 2.5e6 },
    }
}

pub fn capabilities() -> Capabilities {
    let axis = AxisLimits {
        min_rad: -0.25,
        max_rad: 0.25,
        slew_rad_s: 8.0,
        settling_s: 0.0078125,
        resolution_rad: 0.00012207031,
    };
    Capabilities {
        stamp: stamp(),
        hardware: "Lab tip-tilt 2".into(),
        driver: "lab 1.0".into(),
        rows: 1,
        columns: 2,
        roll: axis,
        yaw: AxisLimits { min_rad: -0.5, max_rad: 0.5, ..axis },
        feedback: Feedback::ClosedLoop,
        validity_clock: ValidityClock::Arrival,
        command_rate_max_hz: 1000.0,
        park_after_ms: 2000,
        park_rad: [0.0, 0.0],
    }
}

pub fn emergency_stop() -> EmergencyStop {
    EmergencyStop { stamp: stamp(), action: StopAction::Rearm, operator: "ann".into(), reason: "clear".into() }
}

pub fn calibration() -> Calibration {
    Calibration {
        stamp: stamp(),
        roll_offset_rad: vec![0.015625, 0.0],
        roll_gain: vec![1.0, 1.03125],
        yaw_offset_rad: vec![0.0, -0.015625],
        yaw_gain: vec![1.0, 1.0],
    }
}

pub fn simulator_control() -> SimulatorControl {
    let fault = MirrorFault { fault: FaultKind::DeadYaw, seconds: 0.5, share: 0.25, seed: 300, mirrors: vec![1, 300] };
    SimulatorControl {
        stamp: stamp(),
        forced_users: Some(2),
        power_w: None,
        speed_m_s: Some([0.25, 1.5]),
        faults: vec![fault],
    }
}

pub fn controller_control() -> ControllerControl {
    ControllerControl { stamp: stamp(), policy: "fixed-point".into() }
}

pub fn rearm() -> Rearm {
    Rearm {
        stamp: stamp(),
        stop_source: 0x1234_5678_9abc_def0,
        stop_sequence: 300,
        operator: "ann".into(),
        reason: "clear".into(),
    }
}

pub fn safety_report() -> SafetyReport {
    SafetyReport {
        stamp: stamp(),
        stopped: true,
        stop_source: 0x1234_5678_9abc_def0,
        stop_sequence: 300,
        stopped_ns: 1_767_323_045_678_000_000,
        operator: "ann".into(),
        reason: "test".into(),
        epoch: 7,
        validity_max_ms: 10_000,
        epoch_lead_max: 60_000,
        sequence_step_max: 1_000_000,
    }
}

pub fn room_geometry() -> RoomGeometry {
    RoomGeometry { stamp: stamp(), scenario: "[room]\nheight_m = 2.5\n".into() }
}

pub fn belief_report() -> BeliefReport {
    let user = UserBelief {
        user: 3,
        position_m: [1.5, -0.25, 0.85],
        velocity_m_s: [0.5, -1.0],
        xx_m2: 0.0625,
        xy_m2: -0.03125,
        yy_m2: 0.125,
        heading_rad: -0.5,
        heading_certainty: 0.75,
        blocked_probability: 0.25,
    };
    BeliefReport { stamp: stamp(), tick: 1000, holds_ns: TIME_NS + 15_000_000, users: vec![user] }
}

pub fn controller_memory() -> ControllerMemory {
    let report = ControllerInput {
        input: InputKind::Users,
        source: 0x1234_5678_9abc_def0,
        sequence: 300,
        time_ns: TIME_NS,
        command: false,
    };
    let decision =
        ControllerInput { input: InputKind::Decision, time_ns: TIME_NS, command: true, ..ControllerInput::default() };
    ControllerMemory { stamp: stamp(), epoch: 7, tick: 1000, inputs: vec![report, decision], state: vec![1, 2, 255] }
}

pub fn orientation_report() -> OrientationReport {
    let user = UserOrientation { user: 3, quaternion: [0.5, -0.5, 0.5, 0.5] };
    OrientationReport { stamp: stamp(), users: vec![user] }
}

pub fn branch_report() -> BranchReport {
    let user = UserBranches { user: 3, los_gain: vec![0.0, 0.25], irs_gain: vec![0.5, 0.125] };
    BranchReport { stamp: stamp(), tick: 1000, users: vec![user] }
}

pub fn stop_report() -> StopReport {
    let stop = LatchedStopReport {
        source: 0x1234_5678_9abc_def0,
        sequence: 300,
        arrived_ns: TIME_NS,
        operator: "ann".into(),
        reason: "test".into(),
    };
    let released = vec![StopName { source: 7, sequence: 1 }];
    StopReport { stamp: stamp(), device_stopped: false, stops: vec![stop], released, problem: "no link".into() }
}

pub fn stop_repetition() -> StopRepetition {
    StopRepetition { stamp: stamp(), stop_source: 7, stop_sequence: 1, operator: "ann".into(), reason: "test".into() }
}

pub fn led_report() -> LedReport {
    let user = UserLeds { user: 3, serving: Some(1), measures_each: true };
    let users = vec![user, UserLeds { user: 4, serving: Some(0), measures_each: false }];
    let gains = [(0, 0.25), (1, 0.5)].map(|(led, los_gain)| LedGain { user: 3, led, los_gain });
    LedReport { stamp: stamp(), tick: 1000, users, gains: gains.to_vec() }
}

pub fn encoded<T: Message>(message: &T) -> Vec<u8> {
    let mut payload = Vec::new();
    encode(message, &mut payload).expect("the sample is valid");
    payload
}

/// Calls the macro with the given name on every message and the function of its sample, in the order of the kinds.
macro_rules! each_message {
    ($expand:ident) => {
        $expand! {
            UserReport user_report,
            ChannelReport channel_report,
            ObstacleReport obstacle_report,
            MirrorCommand mirror_command,
            MirrorTelemetry mirror_telemetry,
            NodeStatus node_status,
            RoomTruth room_truth,
            Capabilities capabilities,
            EmergencyStop emergency_stop,
            Calibration calibration,
            SimulatorControl simulator_control,
            ControllerControl controller_control,
            Rearm rearm,
            SafetyReport safety_report,
            RoomGeometry room_geometry,
            BeliefReport belief_report,
            ControllerMemory controller_memory,
            OrientationReport orientation_report,
            BranchReport branch_report,
            StopReport stop_report,
            StopRepetition stop_repetition,
            LedReport led_report,
        }
    };
}

pub(crate) use each_message;

/// The payload of every sample, with the name of its kind.
pub fn payloads() -> Vec<(&'static str, Vec<u8>)> {
    macro_rules! samples {
        ($($message:ident $sample:ident,)*) => { vec![$(($message::KIND.name(), encoded(&$sample()))),*] };
    }
    each_message!(samples)
}

pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

pub fn unhex(text: &str) -> Vec<u8> {
    let byte = |at: usize| u8::from_str_radix(&text[at..at + 2], 16).expect("hexadecimal digits");
    (0..text.len()).step_by(2).map(byte).collect()
}

/// Why a payload does not decode.
pub fn refusal<T: Message + std::fmt::Debug>(payload: &[u8]) -> CodecError {
    decode::<T>(payload).expect_err("this payload is invalid")
}

/// Why a payload does not decode as a message of this kind.
pub fn any_refusal(kind: Kind, payload: &[u8]) -> Option<CodecError> {
    macro_rules! of_kind {
        ($($message:ident $sample:ident,)*) => {
            match kind { $(Kind::$message => decode::<$message>(payload).err(),)* }
        };
    }
    each_message!(of_kind)
}

/// The payload with the four bytes at an offset replaced by those of a number.
pub fn with_f32(mut payload: Vec<u8>, at: usize, value: f32) -> Vec<u8> {
    payload[at..at + 4].copy_from_slice(&value.to_le_bytes());
    payload
}
