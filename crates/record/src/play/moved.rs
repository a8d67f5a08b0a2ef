//! How a live playback moves recorded messages to the present: their times, sources and ticks.

use std::time::{Duration, Instant};

use heliostat_proto::{
    BranchReport, Capabilities, ChannelReport, LedReport, Message, MirrorTelemetry, Nanos, ObstacleReport,
    OrientationReport, Stamp, UserReport, decode, encode,
};

/// The stream of a played message.
#[derive(Clone, Copy, Debug)]
pub enum OutputChannel {
    Users,
    Channel,
    Obstacles,
    Orientation,
    Branches,
    Leds,
    Telemetry,
    Capabilities,
}

/// The start of a live playback.
#[derive(Clone, Copy, Debug)]
pub struct Start {
    pub at: Instant,
    pub at_ns: Nanos,
    pub recorded_ns: Nanos,
    pub rate: f64,
    /// What changes a recorded source id into that of the playback.
    pub salt: u64,
}

impl Start {
    /// The tick of the playback for a recorded one.
    pub fn played_tick(&self, tick: u64) -> u64 {
        tick.wrapping_add(self.salt >> 32)
    }

    /// The playback time of the recorded time `time_ns`.
    pub fn played_ns(&self, time_ns: Nanos) -> Nanos {
        let since_ns = time_ns.wrapping_sub(self.recorded_ns) as i64;
        self.at_ns.saturating_add_signed((since_ns as f64 / self.rate) as i64)
    }

    pub fn due(&self, arrived_ns: Nanos) -> Instant {
        self.at + Duration::from_nanos(self.played_ns(arrived_ns).saturating_sub(self.at_ns))
    }
}

/// What a live playback changes in a message: the stamp, and the tick of a report that has one.
type Parts<'a> = (&'a mut Stamp, Option<&'a mut u64>);

impl OutputChannel {
    /// A payload with the time, the source and the tick of the playback; `None` if it cannot be decoded.
    pub fn moved(self, payload: &[u8], start: &Start) -> Option<Vec<u8>> {
        fn moved<T: Message>(payload: &[u8], start: &Start, parts: fn(&mut T) -> Parts<'_>) -> Option<Vec<u8>> {
            let mut message: T = decode(payload).ok()?;
            let (stamp, tick) = parts(&mut message);
            (stamp.source, stamp.time_ns) = (stamp.source ^ start.salt, start.played_ns(stamp.time_ns));
            if let Some(tick) = tick {
                *tick = start.played_tick(*tick);
            }
            encoded(&message)
        }
        match self {
            Self::Users => moved::<UserReport>(payload, start, |report| (&mut report.stamp, Some(&mut report.tick))),
            Self::Channel => {
                moved::<ChannelReport>(payload, start, |report| (&mut report.stamp, Some(&mut report.tick)))
            }
            Self::Obstacles => moved::<ObstacleReport>(payload, start, |report| (&mut report.stamp, None)),
            Self::Orientation => moved::<OrientationReport>(payload, start, |report| (&mut report.stamp, None)),
            Self::Branches => {
                moved::<BranchReport>(payload, start, |report| (&mut report.stamp, Some(&mut report.tick)))
            }
            Self::Leds => moved::<LedReport>(payload, start, |report| (&mut report.stamp, Some(&mut report.tick))),
            Self::Telemetry => moved::<MirrorTelemetry>(payload, start, |report| (&mut report.stamp, None)),
            Self::Capabilities => moved::<Capabilities>(payload, start, |report| (&mut report.stamp, None)),
        }
    }
}

/// The payload of a message; `None` if it cannot be encoded.
pub fn encoded(message: &impl Message) -> Option<Vec<u8>> {
    let mut payload = Vec::new();
    encode(message, &mut payload).ok()?;
    Some(payload)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ticks_of_a_live_playback_are_not_those_of_the_recorded_room() {
        let start =
            Start { at: Instant::now(), at_ns: 9_000_000_000, recorded_ns: 1_000_000_000, rate: 2.0, salt: 5 << 32 };
        let stamp = Stamp { source: 7, sequence: 3, time_ns: 2_000_000_000 };
        let users = encoded(&UserReport { stamp, tick: 60, ..UserReport::default() }).expect("a sound report");
        let moved: UserReport = decode(&OutputChannel::Users.moved(&users, &start).expect("moved")).expect("sound");
        assert_eq!((moved.tick, start.played_tick(60)), (65, 65));
        assert_eq!((moved.stamp.source, moved.stamp.time_ns), (7 ^ (5 << 32), 9_500_000_000));
        let channel = encoded(&ChannelReport { stamp, tick: 60, ..ChannelReport::default() }).expect("a sound report");
        let moved = OutputChannel::Channel.moved(&channel, &start).expect("moved");
        assert_eq!(decode::<ChannelReport>(&moved).expect("sound").tick, 65);
    }
}
