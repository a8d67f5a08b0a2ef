//! Geometry and channel of a room as text: what a viewer needs to draw the room and to compute gains.
//!
//! The text is part of a scenario file. It comes from other processes, so it is read with the checks
//! of a scenario file, and holds no key that names a file.

use serde::{Deserialize, Serialize};

use crate::error::ScenarioError;
use crate::mirror_tables::MirrorTables;
use crate::scenario::{Scenario, parse_error, with_line};
use crate::tables::{Blockage, Channel, Led, Link, Noise, Receiver, Room, Users};

/// The tables of a geometry, in the order in which a difference is reported.
const TABLES: [&str; 8] = ["room", "led", "mirrors", "receiver", "channel", "noise", "link", "blockage"];

/// Table and key of the values that a calibration of a room measures.
const MEASURED: [(&str, &str); 6] = [
    ("room", "height_m"),
    ("led", "positions_m"),
    ("led", "half_power_semi_angle_deg"),
    ("mirrors", "centre_height_m"),
    ("mirrors", "reflectivity"),
    ("receiver", "area_mm2"),
];

/// Longest text of a value in a sentence, in characters.
const VALUE_CHARACTERS: usize = 60;

/// The keys of a scenario that a geometry holds.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Geometry {
    name: String,
    room: Room,
    channel: Channel,
    led: Led,
    mirrors: MirrorTables,
    receiver: Receiver,
    noise: Noise,
    link: Link,
    blockage: Bodies,
}

/// The users' bodies; obstacles are reported while the room runs.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Bodies {
    bodies: bool,
    body_radius_m: f64,
    body_height_m: f64,
    body_offset_m: f64,
}

/// The first key in which two geometries differ.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GeometryDifference {
    /// `table.key`.
    pub key: String,
    /// Its value in the first one; "none" if it is absent.
    pub here: String,
    /// Its value in the other one.
    pub there: String,
}

impl GeometryDifference {
    /// What to do where room and controller differ so. A calibrated room may: its controller has the measured
    /// values, and a simulator announces the described ones.
    pub fn advice(&self) -> &'static str {
        let is_of = |(table, name): &(&str, &str)| {
            self.key.split('.').next() == Some(*table) && self.key.rsplit('.').next() == Some(*name)
        };
        if MEASURED.iter().any(is_of) {
            "no fault where the controller has the room that heliostat calibrate measured, and a simulator the described \
             one; otherwise start both with the same --scenario and --set"
        } else {
            "start both with the same --scenario and --set"
        }
    }
}

impl Scenario {
    /// Geometry and channel as TOML.
    pub fn geometry_toml(&self) -> String {
        toml::to_string(&Geometry::of(self)).expect("every table of a scenario has a TOML form")
    }

    /// A scenario with this geometry and channel; all other keys have values that suit any geometry.
    ///
    /// # Errors
    /// As [`Scenario::from_toml`]; also for a key of a scenario that a geometry does not hold.
    pub fn from_geometry_toml(text: &str) -> Result<Self, ScenarioError> {
        let geometry: Geometry = toml::from_str(text).map_err(|error| parse_error("room geometry", &error))?;
        let scenario = geometry.into_scenario();
        scenario.check().map_err(|error| with_line(error, text))?;
        Ok(scenario)
    }

    /// Why the geometry that a room announces is not that of this scenario of its controller; `None` if it
    /// is.
    ///
    /// The text can hold characters of the announcement that a terminal executes.
    pub fn announced_problem(&self, announced: &str) -> Option<String> {
        let room = match Self::from_geometry_toml(announced) {
            Ok(room) => room,
            Err(error) => {
                return Some(format!("the geometry that the room announces is refused: {}", error.in_one_line()));
            }
        };
        let difference = self.geometry_difference(&room)?;
        let cut = |text: &str| text.chars().take(VALUE_CHARACTERS).collect::<String>();
        Some(format!(
            "room and controller differ: {} is {} in the room and {} in this controller; {}",
            difference.key,
            cut(&difference.there),
            cut(&difference.here),
            difference.advice()
        ))
    }

    /// The first key in which the geometry differs from that of another scenario; their names may
    /// differ.
    pub fn geometry_difference(&self, other: &Self) -> Option<GeometryDifference> {
        let arrays = [self, other].map(|scenario| scenario.mirrors.arrays().len());
        if arrays[0] != arrays[1] {
            let [here, there] = arrays.map(|count| count.to_string());
            return Some(GeometryDifference { key: "number of mirror arrays".into(), here, there });
        }
        let table = |scenario: &Self| {
            toml::Table::try_from(Geometry::of(scenario)).expect("every table of a scenario has a TOML form")
        };
        let (here, there) = (table(self), table(other));
        TABLES.iter().find_map(|name| match (here.get(*name)?, there.get(*name)?) {
            (toml::Value::Table(here), toml::Value::Table(there)) => table_difference(name, here, there),
            (toml::Value::Array(here), toml::Value::Array(there)) => {
                let mut pairs = here.iter().zip(there).enumerate();
                pairs.find_map(|(index, (here, there))| {
                    table_difference(&format!("{name}.{index}"), here.as_table()?, there.as_table()?)
                })
            }
            _ => None,
        })
    }
}

/// The first key in which two tables of this name differ.
fn table_difference(name: &str, here: &toml::Table, there: &toml::Table) -> Option<GeometryDifference> {
    let key = here.keys().chain(there.keys()).find(|key| here.get(*key) != there.get(*key))?;
    let value = |table: &toml::Table| match table.get(key) {
        None => "none".into(),
        // The shortest form, also for very small numbers.
        Some(toml::Value::Float(number)) => format!("{number:?}"),
        Some(value) => value.to_string(),
    };
    Some(GeometryDifference { key: format!("{name}.{key}"), here: value(here), there: value(there) })
}

impl Default for Geometry {
    fn default() -> Self {
        Self::of(&Scenario::default())
    }
}

impl Default for Bodies {
    fn default() -> Self {
        Self::of(&Blockage::default())
    }
}

impl Bodies {
    fn of(blockage: &Blockage) -> Self {
        let Blockage { bodies, body_radius_m, body_height_m, body_offset_m, .. } = *blockage;
        Self { bodies, body_radius_m, body_height_m, body_offset_m }
    }
}

impl Geometry {
    fn of(scenario: &Scenario) -> Self {
        let Scenario { name, room, channel, led, mirrors, receiver, noise, link, blockage, .. } = scenario.clone();
        let blockage = Bodies::of(&blockage);
        Self { name, room, channel, led, mirrors, receiver, noise, link, blockage }
    }

    fn into_scenario(self) -> Scenario {
        let Self { name, room, channel, led, mirrors, receiver, noise, link, blockage } = self;
        let Bodies { bodies, body_radius_m, body_height_m, body_offset_m } = blockage;
        // One user and no obstacles: the checks of values against each other then accept the
        // geometry of every scenario.
        let blockage = Blockage {
            bodies,
            body_radius_m,
            body_height_m,
            body_offset_m,
            obstacles_per_m2: 0.0,
            obstacle_height_m: 0.0,
            ..Blockage::default()
        };
        let users = Users { count: 1, ..Users::default() };
        Scenario { name, room, channel, led, mirrors, receiver, noise, link, blockage, users, ..Scenario::default() }
    }
}
