//! Compares the geometry that the room announces with that of this controller.
//!
//! None of this is in the decision path.

use heliostat_scenario::{RoomDifference, Scenario};
use heliostat_service::printable::printable;

/// Compares the announcements of the room with a scenario.
pub struct GeometryComparison {
    own: Scenario,
    /// The text that was compared last; empty for none.
    compared: String,
    problem: Option<String>,
}

impl GeometryComparison {
    /// With the geometry of a scenario.
    pub fn new(scenario: &Scenario) -> Self {
        Self { own: scenario.clone(), compared: String::new(), problem: None }
    }

    /// The announcement, if it is another one than that which was compared last.
    pub fn changed(&self, announced: Option<&str>) -> Option<String> {
        let text = announced.unwrap_or_default();
        (text != self.compared).then(|| text.to_owned())
    }

    /// Compares an announcement; an empty one is none.
    pub fn compare(&mut self, text: String) {
        let found = if text.is_empty() { None } else { self.own.announced_difference(&text, "this controller") };
        if let Some(RoomDifference::Measured(remark)) = &found {
            tracing::info!("{remark}");
        }
        self.problem = found.and_then(RoomDifference::problem).map(|problem| printable(&problem).into_owned());
        self.compared = text;
    }

    /// Why the room's geometry is not that of this controller; `None` if it is, but for what a calibration
    /// measures, or if no simulator announces one.
    pub fn problem(&self) -> Option<&str> {
        self.problem.as_deref()
    }
}
