//! The description of one room: what it looks like, who walks in it, and how its parts talk.
//!
//! A scenario is read once, from TOML, into a [`Scenario`] that cannot be invalid: unknown keys are refused by name, every
//! value is checked against its domain, and each refusal names the key, the value, the line and what was wanted.
//! Simulator, controller and trainer read the same file.
//!
//! [`ScenarioArgs`], the flags that every command shares, and [`Scenario::read_trace`] open files; all else works on text.
//!
//! # Tables
//! [`tables`] holds what does not change while a room runs, [`runtime`] the actuators, report streams and limits.
//!
//! # From file to physics
//! [`Scenario::channel_model`] turns degrees and millimetres into the types of `heliostat-channel`.

mod args;
mod build;
mod check;
mod error;
pub mod runtime;
pub mod tables;
mod trace;

pub use args::ScenarioArgs;
pub use check::{MIRRORS_MAX, USERS_MAX};
pub use error::ScenarioError;
pub use runtime::*;
pub use tables::*;
pub use trace::TraceFileError;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

/// The names of the built-in scenarios; the first is the default.
pub const BUILTIN_NAMES: [&str; 4] = ["specular", "paper", "paper-calibrated", "hall"];

/// One room. See the files in deploy/scenarios for every key with its meaning.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Scenario {
    /// What reports and summaries call it.
    pub name: String,
    /// Seed of every random choice in the room.
    pub seed: u64,
    /// The room's box.
    pub room: Room,
    /// The channel mode.
    pub channel: Channel,
    /// The access points.
    pub led: Led,
    /// The mirror array.
    pub mirrors: Mirrors,
    /// The users' receiver.
    pub receiver: Receiver,
    /// The noise of a detector.
    pub noise: Noise,
    /// The shared band.
    pub link: Link,
    /// The people.
    pub users: Users,
    /// What stands in the light.
    pub blockage: Blockage,
    /// How mirrors follow commands.
    pub actuator: Actuator,
    /// What the room publishes.
    pub streams: Streams,
    /// The controller's limits.
    pub control: Control,
}

impl Default for Scenario {
    fn default() -> Self {
        Self {
            name: "specular".into(),
            seed: 1,
            room: Room::default(),
            channel: Channel::default(),
            led: Led::default(),
            mirrors: Mirrors::default(),
            receiver: Receiver::default(),
            noise: Noise::default(),
            link: Link::default(),
            users: Users::default(),
            blockage: Blockage::default(),
            actuator: Actuator::default(),
            streams: Streams::default(),
            control: Control::default(),
        }
    }
}

impl Scenario {
    /// Reads a scenario from the text of a file.
    ///
    /// # Errors
    /// [`ScenarioError`] that names the line, the key and what was wanted.
    pub fn from_toml(text: &str) -> Result<Self, ScenarioError> {
        Self::from_toml_with(text, &[])
    }

    /// Reads a scenario and lays overrides of the form `table.key=value` over it, as `--set` does.
    ///
    /// # Errors
    /// [`ScenarioError`] that names the line or the override, the key and what was wanted.
    pub fn from_toml_with(text: &str, overrides: &[String]) -> Result<Self, ScenarioError> {
        // Parsed once without the overrides, so that a mistake in the file is told with its line.
        let parsed: Self = toml::from_str(text).map_err(|error| parse_error("scenario", &error))?;
        if overrides.is_empty() {
            parsed.check().map_err(|error| with_line(error, text))?;
            return Ok(parsed);
        }
        let mut table: toml::Table = toml::from_str(text).map_err(|error| parse_error("scenario", &error))?;
        for text in overrides {
            apply_override(&mut table, text)?;
        }
        let scenario: Self = table
            .try_into()
            .map_err(|error: toml::de::Error| parse_error(&format!("--set {}", overrides.join(" --set ")), &error))?;
        scenario.check()?;
        Ok(scenario)
    }

    /// The text of a built-in scenario, with a comment on every key.
    ///
    /// # Errors
    /// [`ScenarioError::UnknownBuiltin`] for any other name.
    pub fn builtin_text(name: &str) -> Result<&'static str, ScenarioError> {
        match name {
            "specular" => Ok(include_str!("../../deploy/scenarios/specular.toml")),
            "paper" => Ok(include_str!("../../deploy/scenarios/paper.toml")),
            "paper-calibrated" => Ok(include_str!("../../deploy/scenarios/paper-calibrated.toml")),
            "hall" => Ok(include_str!("../../deploy/scenarios/hall.toml")),
            _ => Err(ScenarioError::UnknownBuiltin { name: name.into() }),
        }
    }

    /// A built-in scenario by name.
    ///
    /// # Errors
    /// [`ScenarioError::UnknownBuiltin`] for a name that is not in [`BUILTIN_NAMES`].
    pub fn builtin(name: &str) -> Result<Self, ScenarioError> {
        Self::from_toml(Self::builtin_text(name)?)
    }

    /// The same scenario with overrides of the form `table.key=value`.
    ///
    /// # Errors
    /// [`ScenarioError`] that names the override or key.
    pub fn with_overrides(&self, overrides: &[String]) -> Result<Self, ScenarioError> {
        Self::from_toml_with(&self.to_toml(), overrides)
    }

    /// The effective configuration as TOML, every key written out.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("every table of a scenario has a TOML form")
    }

    /// The first 16 hexadecimal digits of the SHA-256 of the effective configuration.
    pub fn hash(&self) -> String {
        Self::hash_of(&self.to_toml())
    }

    /// The hash of a configuration whose effective text is kept elsewhere; defaults that joined since leave it alone.
    pub fn hash_of(effective: &str) -> String {
        short_hash(effective)
    }

    /// A hash of what fixes the optical geometry and with it the meaning of a mirror angle: room, access points, array,
    /// receiver and channel mode. Power, noise, bandwidth and everything about users is left out.
    pub fn geometry_hash(&self) -> String {
        #[derive(Serialize)]
        struct Geometry<'a> {
            room: &'a Room,
            channel: Channel,
            led: Led,
            mirrors: &'a Mirrors,
            receiver: &'a Receiver,
        }
        let geometry = Geometry {
            room: &self.room,
            channel: Channel { power_law: PowerLaw::Linear, ..self.channel.clone() },
            led: Led { power_w: 1.0, ..self.led.clone() },
            mirrors: &self.mirrors,
            receiver: &self.receiver,
        };
        short_hash(&toml::to_string(&geometry).expect("every table of a scenario has a TOML form"))
    }

    /// How many mirrors the array has.
    pub fn mirror_count(&self) -> usize {
        self.mirrors.rows * self.mirrors.columns
    }

    /// The minimum rate of each user in bit/s.
    pub fn min_rate_bps(&self) -> Vec<f64> {
        match &self.users.min_rate_mbps {
            MinRate::All(rate) => vec![rate * 1e6; self.users.count],
            MinRate::Each(rates) => rates.iter().map(|rate| rate * 1e6).collect(),
        }
    }
}

fn short_hash(text: &str) -> String {
    Sha256::digest(text).iter().take(8).map(|byte| format!("{byte:02x}")).collect()
}

fn parse_error(origin: &str, error: &toml::de::Error) -> ScenarioError {
    ScenarioError::Parse { origin: origin.into(), message: error.to_string().trim_end().into() }
}

/// Lays one `table.key=value` over a table; a value that is not TOML is taken as a string.
fn apply_override(table: &mut toml::Table, text: &str) -> Result<(), ScenarioError> {
    let refused = || ScenarioError::Override { text: text.into() };
    let (path, value) = text.split_once('=').ok_or_else(refused)?;
    let value = value.trim();
    let value = toml::from_str::<toml::Table>(&format!("value = {value}"))
        .ok()
        .and_then(|mut parsed| parsed.remove("value"))
        .unwrap_or_else(|| toml::Value::String(value.into()));
    let mut keys: Vec<&str> = path.trim().split('.').collect();
    let last = keys.pop().filter(|key| !key.is_empty()).ok_or_else(refused)?;
    let mut table = table;
    for key in keys {
        let entry = table.entry(key).or_insert_with(|| toml::Value::Table(toml::Table::new()));
        table = entry.as_table_mut().ok_or_else(refused)?;
    }
    // Whole numbers are welcome where the key holds a real one.
    let value = match (table.get(last), value) {
        (Some(toml::Value::Float(_)), toml::Value::Integer(whole)) => toml::Value::Float(whole as f64),
        (_, value) => value,
    };
    table.insert(last.into(), value);
    Ok(())
}

/// Adds the line on which the refused key stands, where it stands in the file.
fn with_line(error: ScenarioError, text: &str) -> ScenarioError {
    match error {
        ScenarioError::Invalid { key, value, wanted, line: None } => {
            let line = line_of(text, &key);
            ScenarioError::Invalid { key, value, wanted, line }
        }
        other => other,
    }
}

/// The line of the file that sets `table.key`, counted from 1.
fn line_of(text: &str, key: &str) -> Option<usize> {
    let document = toml::de::DeTable::parse(text).ok()?;
    let mut keys = key.split(' ').next()?.split('.');
    let first = keys.next()?;
    let mut found = document.get_ref().get_key_value(first)?;
    for key in keys {
        match found.1.get_ref().as_table().and_then(|table| table.get_key_value(key)) {
            Some(entry) => found = entry,
            None => break,
        }
    }
    Some(text[..found.0.span().start].matches('\n').count() + 1)
}
