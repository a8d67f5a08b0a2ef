//! The commands of a calibration: numbered as those of a controller, and repeated for each position
//! report, so that no standby takes the room for one without a leader.

use std::collections::VecDeque;

use anyhow::Result;
use heliostat_bus::Publisher;
use heliostat_channel::MirrorAngles;
use heliostat_core::tenure::{Evidence, Standing, Tenure, TenureEvent};
use heliostat_proto::{ArrayState, MirrorCommand, MirrorTelemetry, Nanos, ValidityClock, encode};

/// Commands whose times are remembered until telemetry shows them.
const REMEMBERED: usize = 128;

/// The commands of one array.
pub struct Commander {
    tenure: Tenure,
    publisher: Publisher,
    validity_ms: u32,
    /// The angles of the last command.
    angles: MirrorAngles,
    /// Sequences and times of commands whose application telemetry has not shown.
    sent: VecDeque<(u64, Nanos)>,
    /// Tick of the last position report.
    tick: u64,
    payload: Vec<u8>,
    /// Whether the driver's clock follows UTC, so that its times compare with those here.
    has_clock: bool,
    /// Whether telemetry counts for the epoch; not before the first command of a takeover.
    heeds_telemetry: bool,
    superseded: Option<u64>,
    /// Whether nothing is commanded for now, because the room is in use.
    rests: bool,
    /// Whether a stop was ordered or is in force: nothing is commanded any more.
    stopped: bool,
}

impl Commander {
    /// Commands that begin with these angles. A takeover leads whatever the array follows.
    pub fn new(
        tenure: Tenure,
        publisher: Publisher,
        (angles, validity_ms): (MirrorAngles, u32),
        (clock, takes_over): (ValidityClock, bool),
    ) -> Self {
        Self {
            tenure,
            publisher,
            validity_ms,
            angles,
            sent: VecDeque::new(),
            tick: 0,
            payload: Vec::new(),
            has_clock: clock == ValidityClock::SourceTime,
            heeds_telemetry: !takes_over,
            superseded: None,
            rests: false,
            stopped: false,
        }
    }

    /// Commands nothing until [`begin`](Self::begin).
    pub fn rest(&mut self) {
        self.rests = true;
    }

    /// Takes the lead with a new tenure, and begins with these angles; also from another controller where
    /// `takes_over`.
    pub fn begin(&mut self, tenure: Tenure, angles: MirrorAngles, takes_over: bool) {
        self.tenure = tenure;
        self.angles = angles;
        self.sent.clear();
        self.heeds_telemetry = !takes_over;
        self.superseded = None;
        self.rests = false;
    }

    /// Compares telemetry; the delay in ns of the command that it shows, if it is the first to.
    pub fn handle_telemetry(&mut self, now: Nanos, telemetry: &MirrorTelemetry) -> Option<Nanos> {
        self.stopped |= telemetry.state == ArrayState::Stopped;
        if self.heeds_telemetry && !self.rests {
            let event = self.tenure.handle_telemetry(now, Evidence::from(telemetry));
            if event == Some(TenureEvent::Superseded) {
                self.superseded = Some(telemetry.epoch);
            }
        }
        if telemetry.epoch != self.tenure.epoch() {
            return None;
        }
        let at = self.sent.iter().position(|(sequence, _)| *sequence == telemetry.applied_sequence)?;
        let (_, sent_ns) = self.sent[at];
        self.sent.drain(..=at);
        self.has_clock.then(|| telemetry.applied_ns.saturating_sub(sent_ns))
    }

    /// A stop was ordered, whether or not the array has received it.
    pub fn note_stop(&mut self) {
        self.stopped = true;
    }

    /// Whether a stop was ordered or reported.
    pub fn is_stopped(&self) -> bool {
        self.stopped
    }

    /// Another controller is in the room, or has left.
    pub fn handle_controller(&mut self, source: u64, is_present: bool) {
        self.tenure.handle_controller(source, is_present);
    }

    /// Answers a position report by the last angles.
    pub fn answer(&mut self, now: Nanos, tick: u64) -> Result<()> {
        self.tick = tick;
        self.send(now)
    }

    /// Commands these angles.
    pub fn command(&mut self, now: Nanos, angles: MirrorAngles) -> Result<()> {
        self.angles = angles;
        self.send(now)
    }

    /// Whether the array follows this process, as far as it knows.
    pub fn is_leading(&self) -> bool {
        self.tenure.standing() == Standing::Leading
    }

    /// Whether another controller commands the array.
    pub fn stands_by(&self) -> bool {
        self.tenure.standing() == Standing::Standby
    }

    /// The epoch of the controller that took the lead from this process.
    pub fn superseded_by(&self) -> Option<u64> {
        self.superseded
    }

    /// The epoch of the commands.
    pub fn epoch(&self) -> u64 {
        self.tenure.epoch()
    }

    fn send(&mut self, now: Nanos) -> Result<()> {
        // After a release the array must not get angles of before the stop.
        // A process that has lost the lead stays out of it: its readings would be of another's angles.
        if self.stopped || self.rests || self.superseded.is_some() || (self.stands_by() && self.heeds_telemetry) {
            return Ok(());
        }
        let (Some(epoch), _) = self.tenure.permit(now) else { return Ok(()) };
        self.heeds_telemetry = true;
        let sequence = self.tenure.next_sequence();
        let narrow = |angles: &[f64]| angles.iter().map(|angle| *angle as f32).collect();
        let command = MirrorCommand {
            epoch,
            sequence,
            answers: self.tick,
            time_ns: now,
            validity_ms: self.validity_ms,
            roll: narrow(&self.angles.roll),
            yaw: narrow(&self.angles.yaw),
        };
        self.payload.clear();
        encode(&command, &mut self.payload)?;
        self.publisher.put(&self.payload)?;
        self.sent.push_back((sequence, now));
        if self.sent.len() > REMEMBERED {
            self.sent.pop_front();
        }
        Ok(())
    }
}
