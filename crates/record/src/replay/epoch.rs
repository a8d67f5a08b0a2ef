//! A controller of one epoch in a replay.

use heliostat_core::core::{Controller, Due, Timing};
use heliostat_core::inbox::Message;
use heliostat_proto::{
    ChannelReport, InputKind, LedReport, MirrorCommand, MirrorTelemetry, Nanos, ObstacleReport, OrientationReport,
    UserReport, decode,
};

use super::inputs::{Input, cloned, handle};
use super::plan::Clock;
use super::scheduled::Progress;

/// A controller of one epoch.
pub(super) struct EpochReplay {
    pub controller: Controller,
    pub newest_ns: Nanos,
    /// Decisions so far.
    pub decided: u64,
    /// Decisions at the start that are not compared.
    pub settle: u64,
    /// The recorded order of its inputs, where the recording has it.
    pub progress: Option<Progress>,
}

impl EpochReplay {
    /// Whether the next command is compared.
    pub fn counts(&self) -> bool {
        let is_known = self.progress.as_ref().is_none_or(|progress| progress.is_known);
        is_known && self.decided >= self.settle
    }

    /// Room time in lockstep: the time of the newest message.
    pub fn at(&mut self, time_ns: Nanos) -> Nanos {
        self.newest_ns = self.newest_ns.max(time_ns);
        self.newest_ns
    }

    /// Passes a message other than a position report to the controller, outside a schedule.
    pub fn receive(&mut self, input: Input, data: &[u8], clock: Clock, arrived_ns: Nanos) {
        let now = match clock {
            Clock::Lockstep => match time_of(input.0, data) {
                Some(time_ns) => self.at(time_ns),
                None => self.newest_ns,
            },
            Clock::Live => arrived_ns,
        };
        handle(&mut self.controller, input, data, now);
    }

    /// Passes a position report to the controller at `now`, outside a schedule, and returns its
    /// commands, each with the index of its array.
    pub fn answer(&mut self, mut report: UserReport, now: Nanos, timing: Timing) -> Vec<(usize, MirrorCommand)> {
        let decided = match self.controller.handle_message(now, Message::Users(&mut report)) {
            Due::Command => self.controller.poll_command(now, timing, &mut |_| {}),
            Due::StaleCommand => self.controller.poll_stale_command(now),
            Due::Nothing => return Vec::new(),
        };
        cloned(decided)
    }
}

/// Time in the stamp of a message.
fn time_of(input: InputKind, data: &[u8]) -> Option<Nanos> {
    let stamp = match input {
        InputKind::Channel => decode::<ChannelReport>(data).ok()?.stamp,
        InputKind::Obstacles => decode::<ObstacleReport>(data).ok()?.stamp,
        InputKind::Orientation => decode::<OrientationReport>(data).ok()?.stamp,
        InputKind::Leds => decode::<LedReport>(data).ok()?.stamp,
        InputKind::Telemetry => decode::<MirrorTelemetry>(data).ok()?.stamp,
        _ => return None,
    };
    Some(stamp.time_ns)
}
