//! Where payloads arrive: decoded, decided and published inline, in the callback that brought them.
//!
//! All callbacks share one desk behind a mutex. It is held for one message at a time, and by the status loop only to exchange
//! ledgers and to copy counters.

use std::time::{Instant, SystemTime, UNIX_EPOCH};

use heliostat_bus::Publisher;
use heliostat_proto::{
    ChannelReport, CodecError, MirrorTelemetry, Nanos, ObstacleReport, UserReport, decode_into, encode,
};

use crate::{
    core::{Controller, Decision, Stage},
    inbox::Message,
    ledger::{Laps, Ledger},
    refused::{Refusal, Stream},
};

/// Where room time comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RoomClock {
    /// UTC.
    Utc,
    /// The time of the newest report: the room computes faster or slower than the world, and waits for answers.
    Lockstep {
        /// Time of the newest report so far.
        newest_ns: Nanos,
    },
}

impl RoomClock {
    /// Room time at the arrival of a report of the given time.
    fn at_arrival(&mut self, report_ns: Nanos) -> Nanos {
        match self {
            Self::Utc => utc_ns(),
            Self::Lockstep { newest_ns } => {
                *newest_ns = report_ns.max(*newest_ns);
                *newest_ns
            }
        }
    }

    /// Room time now.
    pub fn now(&self) -> Nanos {
        match self {
            Self::Utc => utc_ns(),
            Self::Lockstep { newest_ns } => *newest_ns,
        }
    }
}

/// UTC in ns since 1970.
pub fn utc_ns() -> Nanos {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    Nanos::try_from(since.as_nanos()).unwrap_or(Nanos::MAX)
}

/// The controller with everything that a callback needs.
pub struct Desk {
    /// The deciding core.
    pub controller: Controller,
    /// Room time.
    pub clock: RoomClock,
    /// Times since the status loop last took them.
    pub ledger: Ledger,
    /// Commands that the transport did not take.
    pub unsent: u64,
    /// What was wrong with the last payload that was no message.
    pub last_malformed: Option<CodecError>,
    publisher: Publisher,
    payload: Vec<u8>,
    users: UserReport,
    channel: ChannelReport,
    obstacles: ObstacleReport,
    telemetry: MirrorTelemetry,
}

impl Desk {
    /// A desk that publishes commands by `publisher`.
    pub fn new(controller: Controller, clock: RoomClock, publisher: Publisher) -> Self {
        // Two f32 a mirror, and less than 100 bytes beside them.
        let payload = Vec::with_capacity(100 + 8 * controller.observation().mirrors());
        Self {
            controller,
            clock,
            ledger: Ledger::new(),
            unsent: 0,
            last_malformed: None,
            publisher,
            payload,
            users: UserReport::default(),
            channel: ChannelReport::default(),
            obstacles: ObstacleReport::default(),
            telemetry: MirrorTelemetry::default(),
        }
    }

    /// Handles a payload of a stream; `entered` is when its callback was entered.
    pub fn handle(&mut self, stream: Stream, payload: &[u8], entered: Instant) {
        let mut laps = Laps::start(entered);
        let decoded = match stream {
            Stream::Users => decode_into(&mut self.users, payload),
            Stream::Channel => decode_into(&mut self.channel, payload),
            Stream::Obstacles => decode_into(&mut self.obstacles, payload),
            Stream::Telemetry => decode_into(&mut self.telemetry, payload),
        };
        if let Err(error) = decoded {
            self.controller.count_malformed(stream, Refusal::from(&error));
            self.last_malformed = Some(error);
            return;
        }
        laps.mark(Stage::Decoded);
        let message = match stream {
            Stream::Users => Message::Users(&mut self.users),
            Stream::Channel => Message::Channel(&mut self.channel),
            Stream::Obstacles => Message::Obstacles(&mut self.obstacles),
            Stream::Telemetry => Message::Telemetry(&mut self.telemetry),
        };
        let now = self.clock.at_arrival(message.stamp().time_ns);
        let decision = self.controller.receive(now, message, &mut |stage| laps.mark(stage));
        let Some(Decision::Move { command, age_ns }) = decision else { return };
        // The core's commands are sound, so encoding fails no more than the transport does: both are "unsent".
        let sent = encode(command, &mut self.payload).is_ok() && self.publisher.put(&self.payload).is_ok();
        laps.mark(Stage::Published);
        self.unsent += u64::from(!sent);
        self.ledger.record(&laps, age_ns);
    }
}
