//! How two geometries differ, and whether a calibration explains it.

use toml::{Table, Value};

use crate::geometry::Geometry;
use crate::mismatch::{Mismatch, MismatchLevel, Spreads};
use crate::scenario::Scenario;

/// The tables of a geometry, in the order in which a difference is reported.
const TABLES: [&str; 8] = ["room", "led", "mirrors", "receiver", "channel", "noise", "link", "blockage"];

/// Standard deviation of a value of this magnitude around the nominal one.
type Spread = fn(&Spreads, f64) -> f64;

/// Table and key of the values that a calibration of a room measures, with their spread.
const MEASURED: [(&str, &str, Spread); 6] = [
    ("room", "height_m", of_place),
    ("led", "positions_m", of_place),
    ("led", "half_power_semi_angle_deg", |spreads, angle| spreads.semi_angle * angle),
    ("mirrors", "centre_height_m", of_place),
    ("mirrors", "reflectivity", |spreads, reflectivity| spreads.reflectivity_loss * reflectivity),
    ("receiver", "area_mm2", |spreads, area| spreads.received * area),
];

/// Largest difference that a calibration explains, in standard deviations of a rough installation. The estimate of a
/// calibration has the same spreads as its prior.
const DEVIATIONS: f64 = 4.0;

/// Longest text of a value in a sentence, in characters.
const VALUE_CHARACTERS: usize = 60;

/// Beginning of the sentence about geometries of room and controller that differ beyond what a calibration explains.
pub const ROOM_DIFFERS: &str = "room and controller differ";

/// A key in which two geometries differ.
#[derive(Clone, Debug, PartialEq)]
pub struct GeometryDifference {
    /// `table.key`.
    pub key: String,
    /// Its value in the first one; "none" if it is absent.
    pub here: String,
    /// Its value in the other one.
    pub there: String,
    /// Size of the difference in standard deviations of a rough installation, where a calibration measures the key.
    pub deviations: Option<f64>,
}

impl GeometryDifference {
    /// Whether a calibration measures the key, and can find a difference of this size.
    fn is_measured(&self) -> bool {
        self.deviations.is_some_and(|deviations| deviations <= DEVIATIONS)
    }
}

/// How the geometry that a room announces differs from another one, in words. The text can hold characters of
/// the announcement that a terminal executes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RoomDifference {
    /// A fault.
    Problem(String),
    /// No fault: the other one has values as a calibration measures them.
    Measured(String),
}

impl RoomDifference {
    /// The text, where it is a fault.
    pub fn problem(self) -> Option<String> {
        match self {
            Self::Problem(text) => Some(text),
            Self::Measured(_) => None,
        }
    }
}

impl Scenario {
    /// The geometry that a process announces.
    ///
    /// # Errors
    /// In words, why it is refused; `by` names the process.
    pub fn read_announced(announced: &str, by: &str) -> Result<Self, String> {
        Self::from_geometry_toml(announced)
            .map_err(|error| format!("the geometry that {by} announces is refused: {error}"))
    }

    /// How the geometry that a room announces differs from that of this scenario of a controller; `None` if it does
    /// not. `controller` names the controller.
    pub fn announced_difference(&self, announced: &str, controller: &str) -> Option<RoomDifference> {
        match Self::read_announced(announced, "the room") {
            Ok(room) => self.room_difference(&room, controller),
            Err(refused) => Some(RoomDifference::Problem(refused)),
        }
    }

    /// How the geometry of a room differs from that of this scenario of a controller, as
    /// [`announced_difference`](Self::announced_difference).
    pub fn room_difference(&self, room: &Self, controller: &str) -> Option<RoomDifference> {
        self.difference_from_room(room, controller).map(|difference| match difference {
            RoomDifference::Problem(values) => RoomDifference::Problem(format!(
                "{ROOM_DIFFERS}: {values}; start both with the same --scenario and --set"
            )),
            measured @ RoomDifference::Measured(_) => measured,
        })
    }

    /// How the geometry of a room differs from that of this scenario, which `named` names. The text of a fault has the
    /// two values alone.
    pub fn difference_from_room(&self, room: &Self, named: &str) -> Option<RoomDifference> {
        let differences = self.geometry_differences(room);
        if differences.is_empty() {
            return None;
        }
        let cut = |text: &str| text.chars().take(VALUE_CHARACTERS).collect::<String>();
        let values = |GeometryDifference { key, here, there, .. }: &GeometryDifference| {
            format!("{key} is {} in the room and {} in {named}", cut(there), cut(here))
        };
        if let Some(fault) = differences.iter().find(|one| !one.is_measured()) {
            return Some(RoomDifference::Problem(values(fault)));
        }
        let keys: Vec<&str> = differences.iter().map(|one| one.key.as_str()).collect();
        let size = |one: &GeometryDifference| one.deviations.unwrap_or_default();
        let largest = differences.iter().max_by(|a, b| size(a).total_cmp(&size(b)))?;
        Some(RoomDifference::Measured(format!(
            "{named} differs from the room only in what heliostat calibrate measures: {}. Most: {}",
            keys.join(", "),
            values(largest)
        )))
    }

    /// The first key in which the geometry differs from that of another scenario; their names may
    /// differ.
    pub fn geometry_difference(&self, other: &Self) -> Option<GeometryDifference> {
        self.geometry_differences(other).into_iter().next()
    }

    fn geometry_differences(&self, other: &Self) -> Vec<GeometryDifference> {
        let arrays = [self, other].map(|scenario| scenario.mirrors.arrays().len());
        if arrays[0] != arrays[1] {
            let [here, there] = arrays.map(|count| count.to_string());
            return vec![GeometryDifference { key: "number of mirror arrays".into(), here, there, deviations: None }];
        }
        let table = |scenario: &Self| {
            Table::try_from(Geometry::of(scenario)).expect("every table of a scenario has a TOML form")
        };
        let (here, there) = (table(self), table(other));
        let mut found = Vec::new();
        for name in TABLES {
            match (here.get(name), there.get(name)) {
                (Some(Value::Table(here)), Some(Value::Table(there))) => {
                    found.extend(table_differences(name, name, here, there));
                }
                (Some(Value::Array(here)), Some(Value::Array(there))) => {
                    for (index, (here, there)) in here.iter().zip(there).enumerate() {
                        if let (Value::Table(here), Value::Table(there)) = (here, there) {
                            found.extend(table_differences(name, &format!("{name}.{index}"), here, there));
                        }
                    }
                }
                _ => {}
            }
        }
        found
    }
}

/// The keys in which two tables differ; the path of one of several tables has its index.
fn table_differences(table: &str, path: &str, here: &Table, there: &Table) -> Vec<GeometryDifference> {
    let others = there.keys().filter(|key| !here.contains_key(*key));
    let differing = here.keys().chain(others).filter(|key| here.get(*key) != there.get(*key));
    let difference = |key: &String| {
        let (here, there) = (here.get(key), there.get(key));
        GeometryDifference {
            key: format!("{path}.{key}"),
            here: in_words(here),
            there: in_words(there),
            deviations: here.zip(there).and_then(|(here, there)| deviations(table, key, here, there)),
        }
    };
    differing.map(difference).collect()
}

fn in_words(value: Option<&Value>) -> String {
    match value {
        None => "none".into(),
        // The shortest form, also for very small numbers.
        Some(Value::Float(number)) => format!("{number:?}"),
        Some(value) => value.to_string(),
    }
}

/// The largest difference of two values, or of lists of them, in standard deviations; `None` where no calibration
/// measures the key.
fn deviations(table: &str, key: &str, here: &Value, there: &Value) -> Option<f64> {
    let (_, _, spread) = MEASURED.iter().find(|(of, name, _)| *of == table && *name == key)?;
    let spreads = Mismatch { level: MismatchLevel::Rough, ..Mismatch::default() }.spreads();
    largest_ratio(here, there, &|value| spread(&spreads, value))
}

/// The largest difference of two numbers, or of lists of them, as a multiple of the spread at their magnitude.
fn largest_ratio(here: &Value, there: &Value, spread: &dyn Fn(f64) -> f64) -> Option<f64> {
    match (here, there) {
        (Value::Float(here), Value::Float(there)) if here == there => Some(0.0),
        (Value::Float(here), Value::Float(there)) => Some((here - there).abs() / spread(here.abs().max(there.abs()))),
        (Value::Array(here), Value::Array(there)) if here.len() == there.len() => here
            .iter()
            .zip(there)
            .try_fold(0.0, |largest: f64, (here, there)| Some(largest.max(largest_ratio(here, there, spread)?))),
        _ => None,
    }
}

/// Of a coordinate: the measured one is in the frame of the tracker.
fn of_place(spreads: &Spreads, _: f64) -> f64 {
    spreads.led_m + spreads.floor_m
}
