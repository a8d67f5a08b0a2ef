//! Payloads of every kind as an attacker sends them: raw bytes, altered examples of CONTRACT.md,
//! and well-formed messages with hostile numbers.

use std::sync::LazyLock;

use heliostat_proto::*;

use crate::script::Script;

/// The complete messages that CONTRACT.md shows, by kind.
static EXAMPLES: LazyLock<Vec<(Kind, Vec<u8>)>> = LazyLock::new(|| {
    let contract = include_str!("../../../CONTRACT.md");
    let blocks = contract.split("```text\n").skip(1).map(|rest| rest.split("```").next().unwrap_or_default());
    let digits = blocks.map(|block| block.split_whitespace().collect::<String>());
    let bytes = digits.map(|digits| {
        let byte = |at: usize| u8::from_str_radix(&digits[at..at + 2], 16).expect("hexadecimal digits");
        (0..digits.len()).step_by(2).map(byte).collect::<Vec<u8>>()
    });
    let examples: Vec<_> = bytes.map(|bytes| (codec::kind_of(&bytes).expect("a header"), bytes)).collect();
    assert_eq!(examples.len(), Kind::ALL.len(), "CONTRACT.md shows one message of each kind");
    examples
});

/// Values that the next genuine message would have.
#[derive(Clone, Copy, Debug, Default)]
pub struct Genuine {
    pub source: u64,
    pub sequence: u64,
    pub time_ns: Nanos,
    pub epoch: u64,
    pub tick: u64,
    /// Source and sequence of the latched stop.
    pub stop: (u64, u64),
}

/// The example of a kind in CONTRACT.md.
pub fn example(kind: Kind) -> &'static [u8] {
    &EXAMPLES.iter().find(|(found, _)| *found == kind).expect("one of each kind").1
}

/// The example of a kind, decoded.
pub fn example_of<T: Message>() -> T {
    decode(example(T::KIND)).expect("the example is valid")
}

/// Writes one payload of a kind.
pub fn write(script: &mut Script<'_>, kind: Kind, genuine: &Genuine, out: &mut Vec<u8>) {
    let how = script.below(8);
    if how == 0 {
        out.clear();
        out.extend([VERSION, kind.number()]);
        let length = script.below(64);
        out.extend_from_slice(script.take(length));
        return;
    }
    if how <= 2 || !Forge::new(script, *genuine).write(kind, out) {
        out.clear();
        out.extend_from_slice(example(kind));
        script.edit_bytes(out);
    } else if how == 3 {
        script.edit_bytes(out);
    }
}

/// How many numbers of a message are hostile.
#[derive(Clone, Copy, Debug)]
enum Mood {
    /// None: the message continues the genuine stream.
    Genuine,
    /// One, after this many others.
    One(usize),
    /// A quarter.
    Quarter,
}

struct Forge<'s, 'a> {
    script: &'s mut Script<'a>,
    genuine: Genuine,
    mood: Mood,
}

impl<'s, 'a> Forge<'s, 'a> {
    fn new(script: &'s mut Script<'a>, genuine: Genuine) -> Self {
        let mood = match script.below(4) {
            0 => Mood::Genuine,
            1 | 2 => Mood::One(script.below(12)),
            _ => Mood::Quarter,
        };
        Self { script, genuine, mood }
    }

    /// Writes a message of a kind; false if the contract forbids it, so that no sender encodes it.
    fn write(&mut self, kind: Kind, out: &mut Vec<u8>) -> bool {
        match kind {
            Kind::UserReport => encode(&self.users(), out),
            Kind::ChannelReport => encode(&self.channel(), out),
            Kind::ObstacleReport => encode(&self.obstacles(), out),
            Kind::OrientationReport => encode(&self.orientation(), out),
            Kind::LedReport => encode(&LedReport { stamp: self.stamp(), ..example_of() }, out),
            Kind::BranchReport => encode(&BranchReport { stamp: self.stamp(), ..example_of() }, out),
            Kind::MirrorCommand => encode(&self.command(), out),
            Kind::MirrorTelemetry => encode(&self.telemetry(), out),
            Kind::NodeStatus => encode(&NodeStatus { stamp: self.stamp(), ..example_of() }, out),
            Kind::RoomTruth => encode(&RoomTruth { stamp: self.stamp(), ..example_of() }, out),
            Kind::Capabilities => encode(&self.capabilities(), out),
            Kind::EmergencyStop => encode(&self.stop(), out),
            Kind::Calibration => encode(&self.calibration(), out),
            Kind::SimulatorControl => encode(&self.simulator_control(), out),
            Kind::ControllerControl => encode(&self.controller_control(), out),
            Kind::Rearm => encode(&self.rearm(), out),
            Kind::SafetyReport => encode(&self.safety(), out),
            Kind::StopReport => encode(&StopReport { stamp: self.stamp(), ..example_of() }, out),
            Kind::StopRepetition => encode(&StopRepetition { stamp: self.stamp(), ..example_of() }, out),
            Kind::RoomGeometry => encode(&self.geometry(), out),
            Kind::BeliefReport => encode(&self.belief(), out),
            Kind::ControllerMemory => encode(&self.memory(), out),
        }
        .is_ok()
    }

    fn is_hostile(&mut self) -> bool {
        match &mut self.mood {
            Mood::Genuine => false,
            Mood::One(0) => {
                self.mood = Mood::Genuine;
                true
            }
            Mood::One(others) => {
                *others -= 1;
                false
            }
            Mood::Quarter => self.script.one_in(4),
        }
    }

    fn whole(&mut self, genuine: u64) -> u64 {
        if !self.is_hostile() {
            return genuine;
        }
        match self.script.below(10) {
            0 => 0,
            1 => u64::MAX,
            2 => u64::MAX - 1,
            3 => genuine.wrapping_add(1),
            4 => genuine.wrapping_sub(1),
            5 => genuine.wrapping_add(3_600_000_000_000),
            6 => genuine.wrapping_sub(3_600_000_000_000),
            7 => genuine.wrapping_add(1_000_000),
            8 => 1 << self.script.below(64),
            _ => self.script.word(),
        }
    }

    fn short(&mut self, genuine: u32) -> u32 {
        let value = self.whole(u64::from(genuine));
        // The largest number of the shorter type is as hostile as that of the longer one.
        if value >= u64::MAX - 1 { u32::MAX } else { value as u32 }
    }

    fn real(&mut self, genuine: f32) -> f32 {
        if !self.is_hostile() {
            return genuine;
        }
        let value = match self.script.below(12) {
            0 => 0.0,
            1 => -genuine,
            2 => 1e38,
            3 => -1e38,
            4 => f32::MAX,
            5 => f32::MIN_POSITIVE / 4.0,
            6 => 1e-38,
            7 => 1e9,
            8 => genuine + 1.0,
            9 => genuine * 1e3,
            10 => -0.0,
            _ => f32::from_bits(self.script.word() as u32),
        };
        if value.is_finite() { value } else { f32::MAX }
    }

    fn reals(&mut self, genuine: f32, count: usize) -> Vec<f32> {
        (0..count).map(|_| self.real(genuine)).collect()
    }

    fn count(&mut self, genuine: usize) -> usize {
        if self.is_hostile() { [0, 1, 2, 3, 64, 65, 300][self.script.below(7)] } else { genuine }
    }

    fn text(&mut self, genuine: &str) -> String {
        if !self.is_hostile() {
            return genuine.into();
        }
        let hostile = ["", "\0", "\u{1b}[2J\u{1b}]0;x\u{7}", "<script>alert(1)</script>", "\u{202e}abc", "fixed-point"];
        match self.script.below(7) {
            6 => "x".repeat(MAX_TEXT),
            which => hostile[which].into(),
        }
    }

    fn stamp(&mut self) -> Stamp {
        let Genuine { source, sequence, time_ns, .. } = self.genuine;
        Stamp { source: self.whole(source), sequence: self.whole(sequence), time_ns: self.whole(time_ns) }
    }

    fn users(&mut self) -> UserReport {
        let genuine = example_of::<UserReport>().users[0];
        let (stamp, tick, count) = (self.stamp(), self.whole(self.genuine.tick), self.count(1));
        let mut user = || UserState {
            user: self.short(genuine.user),
            position_m: genuine.position_m.map(|value| self.real(value)),
            velocity_m_s: genuine.velocity_m_s.map(|value| self.real(value)),
            min_rate_bps: self.real(genuine.min_rate_bps),
        };
        UserReport { stamp, tick, users: (0..count).map(|_| user()).collect() }
    }

    fn channel(&mut self) -> ChannelReport {
        let genuine = example_of::<ChannelReport>().users[0];
        let (stamp, tick, count) = (self.stamp(), self.whole(self.genuine.tick), self.count(1));
        let mut user = || UserChannel {
            user: self.short(genuine.user),
            los_gain: self.real(1e-6),
            irs_gain: self.real(genuine.irs_gain),
            sinr: self.real(genuine.sinr),
        };
        ChannelReport { stamp, tick, users: (0..count).map(|_| user()).collect() }
    }

    fn obstacles(&mut self) -> ObstacleReport {
        let (stamp, count) = (self.stamp(), self.count(1));
        let mut obstacle = || Obstacle {
            x_m: self.real(-1.0),
            y_m: self.real(2.0),
            radius_m: self.real(0.25),
            height_m: self.real(1.75),
        };
        ObstacleReport { stamp, obstacles: (0..count).map(|_| obstacle()).collect() }
    }

    fn orientation(&mut self) -> OrientationReport {
        let genuine = example_of::<OrientationReport>().users[0];
        let (stamp, count) = (self.stamp(), self.count(1));
        let mut user = || UserOrientation {
            user: self.short(genuine.user),
            quaternion: genuine.quaternion.map(|value| self.real(value)),
        };
        OrientationReport { stamp, users: (0..count).map(|_| user()).collect() }
    }

    fn command(&mut self) -> MirrorCommand {
        let Genuine { sequence, time_ns, epoch, tick, .. } = self.genuine;
        let (epoch, sequence) = (self.whole(epoch), self.whole(sequence));
        let (answers, time_ns, validity_ms) = (self.whole(tick), self.whole(time_ns), self.short(200));
        let count = self.count(2);
        let (roll, yaw) = (self.reals(0.1, count), self.reals(-0.1, count));
        MirrorCommand { epoch, sequence, answers, time_ns, validity_ms, roll, yaw }
    }

    fn telemetry(&mut self) -> MirrorTelemetry {
        let Genuine { sequence, time_ns, epoch, .. } = self.genuine;
        let stamp = self.stamp();
        let states = [ArrayState::Parked, ArrayState::Following, ArrayState::Holding, ArrayState::Stopped];
        let state = if self.is_hostile() { ArrayState::Fault } else { states[self.script.below(4)] };
        let count = self.count(2);
        let unusable = self.count(0).min(count);
        MirrorTelemetry {
            stamp,
            state,
            epoch: self.whole(epoch),
            applied_sequence: self.whole(sequence),
            received_ns: self.whole(time_ns),
            counters: Counters { accepted: self.whole(300), rejected: self.whole(0), ..Counters::default() },
            temperature_c: Some(self.real(36.5)),
            roll_commanded: self.reals(0.1, count),
            yaw_commanded: self.reals(0.1, count),
            roll_measured: self.reals(0.1, count),
            yaw_measured: Vec::new(),
            unusable: (0..unusable).map(|mirror| self.short(mirror as u32)).collect(),
            ..example_of()
        }
    }

    fn axis(&mut self) -> AxisLimits {
        AxisLimits {
            min_rad: self.real(-1.5),
            max_rad: self.real(1.5),
            slew_rad_s: self.real(8.0),
            settling_s: self.real(0.01),
            resolution_rad: self.real(0.001),
        }
    }

    fn capabilities(&mut self) -> Capabilities {
        Capabilities {
            stamp: self.stamp(),
            hardware: self.text("Lab tip-tilt 2"),
            rows: self.short(1),
            columns: self.short(2),
            roll: self.axis(),
            yaw: self.axis(),
            command_rate_max_hz: self.real(1000.0),
            park_after_ms: self.short(2000),
            park_rad: [self.real(0.0), self.real(0.0)],
            ..example_of()
        }
    }

    fn stop(&mut self) -> EmergencyStop {
        let action = if self.script.one_in(4) { StopAction::Rearm } else { StopAction::Stop };
        EmergencyStop { stamp: self.stamp(), action, operator: self.text("ann"), reason: self.text("test") }
    }

    fn rearm(&mut self) -> Rearm {
        let (stop_source, stop_sequence) = self.genuine.stop;
        Rearm {
            stamp: self.stamp(),
            stop_source: self.whole(stop_source),
            stop_sequence: self.whole(stop_sequence),
            operator: self.text("ann"),
            reason: self.text("clear"),
        }
    }

    fn safety(&mut self) -> SafetyReport {
        SafetyReport {
            stamp: self.stamp(),
            stopped: self.is_hostile(),
            stop_source: self.whole(0),
            stop_sequence: self.whole(0),
            epoch: self.whole(self.genuine.epoch),
            validity_max_ms: self.short(10_000),
            epoch_lead_max: self.whole(60_000),
            sequence_step_max: self.whole(1_000_000),
            ..example_of()
        }
    }

    fn geometry(&mut self) -> RoomGeometry {
        RoomGeometry { stamp: self.stamp(), scenario: self.text("[room]\nheight_m = 2.5\n") }
    }

    fn belief(&mut self) -> BeliefReport {
        let genuine = example_of::<BeliefReport>();
        let (stamp, tick, holds_ns) = (self.stamp(), self.whole(self.genuine.tick), self.whole(genuine.holds_ns));
        let count = self.count(1);
        let users = (0..count).map(|_| UserBelief { xx_m2: self.real(1.0), ..genuine.users[0] }).collect();
        BeliefReport { stamp, tick, holds_ns, users }
    }

    fn memory(&mut self) -> ControllerMemory {
        let (stamp, epoch, state) = (self.stamp(), self.whole(self.genuine.epoch), self.text("\u{1}"));
        ControllerMemory { stamp, epoch, state: state.into_bytes(), ..example_of() }
    }

    fn calibration(&mut self) -> Calibration {
        let stamp = self.stamp();
        let count = self.count(2);
        Calibration {
            stamp,
            roll_offset_rad: self.reals(0.01, count),
            roll_gain: self.reals(1.0, count),
            yaw_offset_rad: self.reals(-0.01, count),
            yaw_gain: self.reals(1.0, count),
        }
    }

    fn simulator_control(&mut self) -> SimulatorControl {
        let some = self.script.byte();
        let stamp = self.stamp();
        let mirrors = self.count(1);
        let fault = MirrorFault {
            fault: example_of::<SimulatorControl>().faults[0].fault,
            seconds: self.real(0.01),
            share: self.real(0.25),
            seed: self.whole(300),
            mirrors: (0..mirrors).map(|mirror| self.short(mirror as u32)).collect(),
        };
        let faults = [
            FaultKind::Healed,
            FaultKind::Stuck,
            FaultKind::DeadRoll,
            FaultKind::FlippedYaw,
            FaultKind::Offline,
            FaultKind::Late,
            FaultKind::Reboot,
        ];
        let fault = MirrorFault { fault: faults[self.script.below(faults.len())], ..fault };
        SimulatorControl {
            stamp,
            forced_users: (some & 1 > 0).then(|| self.short(1)),
            power_w: (some & 2 > 0).then(|| self.real(1.0)),
            speed_m_s: (some & 4 > 0).then(|| [self.real(0.5), self.real(1.0)]),
            faults: if some & 8 > 0 { vec![fault] } else { Vec::new() },
        }
    }

    fn controller_control(&mut self) -> ControllerControl {
        ControllerControl { stamp: self.stamp(), policy: self.text("nearest") }
    }
}
