//! A controller of one epoch in a replay.

use heliostat_decide::core::Controller;
use heliostat_decide::inbox::Message;
use heliostat_decide::refusal::{Refusal, Stream};
use heliostat_proto::{ChannelReport, MirrorTelemetry, Nanos, ObstacleReport, decode};

use super::plan::Clock;

/// A controller of one epoch.
pub(super) struct EpochReplay {
    pub controller: Controller,
    pub newest_ns: Nanos,
    /// Number of the last command.
    pub sequence: u64,
    /// Decisions so far.
    pub decided: u64,
    /// Decisions at the start that are not compared.
    pub settle: u64,
}

impl EpochReplay {
    /// Room time in lockstep: the time of the newest message.
    pub fn at(&mut self, time_ns: Nanos) -> Nanos {
        self.newest_ns = self.newest_ns.max(time_ns);
        self.newest_ns
    }

    /// Passes a message other than a position report to the controller.
    pub fn receive(&mut self, stream: Stream, data: &[u8], clock: Clock, arrived_ns: Nanos) {
        let now = |epoch_replay: &mut Self, time_ns: Nanos| {
            if clock == Clock::Lockstep { epoch_replay.at(time_ns) } else { arrived_ns }
        };
        let read = match stream {
            Stream::Channel => decode::<ChannelReport>(data).map(|mut report| {
                let now = now(self, report.stamp.time_ns);
                self.controller.handle_and_poll(now, Message::Channel(&mut report), &mut |_| {});
            }),
            Stream::Obstacles => decode::<ObstacleReport>(data).map(|mut report| {
                let now = now(self, report.stamp.time_ns);
                self.controller.handle_and_poll(now, Message::Obstacles(&mut report), &mut |_| {});
            }),
            Stream::Telemetry => decode::<MirrorTelemetry>(data).map(|mut telemetry| {
                let now = now(self, telemetry.stamp.time_ns);
                self.controller.handle_and_poll(now, Message::Telemetry(&mut telemetry), &mut |_| {});
            }),
            Stream::Users => return,
        };
        if let Err(error) = read {
            self.controller.handle_malformed(stream, Refusal::from(&error));
        }
    }
}
