//! The room that a viewer draws: the geometry that a process announces, or a scenario.
//!
//! In order of priority: the scenario that the user gave, the simulator's announcement, the
//! controller's, the default scenario. Announcements are text of other processes, so a refused one
//! is reported and the next of the list is drawn.

use std::sync::{Arc, Mutex};

use heliostat_channel::{ChannelError, ChannelModel};
use heliostat_scenario::{GeometryDifference, RoomDifference, Scenario};
use heliostat_service::locks::lock;
use heliostat_service::printable::printable;
use serde::Serialize;

/// Longest text of a value or a reason in a note, in characters.
const TEXT_CHARACTERS: usize = 160;

/// Where the drawn geometry comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum GeometrySource {
    /// The user gave a scenario.
    Given,
    /// The simulator announced it.
    SimNode,
    /// The controller announced it.
    Controller,
    /// The default scenario: no process announces a geometry.
    Default,
}

/// A room as it is drawn.
#[derive(Debug)]
pub(crate) struct ShownRoom {
    /// The hash of the geometry.
    pub id: String,
    pub source: GeometrySource,
    pub scenario: Scenario,
    pub model: ChannelModel,
}

impl ShownRoom {
    fn new(source: GeometrySource, scenario: Scenario) -> Result<Self, ChannelError> {
        let model = scenario.channel_model()?;
        Ok(Self { id: Scenario::hash_of(&scenario.geometry_toml()), source, scenario, model })
    }
}

/// What a controller announces.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct AnnouncedController {
    pub name: String,
    /// Its geometry, as TOML.
    pub geometry: Arc<str>,
    /// The hash of its scenario, by its status; empty where it is unknown.
    pub scenario: String,
}

/// The geometries that the processes of a room announce, as TOML.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Announcements {
    pub sim_node: Option<Arc<str>>,
    /// The hash of the simulator's scenario, by its status; empty where it is unknown or old.
    pub sim_node_scenario: String,
    /// Of the controller that is drawn.
    pub controller: Option<Arc<str>>,
    /// Those of each controller that are not old: a standby can have another geometry.
    pub of_controllers: Vec<AnnouncedController>,
    /// Whether the simulator's announcement is old: it is drawn, and no warning follows from it.
    pub is_sim_node_old: bool,
    /// Whether the controller's announcement is old.
    pub is_controller_old: bool,
}

/// Chooses the room to draw, and keeps it until an announcement changes.
pub(crate) struct RoomChooser {
    given: Option<Arc<ShownRoom>>,
    fallback: Arc<ShownRoom>,
    chosen: Mutex<Chosen>,
}

/// What a viewer shows in words.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Findings {
    /// What is wrong, with what to do.
    pub notes: Vec<String>,
    /// How a controller differs from the room without a fault: measured values, or other keys than the geometry.
    pub remarks: Vec<String>,
}

/// The choice for some announcements.
struct Chosen {
    announcements: Announcements,
    room: Arc<ShownRoom>,
    findings: Findings,
}

impl RoomChooser {
    /// A chooser that always draws the given scenario, if there is one.
    ///
    /// # Errors
    /// A scenario that the channel model refuses.
    pub fn new(given: Option<&Scenario>) -> Result<Self, ChannelError> {
        let given = given.map(|scenario| ShownRoom::new(GeometrySource::Given, scenario.clone())).transpose()?;
        let given = given.map(Arc::new);
        let fallback = Arc::new(ShownRoom::new(GeometrySource::Default, Scenario::default())?);
        let room = Arc::clone(given.as_ref().unwrap_or(&fallback));
        let chosen = Chosen { announcements: Announcements::default(), room, findings: Findings::default() };
        Ok(Self { given, fallback, chosen: Mutex::new(chosen) })
    }

    /// The room to draw, and what else the announcements show.
    pub fn choose(&self, announcements: Announcements) -> (Arc<ShownRoom>, Findings) {
        let mut chosen = lock(&self.chosen);
        if chosen.announcements != announcements {
            let (room, findings) = self.evaluate(&announcements);
            // An unchanged room keeps its identity, so that the views of it stay.
            if room.id != chosen.room.id || room.source != chosen.room.source {
                chosen.room = room;
            }
            chosen.findings = findings;
            chosen.announcements = announcements;
        }
        (Arc::clone(&chosen.room), chosen.findings.clone())
    }

    fn evaluate(&self, announcements: &Announcements) -> (Arc<ShownRoom>, Findings) {
        let Findings { mut notes, mut remarks } = Findings::default();
        let Announcements { sim_node, sim_node_scenario, controller, of_controllers, .. } = announcements;
        let Announcements { is_sim_node_old, is_controller_old, .. } = announcements;
        let read = |source, text: &str| {
            let scenario = Scenario::from_geometry_toml(text).map_err(|error| error.to_string())?;
            ShownRoom::new(source, scenario).map(Arc::new).map_err(|error| error.to_string())
        };
        let refused =
            |node: &str, reason: &str| format!("the geometry that {node} announces is refused: {}", shown(reason));
        let sim_node = sim_node.as_deref().and_then(|text| {
            let room = read(GeometrySource::SimNode, text);
            let noted = room.as_ref().err().filter(|_| !is_sim_node_old);
            notes.extend(noted.map(|reason| refused("sim-node", reason)));
            room.ok()
        });
        let controller = controller.as_deref().and_then(|text| read(GeometrySource::Controller, text).ok());
        for AnnouncedController { name, geometry, scenario } in of_controllers {
            let own = match read(GeometrySource::Controller, geometry) {
                Ok(own) => own,
                Err(reason) => {
                    notes.push(refused(&format!("controller {name}"), &reason));
                    continue;
                }
            };
            let Some(room) = sim_node.as_ref().filter(|_| !is_sim_node_old) else { continue };
            match own.scenario.room_difference(&room.scenario, &format!("the controller {name}")) {
                Some(RoomDifference::Problem(text)) => notes.push(printable(&text).into_owned()),
                Some(RoomDifference::Measured(text)) => remarks.push(printable(&text).into_owned()),
                None => remarks.extend(other_keys(name, scenario, sim_node_scenario)),
            }
        }
        let is_announced_old = if sim_node.is_some() { *is_sim_node_old } else { *is_controller_old };
        let announced = sim_node.or(controller);
        if let (Some(given), Some(announced)) = (&self.given, &announced)
            && !is_announced_old
            && let Some(GeometryDifference { key, here, there, .. }) =
                announced.scenario.geometry_difference(&given.scenario)
        {
            notes.push(format!(
                "the picture shows another room: {key} is {} in the room and {} in the scenario of this viewer",
                shown(&here),
                shown(&there)
            ));
        }
        let room = self.given.clone().or(announced).unwrap_or_else(|| Arc::clone(&self.fallback));
        (room, Findings { notes, remarks })
    }
}

/// The remark on a controller with the geometry of the room and the hash of another scenario.
fn other_keys(name: &str, scenario: &str, of_room: &str) -> Option<String> {
    let differs = !scenario.is_empty() && !of_room.is_empty() && scenario != of_room;
    differs.then(|| {
        format!(
            "the controller {name} uses scenario {}, and the room {}: their geometry is the same, but other keys \
             differ, for example in [users] or [control]; unless this is intended, start both with the same \
             --scenario, --set and --seed",
            shown(scenario),
            shown(of_room)
        )
    })
}

/// A text of another process, cut and safe for a terminal.
fn shown(text: &str) -> String {
    printable(text).chars().take(TEXT_CHARACTERS).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(overrides: &[&str]) -> Scenario {
        Scenario::default().with_overrides(overrides).expect("valid overrides")
    }

    fn text(overrides: &[&str]) -> Option<Arc<str>> {
        Some(with(overrides).geometry_toml().into())
    }

    /// A controller of the scenario `own`.
    fn controllers(geometry: Option<Arc<str>>) -> Vec<AnnouncedController> {
        let announced = |geometry| AnnouncedController { name: "c1".to_owned(), geometry, scenario: "own".to_owned() };
        geometry.into_iter().map(announced).collect()
    }

    fn rows(
        chooser: &RoomChooser,
        sim_node: Option<Arc<str>>,
        controller: Option<Arc<str>>,
    ) -> (usize, GeometrySource) {
        let (room, _) = chooser.choose(Announcements { sim_node, controller, ..Announcements::default() });
        (room.model.mirrors.arrays()[0].rows(), room.source)
    }

    #[test]
    fn the_rooms_announcement_comes_before_the_controllers_and_both_before_the_default() {
        let chooser = RoomChooser::new(None).expect("the default is valid");
        assert_eq!(rows(&chooser, None, None), (10, GeometrySource::Default));
        assert_eq!(rows(&chooser, None, text(&["mirrors.rows=8"])), (8, GeometrySource::Controller));
        assert_eq!(rows(&chooser, text(&["mirrors.rows=6"]), text(&["mirrors.rows=8"])), (6, GeometrySource::SimNode));
        assert_eq!(rows(&chooser, text(&["mirrors.rows=4"]), None), (4, GeometrySource::SimNode));
        let given = RoomChooser::new(Some(&with(&["mirrors.rows=3"]))).expect("a valid scenario");
        assert_eq!(rows(&given, text(&["mirrors.rows=6"]), None), (3, GeometrySource::Given));
    }

    #[test]
    fn the_same_announcement_keeps_the_room_and_another_one_replaces_it() {
        let chooser = RoomChooser::new(None).expect("the default is valid");
        let choose = |overrides: &[&str]| {
            chooser.choose(Announcements { sim_node: text(overrides), ..Announcements::default() }).0
        };
        let (first, again, other) = (choose(&[]), choose(&[]), choose(&["room.height_m=4"]));
        assert!(Arc::ptr_eq(&first, &again) && !Arc::ptr_eq(&first, &other));
        assert_ne!(first.id, other.id);
    }

    #[test]
    fn differences_and_refused_announcements_are_noted_with_the_key() {
        let notes = |given: Option<&Scenario>, sim_node, controller: Option<Arc<str>>| {
            let chooser = RoomChooser::new(given).expect("a valid scenario");
            let of_controllers = controllers(controller);
            chooser.choose(Announcements { sim_node, of_controllers, ..Announcements::default() }).1.notes.join("\n")
        };
        assert_eq!(notes(None, text(&[]), text(&["users.count=2"])), "");
        assert_eq!(
            notes(None, text(&[]), text(&["mirrors.rows=8"])),
            "room and controller differ: mirrors.rows is 10 in the room and 8 in the controller c1; start both \
             with the same --scenario and --set"
        );
        assert_eq!(
            notes(Some(&with(&["room.height_m=4"])), text(&[]), None),
            "the picture shows another room: room.height_m is 3.0 in the room and 4.0 in the scenario of this viewer"
        );
        let refused = notes(None, Some("[users]\ntrace = \"a\"".into()), None);
        let start =
            "the geometry that sim-node announces is refused: room geometry: line 1: users: unknown field `users`";
        assert!(refused.starts_with(start), "{refused}");
        let escape = notes(None, Some("[\"\\u001b[2J\"]\na = 1".into()), None);
        assert!(escape.contains("unknown field") && !escape.contains('\u{1b}'), "{escape:?}");
        let hidden = notes(None, Some("[led]\npositions_m = [[0, 0, 3]]\n[mirrors]\nrows = 0".into()), None);
        assert!(hidden.contains("mirrors.rows = 0"), "{hidden}");
    }

    #[test]
    fn a_controller_with_a_measured_room_is_a_remark_and_no_note() {
        let chooser = RoomChooser::new(None).expect("the default is valid");
        let of_controllers = controllers(text(&["room.height_m=3.02"]));
        let sim_node_scenario = "other".to_owned();
        let announcements =
            Announcements { sim_node: text(&[]), sim_node_scenario, of_controllers, ..Announcements::default() };
        let remark = "the controller c1 differs from the room only in what heliostat calibrate measures: \
                      room.height_m. Most: room.height_m is 3.0 in the room and 3.02 in the controller c1";
        let expected = Findings { notes: Vec::new(), remarks: vec![remark.to_owned()] };
        assert_eq!(chooser.choose(announcements).1, expected);
    }

    #[test]
    fn another_scenario_with_the_same_geometry_is_a_remark_and_with_another_geometry_only_the_note() {
        let chooser = RoomChooser::new(None).expect("the default is valid");
        let found = |sim_node_scenario: &str, controller, is_sim_node_old| {
            let (sim_node, sim_node_scenario) = (text(&[]), sim_node_scenario.to_owned());
            let of_controllers = controllers(controller);
            let rest = Announcements { is_sim_node_old, ..Announcements::default() };
            chooser.choose(Announcements { sim_node, sim_node_scenario, of_controllers, ..rest }).1
        };
        let remark = "the controller c1 uses scenario own, and the room other: their geometry is the same, but other \
                      keys differ, for example in [users] or [control]; unless this is intended, start both with the \
                      same --scenario, --set and --seed";
        let expected = Findings { notes: Vec::new(), remarks: vec![remark.to_owned()] };
        assert_eq!(found("other", text(&[]), false), expected);
        assert_eq!(found("own", text(&[]), false), Findings::default(), "one scenario");
        assert_eq!(found("", text(&[]), false), Findings::default(), "the status of the simulator does not come");
        assert_eq!(found("other", text(&[]), true), Findings::default(), "the simulator has left");
        let differs = found("other", text(&["mirrors.rows=8"]), false);
        assert_eq!((differs.notes.len(), differs.remarks.len()), (1, 0), "{differs:?}");
    }

    #[test]
    fn no_warning_follows_from_what_a_process_announced_that_has_left() {
        let given = with(&["room.height_m=4"]);
        let choose =
            |given: Option<&Scenario>, controller: Option<Arc<str>>, is_sim_node_old: bool, is_controller_old: bool| {
                let chooser = RoomChooser::new(given).expect("a valid scenario");
                let sim_node = text(&["mirrors.rows=6"]);
                let of_controllers = controllers(controller.clone().filter(|_| !is_controller_old));
                let sides = Announcements { sim_node, controller, of_controllers, ..Announcements::default() };
                let announcements = Announcements { is_sim_node_old, is_controller_old, ..sides };
                let (room, findings) = chooser.choose(announcements);
                (room.model.mirrors.arrays()[0].rows(), findings.notes.len())
            };
        let other = || text(&["mirrors.rows=8"]);
        let refused = || Some(Arc::from("[users]\ntrace = \"a\""));
        assert_eq!(choose(None, other(), false, false), (6, 1), "both are in the room");
        assert_eq!(choose(None, other(), false, true), (6, 0), "the controller has left");
        assert_eq!(choose(None, other(), true, true), (6, 0), "the last picture stays");
        assert_eq!([choose(None, refused(), false, false).1, choose(None, refused(), false, true).1], [1, 0]);
        assert_eq!([choose(Some(&given), None, false, false).1, choose(Some(&given), None, true, true).1], [1, 0]);
    }
}
