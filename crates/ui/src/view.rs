//! Subscribes to a room's public topics and keeps the latest message of each.
//!
//! Callbacks decode and store; the readers compute. A message older than [`EXPIRY`] counts as
//! absent.

mod received;
mod subscriptions;

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use heliostat_bus::{Bus, Subscription};
use heliostat_proto::NodeKind;
use heliostat_scenario::{Scenario, USERS_MAX};
use heliostat_service::locks::lock;

use crate::UiError;
use crate::notes::{in_demo, without_router};
use crate::shown_room::{Announcements, Findings, GeometrySource, RoomChooser, ShownRoom};
use crate::stop_watch::StopWatch;
use subscriptions::subscribe;

pub use crate::expiry::EXPIRY;
pub(crate) use received::{Dated, Received};

/// Time after the start within which a process of the room announces its geometry: twice the interval.
const ANNOUNCED_WITHIN: Duration = Duration::from_secs(2);
/// Beginning of the note of a picture that no process announces. It concerns viewers with a picture only.
pub(crate) const NO_GEOMETRY: &str = "no process announces the geometry of the room";

/// A view of one room.
pub struct View {
    pub(crate) opened: Instant,
    chooser: RoomChooser,
    received: Arc<Mutex<Received>>,
    /// The emergency stops; the switch of the page uses the same.
    pub(crate) stops: Arc<StopWatch>,
    /// The session, for the reason of a connection that fails.
    bus: Bus,
    /// Whether an operator of this view can restart the controller: the notes then advise it.
    can_restart: AtomicBool,
    _subscriptions: Vec<Subscription>,
}

impl View {
    /// Subscribes to the room of a session. Without a scenario, the view shows the geometry that
    /// the room announces.
    ///
    /// # Errors
    /// [`UiError::Channel`] for a scenario that the channel model refuses, [`UiError::Bus`] if the
    /// session is closed.
    pub fn open(bus: &Bus, scenario: Option<&Scenario>) -> Result<Self, UiError> {
        let chooser = RoomChooser::new(scenario)?;
        let received = Arc::new(Mutex::new(Received::of(bus.room().name())));
        let subscriptions = subscribe(bus, &received)?;
        let stops = StopWatch::open(bus)?;
        let bus = bus.enter(bus.room().clone());
        let can_restart = AtomicBool::new(false);
        Ok(Self { opened: Instant::now(), chooser, received, stops, bus, can_restart, _subscriptions: subscriptions })
    }

    /// Position reports a second of the displayed source, since the view opened.
    pub(crate) fn reports_per_s(&self) -> f64 {
        self.received().user_reports as f64 / self.opened.elapsed().as_secs_f64().max(1e-3)
    }

    /// From now on the notes are those of a demo, whose page has a button that restarts the controller.
    pub(crate) fn advise_restart(&self) {
        self.can_restart.store(true, Ordering::Relaxed);
    }

    /// Whether messages of the room and of a controller have arrived.
    pub fn is_complete(&self) -> bool {
        let received = self.received();
        (received.truth.is_some() || received.users.is_some())
            && received.statuses.contains_key(NodeKind::Controller.name())
    }

    /// The policy in the latest status of a controller, even if it has left.
    pub fn policy(&self) -> Option<String> {
        self.received().statuses.get(NodeKind::Controller.name()).map(|(_, status)| status.policy.clone())
    }

    /// What the user should know about the room: two drivers of one array, missing processes, differing
    /// scenarios, an unknown geometry, a connection that fails because of a certificate. Also what is no fault.
    pub(crate) fn findings(&self) -> Findings {
        let (room, of_geometry) = self.chooser.choose(self.announcements());
        if let Some(notes) = self.notes_without_router() {
            return Findings { notes, remarks: of_geometry.remarks };
        }
        let is_explained = !of_geometry.notes.is_empty();
        let arrays = room.model.mirrors.arrays().len();
        let mut notes = self.received().notes_with(of_geometry.notes, arrays, self.opened);
        let connection = self.bus.connection_problem();
        if room.source == GeometrySource::Default
            && !is_explained
            && connection.is_none()
            && self.opened.elapsed() > ANNOUNCED_WITHIN
        {
            notes.push(format!(
                "{NO_GEOMETRY}: the picture shows the scenario {}; give --scenario FILE",
                room.scenario.name
            ));
        }
        notes.extend(connection);
        Findings { notes, remarks: of_geometry.remarks }
    }

    /// These notes as they are shown: in a demo with what helps there.
    pub(crate) fn as_shown(&self, notes: Vec<String>) -> Vec<String> {
        if self.can_restart.load(Ordering::Relaxed) { in_demo(notes) } else { notes }
    }

    /// The notes of this view while its connection to a router is lost.
    pub(crate) fn notes_without_router(&self) -> Option<Vec<String>> {
        let router = self.bus.lost_router()?;
        Some(without_router(&router, self.bus.connection_problem()))
    }

    /// The notes about the connection of this view, which its session logs too.
    pub(crate) fn notes_of_connection(&self) -> Vec<String> {
        self.notes_without_router().unwrap_or_else(|| self.bus.connection_problem().into_iter().collect())
    }

    /// The room to draw. Takes the lock of the messages, so it must not be held.
    pub(crate) fn shown_room(&self) -> Arc<ShownRoom> {
        self.chooser.choose(self.announcements()).0
    }

    /// The room to draw, with the users that are in it: an announced geometry has none.
    pub(crate) fn served_room(&self) -> Scenario {
        let mut scenario = self.shown_room().scenario.clone();
        let seen = self.figures().users.len().min(USERS_MAX);
        scenario.users.count = scenario.users.count.max(seen);
        scenario
    }

    /// The largest number of users of the given scenario; `None` without one: an announced geometry has no users.
    pub(crate) fn users_max(&self) -> Option<usize> {
        let room = self.shown_room();
        (room.source == GeometrySource::Given).then(|| room.scenario.users.largest())
    }

    fn announcements(&self) -> Announcements {
        self.received().announcements()
    }

    pub(crate) fn received(&self) -> MutexGuard<'_, Received> {
        lock(&self.received)
    }
}
