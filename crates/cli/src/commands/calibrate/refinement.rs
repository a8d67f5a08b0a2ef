//! A refinement on the live room: what it starts from, the angles that the calibrated array understands, and
//! when it commands.

use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use heliostat_array::calibration_file::{AxisCorrections, CalibrationFile};
use heliostat_calibrate::{Log, Session, Stage};
use heliostat_channel::MirrorAngles;
use heliostat_proto::{AxisLimits, Capabilities, Nanos, UserReport};
use heliostat_service::clock::utc_ns;
use heliostat_service::exit::UnusableInput;
use heliostat_service::output::note;

use super::LOOK_EVERY;
use super::idle::{Cause, Idle};
use super::room::LiveRoom;

/// Longest wait for the telemetry that confirms the last readings: three messages of an array.
const CONFIRMED_WITHIN: Duration = Duration::from_millis(300);

/// The refinement of the calibration in use.
pub struct Refinement {
    idle: Idle,
    /// Where the mirrors were taken last.
    taken_at: Option<Stage>,
    former: Log,
    /// The calibration that the array used while the former readings were made.
    measured_with: CalibrationFile,
    in_use: CalibrationFile,
    /// From angles of the former readings to those that the array understands now.
    turn: CalibrationFile,
}

impl Refinement {
    /// A refinement by the holder of the receiver.
    ///
    /// # Errors
    /// [`UnusableInput`]: readings that were made with a calibration of another array.
    pub fn new(
        receiver: u32,
        (former, measured_with): (Log, Option<CalibrationFile>),
        in_use: &CalibrationFile,
    ) -> Result<Self> {
        let CalibrationFile { rows, columns, .. } = *in_use;
        let none = || AxisCorrections::none(rows * columns);
        let measured_with =
            measured_with.unwrap_or_else(|| CalibrationFile { rows, columns, roll: none(), yaw: none() });
        if (measured_with.rows, measured_with.columns) != (rows, columns) {
            return Err(UnusableInput::new(format!(
                "the readings of --refine are of {} x {} mirrors: expected {rows} x {columns}, as in --base",
                measured_with.rows, measured_with.columns
            ))
            .into());
        }
        let turn = in_use.in_place_of(&measured_with);
        Ok(Self { idle: Idle::new(receiver), taken_at: None, former, measured_with, in_use: in_use.clone(), turn })
    }

    /// The calibration with which the readings of the session are made.
    pub fn measured_with(&self) -> &CalibrationFile {
        &self.measured_with
    }

    /// Brings a session to the state after the complete calibration.
    ///
    /// # Errors
    /// Readings of another array, or that do not give the corrections in use.
    pub fn start(&self, session: &mut Session) -> Result<()> {
        let corrections = self.measured_with.in_place_of(&self.in_use);
        session.refine(self.former.clone(), &corrections).context("--refine and --base")
    }

    /// The angles that turn the calibrated array as `angles` turned it during the former readings.
    pub fn turned(&self, mut angles: MirrorAngles) -> MirrorAngles {
        let CalibrationFile { roll, yaw, .. } = &self.turn;
        for (angles, by) in [(&mut angles.roll, roll), (&mut angles.yaw, yaw)] {
            for (angle, (gain, offset_deg)) in angles.iter_mut().zip(by.gain.iter().zip(&by.offset_deg)) {
                *angle = gain * *angle + offset_deg.to_radians();
            }
        }
        angles
    }

    /// The capabilities with the range that every mirror reaches by [`turned`](Self::turned).
    pub fn capabilities(&self, mut capabilities: Capabilities) -> Capabilities {
        let narrowed = |limits: &mut AxisLimits, by: &AxisCorrections| {
            let ends = by.gain.iter().zip(&by.offset_deg).map(|(gain, offset_deg)| {
                [limits.min_rad, limits.max_rad].map(|end| (f64::from(end) - offset_deg.to_radians()) / gain)
            });
            let narrow = |[low, high]: [f64; 2], [min, max]: [f64; 2]| [low.max(min), high.min(max)];
            let [low, high] = ends.fold([f64::NEG_INFINITY, f64::INFINITY], narrow);
            (limits.min_rad, limits.max_rad) = (low as f32, high as f32);
        };
        narrowed(&mut capabilities.roll, &self.turn.roll);
        narrowed(&mut capabilities.yaw, &self.turn.yaw);
        capabilities
    }

    /// Notes who was in the room when a report arrived.
    pub fn handle_users(&mut self, at: Instant, report: &UserReport) {
        self.idle.handle_users(at, report.users.iter().map(|user| user.user));
    }

    /// Takes the lead while the room is idle and the session has something to measure, and gives it back
    /// when another user enters, or when another controller has taken it. `at` is the time up to which the reports
    /// were handled.
    ///
    /// # Errors
    /// An array that does not accept the lead.
    pub fn take_turns(&mut self, at: Instant, session: &mut Session, room: &mut LiveRoom) -> Result<()> {
        if room.has_other_calibration() {
            self.idle.interrupt(Cause::Calibration);
        } else if room.has_lost_lead() {
            self.idle.interrupt(Cause::Controller);
        }
        let (in_use, stands) = (self.idle.cause(at), is_at_spot(session));
        if (in_use.is_none() && stands) == room.is_commanding() {
            return Ok(());
        }
        if !room.is_commanding() {
            session.handle_pause(room.confirmed_ns());
            note("the room is idle: the calibration commands the mirrors");
            self.taken_at = Some(session.stage());
            return room.take();
        }
        session.handle_pause(confirmed_ns(in_use, utc_ns(), || room.confirmed_ns()));
        room.release();
        note(format_args!("the mirrors are given back: {}", reason(in_use, self.taken_at, session.stage())));
        Ok(())
    }

    /// Why the room is in use, while the session could measure if it were idle.
    pub fn waits_for(&mut self, at: Instant, session: &Session) -> Option<Cause> {
        self.idle.cause(at).filter(|_| is_at_spot(session))
    }
}

/// Until when telemetry confirms the readings, as `shown_ns` says. While the room is idle the mirrors are kept until
/// it confirms those up to `now`.
fn confirmed_ns(in_use: Option<Cause>, now: Nanos, shown_ns: impl Fn() -> Nanos) -> Nanos {
    let begun = Instant::now();
    while in_use.is_none() && shown_ns() < now && begun.elapsed() < CONFIRMED_WITHIN {
        std::thread::sleep(LOOK_EVERY);
    }
    shown_ns()
}

/// Why the mirrors that were taken at one stage are given back at another one.
fn reason(in_use: Option<Cause>, taken_at: Option<Stage>, stage: Stage) -> String {
    match (in_use, taken_at, stage) {
        (Some(cause), ..) => cause.to_string(),
        (None, _, Stage::Ended) => "the readings are complete".into(),
        (None, Some(Stage::Dark(from) | Stage::Probe(from) | Stage::Locate(from)), Stage::Await(place))
            if place != from =>
        {
            format!("spot {} is complete", from + 1)
        }
        _ => "the receiver has left its place".into(),
    }
}

fn is_at_spot(session: &Session) -> bool {
    !matches!(session.stage(), Stage::Await(_) | Stage::Ended)
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    #[test]
    fn the_reason_of_a_return_is_the_one_that_holds() {
        let taken = Some(Stage::Dark(1));
        for (in_use, stage, expected) in [
            (Some(Cause::User(3)), Stage::Probe(1), "another user is in the room, number 3"),
            (Some(Cause::Silence), Stage::Await(1), "position reports are missing"),
            (None, Stage::Await(2), "spot 2 is complete"),
            (None, Stage::Await(1), "the receiver has left its place"),
            (None, Stage::Ended, "the readings are complete"),
        ] {
            assert_eq!(reason(in_use, taken, stage), expected);
        }
        assert_eq!(reason(None, Some(Stage::Dark(3)), Stage::Await(3)), "the receiver has left its place");
    }

    #[test]
    fn the_last_readings_are_confirmed_before_the_mirrors_of_an_idle_room_are_given_back() {
        // The telemetry that confirms them comes between the first look and the second.
        let returned = |in_use| {
            let looks = Cell::new(0);
            confirmed_ns(in_use, 1000, || {
                looks.set(looks.get() + 1);
                if looks.get() > 1 { 1020 } else { 920 }
            })
        };
        assert_eq!([returned(None), returned(Some(Cause::User(3)))], [1020, 920]);
    }

    #[test]
    fn a_calibrated_array_is_turned_as_the_uncalibrated_one_was_and_within_its_range() {
        let axis =
            |offset_deg: f64, gain: f64| AxisCorrections { offset_deg: vec![offset_deg, 0.0], gain: vec![gain, 1.0] };
        let in_use = CalibrationFile { rows: 1, columns: 2, roll: axis(2.0, 1.25), yaw: axis(-1.0, 0.8) };
        let refinement = Refinement::new(0, (Log::default(), None), &in_use).expect("one shape");
        let angles = MirrorAngles { roll: vec![0.1, 0.2], yaw: vec![-0.1, 0.3] };
        let turned = refinement.turned(angles.clone());
        let drive = [1.25 * turned.roll[0] + 2.0_f64.to_radians(), 0.8 * turned.yaw[0] - 1.0_f64.to_radians()];
        assert!((drive[0] - 0.1).abs() < 1e-12 && (drive[1] + 0.1).abs() < 1e-12, "{drive:?}");
        assert_eq!((turned.roll[1], turned.yaw[1]), (0.2, 0.3));
        let limits = AxisLimits { min_rad: -0.5, max_rad: 0.5, ..AxisLimits::default() };
        let announced = Capabilities { roll: limits, yaw: limits, ..Capabilities::default() };
        let narrowed = refinement.capabilities(announced);
        // The second mirror reaches its own range, the first 1.25 * 0.5 rad + 2 degrees and 0.8 * 0.5 rad - 1 degree.
        assert!((narrowed.roll.max_rad - 0.5).abs() < 1e-6 && narrowed.roll.min_rad > -0.5 - 1e-6, "{narrowed:?}");
        assert!((narrowed.yaw.max_rad - (0.4 - 0.017_453)).abs() < 1e-4, "{narrowed:?}");
        let other = CalibrationFile { rows: 2, columns: 1, ..in_use.clone() };
        let refusal =
            Refinement::new(0, (Log::default(), Some(other)), &in_use).map(|_| ()).expect_err("another shape");
        assert!(refusal.to_string().contains("2 x 1 mirrors: expected 1 x 2"), "{refusal}");
    }
}
