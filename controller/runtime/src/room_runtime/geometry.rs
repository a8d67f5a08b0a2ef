//! The geometry of the room: announces that of this controller, and compares it with that of the
//! simulator.
//!
//! None of this is in the decision path.

use std::{
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use heliostat_bus::{Bus, Class, Publisher, Subscription};
use heliostat_proto::{Nanos, NodeKind, RoomGeometry, Stamp, encode};
use heliostat_scenario::{GeometryDifference, Scenario};
use heliostat_service::printable::printable;

use super::{locks::lock, undecodable::Decoder};

/// Time between two announcements.
const INTERVAL: Duration = Duration::from_secs(1);

/// An announcement older than this is of a simulator that has left.
const EXPIRY: Duration = Duration::from_secs(5);

/// Longest text of a value in a report, in characters.
const VALUE_CHARACTERS: usize = 60;

/// The time of arrival and the text of an announcement.
type Announced = Option<(Instant, String)>;

/// Announces a geometry, and compares it with the announcements of the room.
pub struct GeometryExchange {
    own: Scenario,
    message: RoomGeometry,
    publisher: Publisher,
    announced: Option<Instant>,
    received: Arc<Mutex<Announced>>,
    /// The text that was compared last.
    compared: String,
    problem: Option<String>,
}

impl GeometryExchange {
    /// Subscribes to the room's geometry, and announces that of the scenario.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn open(bus: &Bus, scenario: &Scenario, source: u64, decoder: Decoder) -> anyhow::Result<(Self, Subscription)> {
        let received: Arc<Mutex<Announced>> = Arc::default();
        let newest = Arc::clone(&received);
        let subscription = bus.subscribe(&bus.room().geometry(NodeKind::SimNode), move |payload| {
            let Some(geometry) = decoder.decode::<RoomGeometry>("geometry", None, payload) else { return };
            *lock(&newest) = Some((Instant::now(), geometry.scenario));
        })?;
        let stamp = Stamp { source, ..Stamp::default() };
        let exchange = Self {
            own: scenario.clone(),
            message: RoomGeometry { stamp, scenario: scenario.geometry_toml() },
            publisher: bus.publisher(&bus.room().geometry(NodeKind::Controller), Class::LowDrop)?,
            announced: None,
            received,
            compared: String::new(),
            problem: None,
        };
        Ok((exchange, subscription))
    }

    /// Announces the geometry if that is due.
    pub fn announce_if_due(&mut self, now_ns: Nanos) {
        if self.announced.is_some_and(|at| at.elapsed() < INTERVAL) {
            return;
        }
        self.announced = Some(Instant::now());
        self.message.stamp.sequence += 1;
        self.message.stamp.time_ns = now_ns;
        let mut payload = Vec::new();
        match encode(&self.message, &mut payload) {
            // A closed session shows in the count of commands that could not be sent.
            Ok(()) => drop(self.publisher.put(&payload)),
            Err(error) => tracing::warn!("the geometry cannot be announced: {error}"),
        }
    }

    /// Compares the newest announcement of the room, unless it is known.
    pub fn compare_newest(&mut self) {
        let newest = lock(&self.received).clone().filter(|(at, _)| at.elapsed() < EXPIRY);
        let text = newest.map(|(_, text)| text).unwrap_or_default();
        if text != self.compared {
            self.problem = if text.is_empty() { None } else { self.compare(&text) };
            self.compared = text;
        }
    }

    /// Why the room's geometry is not that of this controller; `None` if it is, or if no simulator
    /// announces one.
    pub fn problem(&self) -> Option<&str> {
        self.problem.as_deref()
    }

    fn compare(&self, text: &str) -> Option<String> {
        match Scenario::from_geometry_toml(text) {
            Ok(room) => self.own.geometry_difference(&room).as_ref().map(describe),
            Err(error) => {
                Some(format!("the geometry that the room announces is refused: {}", printable(&error.in_one_line())))
            }
        }
    }
}

fn describe(difference: &GeometryDifference) -> String {
    let GeometryDifference { key, here, there } = difference;
    format!(
        "room and controller differ: {key} is {} in the room and {} in this controller; start both with the same --scenario and --set",
        shown(there),
        shown(here)
    )
}

fn shown(text: &str) -> String {
    printable(text).chars().take(VALUE_CHARACTERS).collect()
}
