//! A room in closed loop with the decision core, in simulated time.
//!
//! [`ClosedLoop`] gives each message of the room to the core, and each command to the array. The
//! controller decides in zero simulated time. Either the policy of the core decides
//! ([`ClosedLoop::deliver`]), or the caller does: [`ClosedLoop::next_decision`] returns at the next
//! position report, [`ClosedLoop::observation`] is then what a policy would read, and
//! [`ClosedLoop::decide`] commands the angles of the caller.

use heliostat_array::moment::Moment;
use heliostat_channel::MirrorAngles;
use heliostat_core::core::{Controller, Decision, DegradedMode, Due, Observed, Stage};
use heliostat_core::inbox::Message;
use heliostat_core::observation::Observation;
use heliostat_core::policy::Policy;
use heliostat_room::SimulatedRoom;
use heliostat_room::episode::{Episode, Event};
use heliostat_room::reports::Report;
use heliostat_scenario::Scenario;

use crate::error::EnvironmentError;

/// A room without a position report for this time has none at all.
const SILENCE_NS: u64 = 60_000_000_000;

/// A room and its controller in the same simulated time.
pub struct ClosedLoop {
    episode: Episode,
    controller: Controller,
    /// Whether telemetry names the mirrors that do not follow.
    names_unusable: bool,
    /// The decision for which [`ClosedLoop::next_decision`] has observed.
    due: Option<(Moment, Observed)>,
}

impl ClosedLoop {
    /// An episode that begins, and a controller of its scenario before its first report.
    pub fn new(episode: Episode, mut controller: Controller) -> Self {
        controller.warm_up(0..2);
        for (array, capabilities) in episode.capabilities().enumerate() {
            controller.handle_capabilities(array, &capabilities, Ok(()));
        }
        Self { episode, controller, names_unusable: true, due: None }
    }

    /// The same, with telemetry that names the mirrors that do not follow, or leaves them unnamed.
    pub fn naming_unusable(self, names_unusable: bool) -> Self {
        Self { names_unusable, ..self }
    }

    /// A copy whose controller has this policy of the same kind; both continue alike.
    pub fn duplicate(&self, scenario: &Scenario, policy: Box<dyn Policy>) -> Self {
        Self {
            episode: self.episode.clone(),
            controller: self.controller.duplicate(scenario, policy),
            names_unusable: self.names_unusable,
            due: self.due,
        }
    }

    /// The controller.
    pub fn controller(&self) -> &Controller {
        &self.controller
    }

    /// The room as it is now.
    pub fn room(&self) -> &SimulatedRoom {
        self.episode.room()
    }

    /// The next message of the room up to `until_ns`; see [`Episode::poll_event`].
    pub fn poll_event(&mut self, until_ns: u64) -> Option<(Moment, Event)> {
        self.episode.poll_event(until_ns)
    }

    /// Advances the room without events; see [`Episode::advance`].
    pub fn advance(&mut self, to_ns: u64) {
        self.episode.advance(to_ns);
    }

    /// Gives a message to the controller, and the command of its policy to the array; whether a
    /// decision was due. `mark` is called as each stage of the decision ends.
    ///
    /// # Errors
    /// [`EnvironmentError::Refused`] and [`EnvironmentError::Stale`].
    pub fn deliver(
        &mut self,
        now: Moment,
        mut event: Event,
        mark: &mut dyn FnMut(Stage),
    ) -> Result<bool, EnvironmentError> {
        let Some(message) = message(&mut event, self.names_unusable) else { return Ok(false) };
        let Some(decision) = self.controller.handle_and_poll(now.room_ns, message, mark) else { return Ok(false) };
        command(decision, now, &mut self.episode)?;
        Ok(true)
    }

    /// Delivers messages until the next position report, and observes for its decision; the room is
    /// then at the time of that report.
    ///
    /// # Errors
    /// [`EnvironmentError::Stale`] and [`EnvironmentError::Silence`].
    pub fn next_decision(&mut self, from_ns: u64) -> Result<Moment, EnvironmentError> {
        self.next_decision_by(from_ns.saturating_add(SILENCE_NS))?.ok_or(EnvironmentError::Silence)
    }

    /// As [`ClosedLoop::next_decision`], for position reports up to `until_ns`; `None` where there
    /// is none.
    ///
    /// # Errors
    /// [`EnvironmentError::Stale`].
    pub fn next_decision_by(&mut self, until_ns: u64) -> Result<Option<Moment>, EnvironmentError> {
        while let Some((now, mut event)) = self.episode.poll_event(until_ns) {
            let Some(message) = message(&mut event, self.names_unusable) else { continue };
            match self.controller.handle_message(now.room_ns, message) {
                Due::Command => {
                    self.due = Some((now, self.controller.poll_observation(now.room_ns)));
                    return Ok(Some(now));
                }
                Due::StaleCommand => return Err(EnvironmentError::Stale),
                Due::Nothing => {}
            }
        }
        Ok(None)
    }

    /// The observation of the decision that is due.
    pub fn observation(&self) -> &Observation {
        self.controller.observation()
    }

    /// Commands angles for the decision that is due; no effect where none is.
    ///
    /// # Errors
    /// [`EnvironmentError::Refused`].
    pub fn decide(&mut self, angles: &MirrorAngles) -> Result<(), EnvironmentError> {
        let Some((now, observed)) = self.due.take() else { return Ok(()) };
        let decision = self.controller.poll_proposed(observed, now.room_ns, angles);
        command(decision, now, &mut self.episode)
    }
}

/// The message of an event; `None` for one that no controller reads. Without `names_unusable`
/// telemetry names no unusable mirrors.
pub fn message(event: &mut Event, names_unusable: bool) -> Option<Message<'_>> {
    let message = match event {
        Event::Telemetry(array, telemetry) => {
            if !names_unusable {
                telemetry.unusable.clear();
            }
            Message::Telemetry(*array, telemetry)
        }
        Event::Report(Report::Obstacles(report)) => Message::Obstacles(report),
        Event::Report(Report::Orientation(report)) => Message::Orientation(report),
        Event::Report(Report::Channel(report)) => Message::Channel(report),
        Event::Report(Report::Leds(report)) => Message::Leds(report),
        Event::Report(Report::Branches(_)) => return None,
        Event::Report(Report::Users(report)) => Message::Users(report),
    };
    Some(message)
}

/// Gives each command of a decision to its array.
fn command(decision: Decision<'_>, now: Moment, episode: &mut Episode) -> Result<(), EnvironmentError> {
    if decision == Decision::Hold(DegradedMode::StaleReport) {
        return Err(EnvironmentError::Stale);
    }
    for (array, command) in decision.commands() {
        episode.handle_command(array, now, command).map_err(EnvironmentError::Refused)?;
    }
    Ok(())
}
