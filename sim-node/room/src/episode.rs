//! A room in closed loop with a controller, in simulated time and without a transport.
//!
//! [`Episode`] performs no I/O: the caller owns the controller and the loop. The calling order is:
//!
//! 1. [`Episode::new`] creates the room and advances it to the start of the reports.
//! 2. [`Episode::poll_event`] returns the next message of the room until it returns `None`.
//! 3. [`Episode::handle_command`] gives each command back to the array, before the next poll, at
//!    the time of the event that it answers. The controller takes no simulated time to answer.
//! 4. [`Episode::advance`] moves the room to an instant, at which [`Episode::room`] can be
//!    examined.
//!
//! Events of the same time have a fixed order: telemetry, obstacles, orientations, channel,
//! positions. A command changes the mirrors at once, so later events of the same time include its
//! effect. The room reports a sample one latency after it was taken, so that its age is what
//! `streams` configures.
//!
//! ```
//! use heliostat_proto::MirrorCommand;
//! use heliostat_scenario::Scenario;
//! use heliostat_room::episode::{Episode, Event};
//! use heliostat_room::reports::Report;
//!
//! let scenario = Scenario::builtin("specular")?;
//! let mirrors = scenario.mirror_count();
//! let mut episode = Episode::new(&scenario, None, 1, 0)?;
//! let (mut reports, end_ns) = (0, 100_000_000);
//! while let Some((now, event)) = episode.poll_event(end_ns) {
//!     // A controller that keeps all mirrors flat.
//!     if let Event::Report(Report::Users(report)) = event {
//!         reports += 1;
//!         let command = MirrorCommand {
//!             epoch: 1,
//!             sequence: report.tick,
//!             answers: report.tick,
//!             time_ns: now.room_ns,
//!             validity_ms: 200,
//!             roll: vec![0.0; mirrors],
//!             yaw: vec![0.0; mirrors],
//!         };
//!         episode.handle_command(0, now, &command)?;
//!     }
//! }
//! episode.advance(end_ns);
//! assert_eq!(episode.room().array(0).counters().accepted, reports);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use heliostat_array::moment::Moment;
use heliostat_array::rules::Refusal;
use heliostat_proto::{Capabilities, MirrorCommand, MirrorTelemetry, Stamp};
use heliostat_scenario::Scenario;

use crate::mismatch::true_room;
use crate::reports::schedule::Schedule;
use crate::reports::{Report, Reports};
use crate::room::SimulatedRoom;
use crate::world::WorldError;

/// The source id in the stamps of reports and telemetry.
const SOURCE: u64 = 1;

/// A message of the room.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// The telemetry of the array with this index.
    Telemetry(usize, Box<MirrorTelemetry>),
    /// A report of one stream.
    Report(Report),
}

/// A room with its report streams and its telemetry, in simulated time.
#[derive(Clone, Debug)]
pub struct Episode {
    room: SimulatedRoom,
    reports: Reports,
    telemetry: Schedule,
    telemetry_sequence: u64,
    /// Reports and telemetry that were due before this time are skipped.
    start_ns: u64,
    /// The time of the latest event, at which reports may still wait for their release.
    event_ns: u64,
    /// Telemetry of that time which has not been polled yet, of the last array first.
    due_telemetry: Vec<(usize, Box<MirrorTelemetry>)>,
}

impl Episode {
    /// A room in which the users have walked for `start_ns`, and which begins to report then.
    ///
    /// `trace` is the text of the file `users.trace`; `seed` replaces the scenario's own seed.
    ///
    /// # Errors
    /// [`WorldError`] as from [`SimulatedRoom::new`].
    pub fn new(scenario: &Scenario, trace: Option<&str>, seed: u64, start_ns: u64) -> Result<Self, WorldError> {
        Ok(Self::of_room(SimulatedRoom::new(scenario, trace, seed)?, scenario, seed, start_ns))
    }

    /// The same in a given room of the scenario at time 0, in which for example a recorded walk
    /// begins at another time.
    pub fn of_room(mut room: SimulatedRoom, scenario: &Scenario, seed: u64, start_ns: u64) -> Self {
        room.advance(start_ns);
        // A tracker is more accurate or less than the controller knows.
        let streams = true_room(scenario, seed).streams;
        Self {
            room,
            reports: Reports::new(&streams, seed, SOURCE),
            telemetry: Schedule::new(streams.telemetry.rate_hz, 0),
            telemetry_sequence: 0,
            start_ns,
            event_ns: 0,
            due_telemetry: Vec::new(),
        }
    }

    /// The next event up to and including `until_ns`, with its time; `None` when there is no other.
    ///
    /// The room is then at the time of the event.
    pub fn poll_event(&mut self, until_ns: u64) -> Option<(Moment, Event)> {
        loop {
            let now = Moment::simulated(self.event_ns);
            if let Some((array, telemetry)) = self.due_telemetry.pop() {
                return Some((now, Event::Telemetry(array, telemetry)));
            }
            if let Some(report) = self.reports.release(self.event_ns) {
                return Some((now, Event::Report(report)));
            }
            let next_ns = self.next_event_ns()?;
            if next_ns > until_ns {
                return None;
            }
            self.sample(next_ns);
        }
    }

    /// Gives a command to an array.
    ///
    /// # Errors
    /// [`Refusal`]: the array does not change.
    pub fn handle_command(&mut self, array: usize, now: Moment, command: &MirrorCommand) -> Result<(), Refusal> {
        self.room.handle_command(array, now, command)
    }

    /// Advances users and mirrors to a time, without events; to be called after
    /// [`Episode::poll_event`] has returned `None` for this time.
    pub fn advance(&mut self, to_ns: u64) {
        self.room.advance(to_ns);
    }

    /// The room as it is now.
    pub fn room(&self) -> &SimulatedRoom {
        &self.room
    }

    /// The capabilities of each array, which a controller needs before the first event.
    pub fn capabilities(&self) -> impl Iterator<Item = Capabilities> {
        (0..self.room.arrays()).map(|array| self.room.capabilities(array, Stamp::default()))
    }

    /// The time of the next sample or release.
    fn next_event_ns(&self) -> Option<u64> {
        let reports_ns = self.reports.next_sample_ns().min(self.reports.next_release_ns());
        let next_ns = self.telemetry.next_ns().unwrap_or(u64::MAX).min(reports_ns);
        (next_ns < u64::MAX).then_some(next_ns.max(self.start_ns))
    }

    /// Advances the room to a time and takes the samples that are due.
    fn sample(&mut self, at_ns: u64) {
        let now = Moment::simulated(at_ns);
        self.event_ns = at_ns;
        self.room.advance(at_ns);
        self.reports.sample(now, self.room.world(), self.room.angles());
        if self.telemetry.take(at_ns).is_some() {
            self.telemetry_sequence += 1;
            let stamp = Stamp { source: SOURCE, sequence: self.telemetry_sequence, time_ns: at_ns };
            for array in (0..self.room.arrays()).rev() {
                self.due_telemetry.push((array, Box::new(self.room.telemetry(array, stamp))));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn episode(overrides: &[&str], start_ns: u64) -> Episode {
        let scenario = Scenario::builtin("specular").unwrap().with_overrides(overrides).unwrap();
        Episode::new(&scenario, None, 1, start_ns).unwrap()
    }

    fn kinds(episode: &mut Episode, until_ns: u64) -> Vec<(u64, char)> {
        std::iter::from_fn(|| episode.poll_event(until_ns))
            .map(|(now, event)| {
                let kind = match event {
                    Event::Telemetry(..) => 't',
                    Event::Report(Report::Obstacles(_)) => 'o',
                    Event::Report(Report::Orientation(_)) => 'h',
                    Event::Report(Report::Branches(_)) => 'b',
                    Event::Report(Report::Leds(_)) => 'l',
                    Event::Report(Report::Channel(_)) => 'c',
                    Event::Report(Report::Users(_)) => 'u',
                };
                (now.room_ns / 1_000_000, kind)
            })
            .collect()
    }

    const RATES: [&str; 6] = [
        "streams.positions.rate_hz=10",
        "streams.positions.latency_ms=0",
        "streams.channel.rate_hz=10",
        "streams.channel.latency_ms=30",
        "streams.obstacles.rate_hz=5",
        "streams.telemetry.rate_hz=10",
    ];

    #[test]
    fn events_of_one_time_are_ordered_and_delayed_ones_come_later() {
        let mut episode = episode(&RATES, 0);
        let first = [(0, 't'), (0, 'o'), (0, 'u'), (30, 'c'), (100, 't'), (100, 'u')];
        assert_eq!(kinds(&mut episode, 100_000_000), first);
        assert_eq!(kinds(&mut episode, 130_000_000), [(130, 'c')]);
        assert_eq!(kinds(&mut episode, 199_000_000), []);
    }

    #[test]
    fn no_event_is_earlier_than_the_start() {
        let mut episode = episode(&RATES, 5_020_000_000);
        assert_eq!(kinds(&mut episode, 5_060_000_000), [(5020, 't'), (5020, 'o'), (5020, 'u'), (5050, 'c')]);
    }

    #[test]
    fn a_command_turns_mirrors_without_delay_before_the_next_event() {
        let mut episode = episode(&["actuator.profile=ideal"], 0);
        let mut turned = 0.0;
        while let Some((now, event)) = episode.poll_event(100_000_000) {
            if let Event::Report(Report::Users(report)) = event {
                let command = MirrorCommand {
                    epoch: 1,
                    sequence: report.tick,
                    answers: report.tick,
                    time_ns: now.room_ns,
                    validity_ms: 200,
                    roll: vec![0.1; 100],
                    yaw: vec![0.0; 100],
                };
                episode.handle_command(0, now, &command).unwrap();
                turned = episode.room().angles().roll[0];
            }
        }
        assert!((turned - 0.1).abs() < 1e-6, "{turned}");
    }
}
