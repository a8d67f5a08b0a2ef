//! The array of a playback: its mirrors move as recorded, and it obeys the controllers of the playback.
//!
//! Recorded telemetry names the command of a recorded controller, for which a controller of the
//! playback would stand by. The command, the state and the counters in played telemetry are
//! therefore those of [`Array`] after the commands of the playback. Angles, faults and stops are
//! the recorded ones.

use std::f64::consts::FRAC_PI_2;

use heliostat_array::bounds::Bounds;
use heliostat_array::moment::Moment;
use heliostat_array::rules::{Array, Limits};
use heliostat_proto::{ArrayState, MirrorCommand, MirrorTelemetry, ValidityClock};

/// An array that is played.
pub struct PlayedArray {
    array: Array,
}

impl PlayedArray {
    /// An array of this number of mirrors that has accepted no command.
    pub fn new(mirrors: usize) -> Self {
        let limits = Limits {
            mirrors,
            roll_rad: [-FRAC_PI_2, FRAC_PI_2],
            yaw_rad: [-FRAC_PI_2, FRAC_PI_2],
            park_rad: [0.0; 2],
            // The mirrors move as recorded: they do not park in addition.
            hold_ns: u64::MAX,
            // A lockstep controller has no UTC.
            clock: ValidityClock::Arrival,
            bounds: Bounds::default(),
        };
        Self { array: Array::new(limits) }
    }

    /// Follows a command of the playback if the rules of an array accept it.
    pub fn handle_command(&mut self, now: Moment, command: &MirrorCommand) {
        // A refused command is counted, as telemetry reports it.
        let _ = self.array.handle_command(now, command);
    }

    /// Replaces the recorded command, state and counters in telemetry.
    pub fn update(&mut self, now: Moment, telemetry: &mut MirrorTelemetry) {
        self.array.advance(now.local_ns);
        let followed = self.array.followed().copied().unwrap_or_default();
        telemetry.epoch = followed.epoch;
        telemetry.applied_sequence = followed.sequence;
        telemetry.answers = followed.answers;
        telemetry.received_ns = followed.received.room_ns;
        telemetry.applied_ns = followed.received.room_ns;
        telemetry.counters = *self.array.counters();
        if !matches!(telemetry.state, ArrayState::Stopped | ArrayState::Fault) {
            telemetry.state = self.array.state();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_validity_of_a_command_ends_in_the_time_of_the_playback() {
        let mut array = PlayedArray::new(1);
        let command = MirrorCommand {
            epoch: 1,
            sequence: 1,
            validity_ms: 400,
            roll: vec![0.0],
            yaw: vec![0.0],
            ..MirrorCommand::default()
        };
        let at = |ms: u64| Moment::simulated(ms * 1_000_000);
        array.handle_command(at(1000), &command);
        let mut state_at = |ms: u64| {
            let mut telemetry = MirrorTelemetry::default();
            array.update(at(ms), &mut telemetry);
            (telemetry.state, telemetry.received_ns)
        };
        assert_eq!(state_at(1399), (ArrayState::Following, 1_000_000_000));
        assert_eq!(state_at(1400), (ArrayState::Holding, 1_000_000_000));
    }
}
