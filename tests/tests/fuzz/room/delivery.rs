//! Which process of the room receives a payload, and what follows from it.

use heliostat_array::content::Content;
use heliostat_array::moment::Moment;
use heliostat_array::refusal_counts::RefusalCounts;
use heliostat_core::core::{Decision, Due, Timing, memory::Memory};
use heliostat_core::inbox::Message as Report;
use heliostat_core::refusal::{Refusal, Stream};
use heliostat_proto::*;
use heliostat_room::control;
use heliostat_scenario::Scenario;

use super::{Room, setup};

impl Room {
    /// Delivers the payload on the key of a kind to every process that subscribes to it.
    pub(super) fn deliver(&mut self, kind: Kind) {
        let payload = std::mem::take(&mut self.payload);
        let is_decoded = match kind {
            Kind::UserReport => self.report::<UserReport>(Stream::Users, &payload, |report| Report::Users(report)),
            Kind::ChannelReport => {
                self.report::<ChannelReport>(Stream::Channel, &payload, |report| Report::Channel(report))
            }
            Kind::ObstacleReport => {
                self.report::<ObstacleReport>(Stream::Obstacles, &payload, |report| Report::Obstacles(report))
            }
            Kind::OrientationReport => {
                self.report::<OrientationReport>(Stream::Orientation, &payload, |report| Report::Orientation(report))
            }
            Kind::LedReport => self.report::<LedReport>(Stream::Leds, &payload, |report| Report::Leds(report)),
            Kind::MirrorTelemetry => {
                self.report::<MirrorTelemetry>(Stream::Telemetry, &payload, |report| Report::Telemetry(0, report))
            }
            Kind::MirrorCommand => self.array(decode(&payload), Content::Command),
            Kind::EmergencyStop => {
                let order = decode::<EmergencyStop>(&payload);
                if let Ok(order) = &order {
                    self.controller.handle_stop_order(self.room_ns, order);
                }
                self.array(order, Content::Stop)
            }
            Kind::Calibration => self.array(decode(&payload), Content::Calibration),
            Kind::Capabilities => consume(&payload, |capabilities: Capabilities| {
                let verdict = setup().examiner.examine(0, &capabilities);
                _ = self.controller.handle_capabilities(0, &capabilities, verdict);
            }),
            Kind::SimulatorControl => consume(&payload, |order: SimulatorControl| {
                drop(control::apply(&mut self.simulated, &order));
            }),
            Kind::NodeStatus => consume(&payload, |_: NodeStatus| {}),
            Kind::RoomTruth => consume(&payload, |_: RoomTruth| {}),
            Kind::ControllerControl => consume(&payload, |_: ControllerControl| {}),
            Kind::BeliefReport => consume(&payload, |_: BeliefReport| {}),
            Kind::BranchReport => consume(&payload, |_: BranchReport| {}),
            Kind::ControllerMemory => consume(&payload, |memory: ControllerMemory| {
                drop(Memory::from_bytes(&memory.state));
            }),
            Kind::RoomGeometry => consume(&payload, |report: RoomGeometry| {
                drop(Scenario::from_geometry_toml(&report.scenario));
            }),
            Kind::Rearm => self.array(decode(&payload), Content::Rearm),
            Kind::StopRepetition => self.array(decode(&payload), Content::Repetition),
            Kind::StopReport => consume(&payload, |report: StopReport| {
                self.controller.handle_stops(0, &report);
            }),
            Kind::SafetyReport => consume(&payload, |report: SafetyReport| {
                self.controller.handle_safety(0, &report);
            }),
        };
        self.tally.count(kind, is_decoded);
        self.payload = payload;
    }

    /// Passes a report to the controller, and its command to the arrays; returns whether it could
    /// be decoded.
    fn report<T: Message>(
        &mut self,
        stream: Stream,
        payload: &[u8],
        wrap: impl for<'a> Fn(&'a mut T) -> Report<'a>,
    ) -> bool {
        let (now, controller) = (self.room_ns, &mut self.controller);
        let mut report = match decode::<T>(payload) {
            Ok(report) => report,
            Err(error) => {
                controller.handle_malformed((stream, 0), Refusal::from(&error), payload);
                return false;
            }
        };
        let decision = match controller.handle_message(now, wrap(&mut report)) {
            Due::Command => controller.poll_command(now, Timing::InTime, &mut |_| {}),
            Due::StaleCommand => controller.poll_stale_command(now),
            Due::Nothing => return true,
        };
        if encode_command(decision, &mut self.sequence_sent, &mut self.encoded) {
            self.send_command();
        }
        true
    }

    /// Passes a message to both arrays; returns whether it could be decoded.
    fn array<T>(&mut self, message: Result<T, CodecError>, wrap: fn(Result<T, CodecError>) -> Content) -> bool {
        let is_decoded = message.is_ok();
        let content = wrap(message);
        let now = self.now();
        let simulated = Moment { local_ns: self.simulated_ns(), ..now };
        drop(self.simulated.handle(0, (simulated, simulated), content.clone(), &mut RefusalCounts::default()));
        self.checked(|room| drop(room.kit.handle((now, now), content, &mut room.refused)));
        is_decoded
    }

    /// The controller acts where reports are absent.
    pub(super) fn poll_timeout(&mut self) {
        let decision = self.controller.poll_timeout_command(self.room_ns);
        if decision.is_some_and(|decision| encode_command(decision, &mut self.sequence_sent, &mut self.encoded)) {
            self.send_command();
        }
    }

    /// Sends the encoded command.
    fn send_command(&mut self) {
        let command = decode(&self.encoded);
        self.array(command, Content::Command);
    }
}

/// Decodes a payload for a subscriber; returns whether it could be decoded.
fn consume<T: Message>(payload: &[u8], handle: impl FnOnce(T)) -> bool {
    decode(payload).map(handle).is_ok()
}

/// Encodes the command of a decision; returns whether it has one.
///
/// It must be valid for every driver.
fn encode_command(decision: Decision<'_>, sequence: &mut u64, encoded: &mut Vec<u8>) -> bool {
    let Decision::Move { command, .. } = decision else { return false };
    *sequence = command.sequence;
    encode(command, encoded).expect("a decided command is valid");
    let range_rad = setup().scenario.control.range_deg.to_radians();
    for angle in command.roll.iter().chain(&command.yaw) {
        assert!(f64::from(angle.abs()) <= range_rad, "{angle} rad is beyond the range of the scenario");
    }
    true
}
