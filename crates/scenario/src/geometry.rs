//! Geometry and channel of a room as text: what a viewer needs to draw the room and to compute gains.
//!
//! The text is part of a scenario file. It comes from other processes, so it is read with the checks
//! of a scenario file, and holds no key that names a file.

use serde::{Deserialize, Serialize};

use crate::error::ScenarioError;
use crate::mirror_tables::MirrorTables;
use crate::scenario::{Scenario, parse, with_line};
use crate::tables::{Blockage, Channel, Led, Link, NoiseBudget, Receiver, Room, Users};

/// The keys of a scenario that a geometry holds.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct Geometry {
    name: String,
    room: Room,
    channel: Channel,
    led: Led,
    mirrors: MirrorTables,
    receiver: Receiver,
    noise: NoiseBudget,
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
        let geometry: Geometry = parse("room geometry", text)?;
        let scenario = geometry.into_scenario();
        scenario.check().map_err(|error| with_line(error, text))?;
        Ok(scenario)
    }
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
    pub(crate) fn of(scenario: &Scenario) -> Self {
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
