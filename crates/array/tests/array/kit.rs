//! The kit around a device: stops, re-arms, calibrations and the safety report.

use heliostat_array::bounds::Bounds;
use heliostat_array::calibration::{OFFSET_MAX_RAD, Unfit};
use heliostat_array::content::Content;
use heliostat_array::latch::LatchedStop;
use heliostat_array::moment::Moment;
use heliostat_array::refusal_counts::RefusalCounts;
use heliostat_array::rules::RearmRefusal;
use heliostat_array::{Device, DeviceError, Kit};
use heliostat_channel::MirrorAngles;
use heliostat_proto::messages::fault;
use heliostat_proto::{
    ArrayState, AxisLimits, Calibration, Capabilities, CodecError, EmergencyStop, Feedback, Kind, MirrorCommand, Rearm,
    Stamp, StopAction,
};

use crate::at;

/// One mirror that is always at the angle of its drive, and the calls that it received.
#[derive(Default)]
struct Mirror {
    angles: Option<MirrorAngles>,
    stops: u32,
    /// It does not connect, and does not turn.
    is_broken: bool,
    /// It connects, and does not measure.
    is_blind: bool,
    /// It executes a stop later, on a thread of its own.
    is_slow: bool,
    /// What it measures in place of its angles.
    measured: Option<MirrorAngles>,
}

impl Device for Mirror {
    fn capabilities(&self) -> Capabilities {
        let axis = AxisLimits { min_rad: -0.5, max_rad: 0.5, ..AxisLimits::default() };
        let feedback = Feedback::ClosedLoop;
        Capabilities { rows: 1, columns: 1, roll: axis, yaw: axis, feedback, ..Capabilities::default() }
    }

    fn travel_rad(&self) -> [[f64; 2]; 2] {
        [[-2.0, 2.0]; 2]
    }

    fn connect(&mut self, _now: Moment) -> Result<(), DeviceError> {
        if self.is_broken { Err(DeviceError::new("mirror", "broken")) } else { Ok(()) }
    }

    fn apply(&mut self, now: Moment, angles: &MirrorAngles) -> Result<(), DeviceError> {
        self.connect(now)?;
        self.angles = Some(angles.clone());
        Ok(())
    }

    fn measure(&mut self, _now: Moment, into: &mut MirrorAngles) -> Result<bool, DeviceError> {
        if let Some(angles) = self.measured.as_ref().or(self.angles.as_ref()) {
            into.clone_from(angles);
        }
        if self.is_blind { Err(DeviceError::new("mirror", "blind")) } else { Ok(true) }
    }

    fn stop(&mut self, _now: Moment) -> Result<(), DeviceError> {
        self.stops += 1;
        Ok(())
    }

    fn has_stopped(&mut self) -> Result<bool, DeviceError> {
        Ok(!self.is_slow)
    }
}

fn following() -> Kit<Mirror> {
    let mut kit = Kit::new(Mirror::default());
    kit.advance(at(0));
    let angles = vec![0.25];
    let command = MirrorCommand {
        epoch: 3,
        sequence: 1,
        time_ns: at(0).room_ns,
        validity_ms: 200,
        roll: angles.clone(),
        yaw: angles,
        answers: 1,
    };
    kit.handle_command(at(0), &command).unwrap();
    kit
}

fn stop(sequence: u64) -> EmergencyStop {
    let stamp = Stamp { source: 7, sequence, time_ns: at(1).room_ns };
    EmergencyStop { stamp, action: StopAction::Stop, operator: "ann".into(), reason: "smoke".into() }
}

#[test]
fn the_safety_report_names_the_latched_stop_and_the_bounds() {
    let mut kit = following();
    let stamp = Stamp { source: 1, sequence: 2, time_ns: 3 };
    let armed = kit.safety(stamp);
    assert!(!armed.stopped && armed.stamp == stamp && armed.operator.is_empty(), "{armed:?}");
    let bounds = Bounds::default();
    assert_eq!(
        (armed.validity_max_ms, armed.epoch_lead_max, armed.sequence_step_max, armed.epoch),
        (bounds.validity_max_ms, bounds.epoch_lead_max, bounds.sequence_step_max, 3)
    );
    kit.handle_stop(at(5), &stop(1)).unwrap();
    kit.handle_stop(at(6), &stop(2)).unwrap();
    let stopped = kit.safety(stamp);
    assert!(stopped.stopped, "{stopped:?}");
    assert_eq!((stopped.stop_source, stopped.stop_sequence, stopped.stopped_ns), (7, 2, at(6).room_ns));
    assert_eq!((stopped.operator.as_str(), stopped.reason.as_str()), ("ann", "smoke"));
}

#[test]
fn a_device_that_connects_to_a_stopped_array_is_stopped_and_receives_no_angles() {
    let mut kit = Kit::new(Mirror::default());
    kit.stop(at(0), LatchedStop::without_sender("the last state is unknown", at(0).room_ns));
    kit.advance(at(0));
    assert_eq!((kit.connections(), kit.device().stops, kit.device().angles.is_none()), (1, 2, true));
    assert_eq!(kit.telemetry(at(1), Stamp::default()).state, ArrayState::Stopped);
    kit.handle_rearm(at(2), &Rearm::default()).unwrap();
    assert!(kit.device().angles.is_some(), "the device parks");
}

#[test]
fn a_stop_before_the_connection_is_obeyed_without_a_turn_of_the_mirrors() {
    let mut kit = Kit::new(Mirror::default());
    kit.handle_stop(at(0), &stop(1)).unwrap();
    kit.advance(at(1));
    assert_eq!(kit.connections(), 1);
    assert!(kit.device().stops >= 1 && kit.device().angles.is_none(), "the device is stopped and not turned");
}

#[test]
fn a_stop_goes_to_a_device_in_every_state_of_its_link() {
    let mut kit = Kit::new(Mirror { is_broken: true, ..Mirror::default() });
    kit.advance(at(0));
    kit.handle_stop(at(1), &stop(1)).unwrap();
    assert_eq!((kit.connections(), kit.device().stops), (0, 1), "it is written to a device that did not connect");
    let report = kit.stops(Stamp::default());
    assert_eq!((report.device_stopped, report.stops.len()), (false, 1));
    assert!(report.problem.contains("broken"), "{report:?}");
    assert_eq!(kit.telemetry(at(1), Stamp::default()).faults & fault::STOP, fault::STOP);
    kit.device_mut().is_broken = false;
    kit.advance(at(1));
    assert_eq!((kit.connections(), kit.device().stops), (1, 2), "again when the link returns, without a pause");
    let report = kit.stops(Stamp::default());
    assert!(report.device_stopped && report.problem.is_empty(), "{report:?}");
    assert_eq!(kit.telemetry(at(2), Stamp::default()).faults & fault::STOP, 0);
}

/// The first connection within this time, in ms, of a device that is measured each 10 ms.
fn connected_again_after_ms(kit: &mut Kit<Mirror>, from_ms: u64) -> u64 {
    let before = kit.connections();
    let connected = (from_ms..from_ms + 20_000).step_by(10).find(|ms| {
        kit.advance(at(*ms));
        let is_connected = kit.connections() > before;
        kit.telemetry(at(*ms), Stamp::default());
        is_connected
    });
    connected.expect("a connection") - from_ms
}

#[test]
fn pauses_grow_while_a_device_connects_and_then_fails_and_shrink_after_it_has_worked() {
    let mut kit = Kit::new(Mirror { is_blind: true, ..Mirror::default() });
    let mut now_ms = 0;
    let mut pauses_ms = Vec::new();
    for _ in 0..9 {
        let pause_ms = connected_again_after_ms(&mut kit, now_ms);
        now_ms += pause_ms;
        pauses_ms.push(pause_ms);
    }
    assert_eq!(pauses_ms, [0, 100, 200, 400, 800, 1600, 3200, 5000, 5000]);
    kit.device_mut().is_blind = false;
    now_ms += connected_again_after_ms(&mut kit, now_ms);
    kit.device_mut().is_blind = true;
    kit.telemetry(at(now_ms + 1000), Stamp::default());
    assert_eq!(connected_again_after_ms(&mut kit, now_ms + 1000), 100);
}

#[test]
fn a_stop_is_latched_before_its_device_has_executed_it() {
    let mut kit = following();
    kit.device_mut().is_slow = true;
    kit.handle_stop(at(1), &stop(1)).unwrap();
    assert_eq!((kit.array().state(), kit.device_stopped()), (ArrayState::Stopped, false));
    kit.advance(at(2));
    assert!(!kit.device_stopped());
    kit.device_mut().is_slow = false;
    kit.advance(at(3));
    assert!(kit.device_stopped());
    kit.handle_stop(at(4), &stop(1)).unwrap();
    assert!(kit.device_stopped(), "a stop that arrives again is executed again, and changes no report");
    kit.device_mut().is_slow = true;
    kit.handle_stop(at(5), &stop(2)).unwrap();
    assert!(!kit.device_stopped(), "another stop has to be executed");
    kit.device_mut().is_slow = false;
    kit.advance(at(6));
    kit.handle_rearm(at(7), &Rearm { stop_source: 7, stop_sequence: 2, ..Rearm::default() }).unwrap();
    let released = kit.stops(Stamp::default());
    assert!(!released.device_stopped && released.stops.is_empty() && released.released.len() == 1, "{released:?}");
}

#[test]
fn a_calibration_that_is_set_before_the_first_step_does_not_reach_the_device() {
    let mut kit = Kit::new(Mirror::default());
    kit.set_calibration(&calibration(1, 1.0, 0.01)).unwrap();
    assert!(kit.connections() == 0 && kit.device().angles.is_none());
    kit.stop(at(0), LatchedStop::default());
    kit.advance(at(1));
    assert!(kit.device().angles.is_none(), "an array that starts stopped does not turn");
    kit.handle_rearm(at(2), &Rearm::default()).unwrap();
    assert!((kit.device().angles.as_ref().expect("the device parks").roll[0] - 0.01).abs() < 1e-6);
}

#[test]
fn a_calibration_of_a_stopped_array_turns_no_mirror_and_makes_none_unusable() {
    let mut kit = following();
    kit.handle_stop(at(1), &stop(1)).unwrap();
    let rested = kit.device().angles.clone();
    kit.handle_calibration(at(2), &calibration(1, 1.0, 0.1)).unwrap();
    for check in 0..20 {
        let telemetry = kit.telemetry(at(10 + 50 * check), Stamp::default());
        assert!(telemetry.unusable.is_empty(), "after {check} checks");
    }
    assert_eq!(kit.device().angles, rested);
}

#[test]
fn a_stop_that_finds_mirrors_elsewhere_than_measured_makes_none_unusable() {
    let mut kit = following();
    kit.handle_stop(at(1), &stop(1)).unwrap();
    // The measurement of the stop was an earlier one.
    kit.device_mut().measured = Some(MirrorAngles { roll: vec![0.1], yaw: vec![0.1] });
    for check in 0..20 {
        assert!(kit.telemetry(at(10 + 50 * check), Stamp::default()).unusable.is_empty(), "after {check} checks");
    }
    kit.handle_rearm(at(1100), &Rearm { stop_source: 7, stop_sequence: 1, ..Rearm::default() }).unwrap();
    let released: Vec<_> =
        (0..20).map(|check| kit.telemetry(at(1110 + 50 * check), Stamp::default()).unusable).collect();
    assert_eq!(released[19], [0], "a released array is checked");
}

#[test]
fn refused_rearms_are_counted_by_name() {
    let (mut kit, mut refused) = (following(), RefusalCounts::default());
    let unnamed = EmergencyStop { action: StopAction::Rearm, ..stop(1) };
    let named = |stop_sequence| Rearm { stop_source: 7, stop_sequence, ..Rearm::default() };
    kit.handle((at(1), at(1)), Content::Rearm(Ok(named(1))), &mut refused);
    kit.handle((at(2), at(2)), Content::Stop(Ok(stop(1))), &mut refused);
    kit.handle((at(3), at(3)), Content::Stop(Ok(unnamed.clone())), &mut refused);
    kit.handle((at(4), at(4)), Content::Rearm(Ok(named(2))), &mut refused);
    kit.handle(
        (at(5), at(5)),
        Content::Rearm(Err(CodecError::Truncated { kind: Kind::Rearm, field: "stamp" })),
        &mut refused,
    );
    kit.refuse_unnamed_rearm(true);
    let late = EmergencyStop { stamp: Stamp { time_ns: at(9).room_ns, ..unnamed.stamp }, ..unnamed };
    assert_eq!(kit.handle_stop(at(6), &late), Err(RearmRefusal::Unnamed));
    kit.handle((at(6), at(6)), Content::Stop(Ok(late.clone())), &mut refused);
    let counts = ["rearm:not-stopped", "rearm:too-early", "rearm:other-stop", "rearm:truncated", "rearm:unnamed"];
    assert!(counts.iter().all(|name| refused.counts().get(*name) == Some(&1)), "{:?}", refused.counts());
    assert_eq!(kit.array().state(), ArrayState::Stopped);
    kit.refuse_unnamed_rearm(false);
    kit.handle((at(7), at(7)), Content::Stop(Ok(late)), &mut refused);
    assert_eq!(kit.array().state(), ArrayState::Parked, "without authentication a re-arm of kind 9 counts");
}

#[test]
fn a_command_in_flight_at_a_stop_or_a_takeover_is_no_problem_and_a_later_one_is() {
    let command = |epoch, ms: u64| MirrorCommand {
        epoch,
        sequence: 2,
        time_ns: at(ms).room_ns,
        validity_ms: 200,
        roll: vec![0.25],
        yaw: vec![0.25],
        answers: 1,
    };
    for name in ["command:stopped", "command:lower-epoch"] {
        let (mut kit, mut refused) = (following(), RefusalCounts::default());
        if name == "command:stopped" {
            kit.handle_stop(at(1000), &stop(1)).unwrap();
        } else {
            kit.handle_command(at(1000), &command(4, 1000)).unwrap();
        }
        for ms in [1001, 1499] {
            assert!(!kit.follow((at(ms), at(ms)), &command(3, ms), &mut refused), "{name} at {ms} ms");
        }
        assert_eq!((refused.counts()[name], refused.problems(), refused.last_problem()), (2, 0, ""));
        assert!(!kit.follow((at(1500), at(1500)), &command(3, 1500), &mut refused));
        assert_eq!((refused.counts()[name], refused.problems()), (3, 1));
        assert!(refused.last_problem().starts_with("command: "), "{}", refused.last_problem());
    }
}

fn calibration(sequence: u64, gain: f32, offset_rad: f64) -> Calibration {
    Calibration {
        stamp: Stamp { source: 7, sequence, time_ns: 0 },
        roll_offset_rad: vec![offset_rad as f32],
        roll_gain: vec![gain],
        yaw_offset_rad: vec![0.0],
        yaw_gain: vec![1.0],
    }
}

#[test]
fn a_calibration_beyond_its_bounds_is_refused_and_turns_no_mirror() {
    let mut kit = following();
    let before = kit.device().angles.clone();
    let mut refused = RefusalCounts::default();
    for (index, gain) in [1e-38, 0.499, 2.001, 1e30, -1.0, 0.0].into_iter().enumerate() {
        let message = calibration(1 + index as u64, gain, 0.0);
        assert!(matches!(kit.handle_calibration(at(1), &message), Err(Unfit::Gain { .. })), "{gain}");
        kit.handle((at(1), at(1)), Content::Calibration(Ok(message)), &mut refused);
    }
    for offset_rad in [0.21, -0.21, 1.5] {
        let message = calibration(9, 1.0, offset_rad);
        assert!(matches!(kit.handle_calibration(at(1), &message), Err(Unfit::Offset { .. })), "{offset_rad}");
        kit.handle((at(1), at(1)), Content::Calibration(Ok(message)), &mut refused);
    }
    assert_eq!((refused.counts()["calibration:gain"], refused.counts()["calibration:offset"]), (6, 3));
    let telemetry = kit.telemetry(at(2), Stamp::default());
    assert_eq!((telemetry.faults & fault::CALIBRATION, telemetry.calibration), (fault::CALIBRATION, 0));
    assert_eq!(kit.device().angles, before);
    for (index, (gain, offset_rad)) in
        [(0.5, OFFSET_MAX_RAD), (2.0, -OFFSET_MAX_RAD), (1.0, 0.0)].into_iter().enumerate()
    {
        kit.handle_calibration(at(3), &calibration(10 + index as u64, gain, offset_rad)).unwrap();
        let device = f64::from(gain) * 0.25 + offset_rad;
        assert!((kit.device().angles.as_ref().unwrap().roll[0] - device).abs() < 1e-6);
        let measured = kit.telemetry(at(4), Stamp::default()).roll_measured[0];
        assert!((measured - 0.25).abs() < 1e-6, "measured angles compare with commanded ones: {measured}");
    }
}
