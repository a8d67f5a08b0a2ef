//! Compares the geometry that the room announces with that of this controller.
//!
//! None of this is in the decision path.

use heliostat_scenario::{GeometryDifference, Scenario};
use heliostat_service::printable::printable;

/// Longest text of a value in a report, in characters.
const VALUE_CHARACTERS: usize = 60;

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
        self.problem = if text.is_empty() { None } else { self.difference(&text) };
        self.compared = text;
    }

    /// Why the room's geometry is not that of this controller; `None` if it is, or if no simulator
    /// announces one.
    pub fn problem(&self) -> Option<&str> {
        self.problem.as_deref()
    }

    fn difference(&self, text: &str) -> Option<String> {
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
        "room and controller differ: {key} is {} in the room and {} in this controller; {}",
        shown(there),
        shown(here),
        difference.advice()
    )
}

fn shown(text: &str) -> String {
    printable(text).chars().take(VALUE_CHARACTERS).collect()
}
