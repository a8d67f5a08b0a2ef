//! The scenario: one checked value for all tables, read from TOML.

use heliostat_files::{TomlError, from_toml};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::blame;
use crate::builtin;
use crate::error::ScenarioError;
use crate::lines::line_of;
use crate::lists;
use crate::mirror_tables::MirrorTables;
use crate::mismatch::Mismatch;
use crate::overrides;
use crate::renames::{REMOVED, RENAMES, Renames};
use crate::runtime::{Actuator, Control};
use crate::streams::Streams;
use crate::tables::{Blockage, Channel, Led, Link, MinRate, NoiseBudget, PowerLaw, Receiver, Room, Users};

/// The description of one room; the files in deploy/scenarios explain every key.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Scenario {
    /// Name in reports and summaries.
    pub name: String,
    /// Seed of every random choice in the room.
    pub seed: u64,
    /// Dimensions of the room.
    pub room: Room,
    /// Channel mode and interpretation of the equations.
    pub channel: Channel,
    /// The LEDs on the ceiling.
    pub led: Led,
    /// The mirror arrays.
    pub mirrors: MirrorTables,
    /// The users' receiver.
    pub receiver: Receiver,
    /// Noise of one detector.
    pub noise: NoiseBudget,
    /// The shared bandwidth.
    pub link: Link,
    /// The users: number, speed, minimum rates.
    pub users: Users,
    /// Obstacles and bodies that block light.
    pub blockage: Blockage,
    /// The dynamics of the mirrors.
    pub actuator: Actuator,
    /// Rates, latencies and noise of the reports.
    pub streams: Streams,
    /// Limits and degraded modes of the controller.
    pub control: Control,
    /// How the true room differs from the one that all other tables describe.
    pub mismatch: Mismatch,
}

impl Default for Scenario {
    fn default() -> Self {
        Self {
            name: "specular".into(),
            seed: 1,
            room: Room::default(),
            channel: Channel::default(),
            led: Led::default(),
            mirrors: MirrorTables::default(),
            receiver: Receiver::default(),
            noise: NoiseBudget::default(),
            link: Link::default(),
            users: Users::default(),
            blockage: Blockage::default(),
            actuator: Actuator::default(),
            streams: Streams::default(),
            control: Control::default(),
            mismatch: Mismatch::default(),
        }
    }
}

impl Scenario {
    /// Reads a scenario from the text of a file.
    ///
    /// # Errors
    /// [`ScenarioError`] for text that is not TOML, for an unknown or renamed key, and for a value
    /// outside its domain. The message states line, key, value and the expected values.
    pub fn from_toml(text: &str) -> Result<Self, ScenarioError> {
        Self::from_toml_with::<&str>(text, &[])
    }

    /// Reads a scenario and applies overrides of the form `table.key=value`, as `--set` does.
    ///
    /// # Errors
    /// As [`Scenario::from_toml`]; for an override the message states the override instead of the
    /// line.
    pub fn from_toml_with<S: AsRef<str>>(text: &str, overrides: &[S]) -> Result<Self, ScenarioError> {
        lists::refuse_long(text)?;
        let mut table: toml::Table = parse("scenario", text)?;
        let refused = Renames(RENAMES).refuse(&table).and_then(|()| lists::refuse_in_place_of_tables(&table));
        refused.map_err(|error| with_line(error, text))?;
        // Parsed without the overrides, so that an error in the file states its line.
        let parsed: Self = parse("scenario", text)?;
        let of_file = parsed.check();
        if overrides.is_empty() {
            let blamed = |error| with_line(blame::of_written(error, &table, &blame::keys(&table)), text);
            of_file.map_err(blamed)?;
            return Ok(parsed);
        }
        // The keys of a file that is valid alone, such as a built-in one, are not at fault.
        let mut written = if of_file.is_ok() { Vec::new() } else { blame::keys(&table) };
        let overrides: Vec<&str> = overrides.iter().map(AsRef::as_ref).collect();
        written.extend(overrides.iter().map(|text| blame::key_of_override(text)));
        for text in &overrides {
            overrides::apply(&mut table, text)?;
        }
        Renames(RENAMES).refuse(&table)?;
        lists::refuse_in_place_of_tables(&table)?;
        let scenario = parse_table(&overrides.join(", "), &table);
        let scenario = scenario.map_err(|error| blame::of_type(error, &table, &written))?;
        scenario.check().map_err(|error| blame::of_written(error, &table, &written))?;
        Ok(scenario)
    }

    /// Reads the scenario of a recording, in which [`RENAMES`] replaces old keys and values by new
    /// ones. Values that were removed are replaced too.
    ///
    /// # Errors
    /// As [`Scenario::from_toml`], except that old names and removed values are accepted.
    pub fn from_recorded_toml(text: &str) -> Result<Self, ScenarioError> {
        let recorded = "recorded scenario";
        let mut table: toml::Table = parse(recorded, text)?;
        Renames(RENAMES).apply(&mut table);
        Renames(REMOVED).apply(&mut table);
        let scenario = parse_table(recorded, &table)?;
        scenario.check().map_err(|error| with_line(error, text))?;
        Ok(scenario)
    }

    /// The text of a built-in scenario, with a comment on every key.
    ///
    /// # Errors
    /// [`ScenarioError::UnknownBuiltin`] for any other name.
    pub fn builtin_text(name: &str) -> Result<&'static str, ScenarioError> {
        builtin::text(name).ok_or_else(|| ScenarioError::UnknownBuiltin { name: name.into() })
    }

    /// A built-in scenario by name.
    ///
    /// # Errors
    /// [`ScenarioError::UnknownBuiltin`] for a name that is not in
    /// [`BUILTIN_NAMES`](crate::BUILTIN_NAMES).
    pub fn builtin(name: &str) -> Result<Self, ScenarioError> {
        Self::from_toml(Self::builtin_text(name)?)
    }

    /// This scenario with overrides of the form `table.key=value`.
    ///
    /// # Errors
    /// [`ScenarioError`] that states the override or the key.
    pub fn with_overrides<S: AsRef<str>>(&self, overrides: &[S]) -> Result<Self, ScenarioError> {
        Self::from_toml_with(&self.to_toml(), overrides)
    }

    /// The effective configuration as TOML, with every key.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("every table of a scenario has a TOML form")
    }

    /// The effective configuration as [`Scenario::to_toml`], with the name of a recorded walk in place of
    /// its path, which depends on the folder of each process.
    pub fn to_shared_toml(&self) -> String {
        let mut shared = self.clone();
        shared.users.trace = self.trace_name();
        shared.to_toml()
    }

    /// The first 16 hexadecimal digits of the SHA-256 of [`Scenario::to_shared_toml`].
    pub fn hash(&self) -> String {
        Self::hash_of(&self.to_shared_toml())
    }

    /// The hash of an effective configuration from its text, such as that of a recording.
    ///
    /// Keys and defaults that were added later do not change it.
    pub fn hash_of(effective: &str) -> String {
        short_hash(effective)
    }

    /// A hash of the optical geometry, which determines the effect of mirror angles.
    ///
    /// It includes room, LEDs, array, receiver and channel mode, but not power, noise,
    /// bandwidth and users. Trained actors contain this hash, so the keys of these tables must keep
    /// their names.
    pub fn geometry_hash(&self) -> String {
        #[derive(Serialize)]
        struct Geometry<'a> {
            room: &'a Room,
            channel: Channel,
            led: Led,
            mirrors: &'a MirrorTables,
            receiver: &'a Receiver,
        }
        let geometry = Geometry {
            room: &self.room,
            channel: Channel { power_law: PowerLaw::Linear, ..self.channel.clone() },
            led: Led { power_w: 1.0, ..self.led.clone() },
            mirrors: &self.mirrors,
            receiver: &self.receiver,
        };
        short_hash(toml::to_string(&geometry).expect("every table of a scenario has a TOML form"))
    }

    /// Number of mirrors of all arrays.
    pub fn mirror_count(&self) -> usize {
        self.mirrors.count()
    }

    /// Whether users hold their receivers tilted, at random angles.
    pub fn has_tilted_receivers(&self) -> bool {
        self.users.orientations().iter().any(|(_, held)| held.is_some())
    }

    /// The deadline of a decision after the arrival of its report, in s: `control.deadline_ms`, or the time between two
    /// position reports.
    pub fn decision_deadline_s(&self) -> f64 {
        match self.control.deadline_ms {
            0.0 => 1.0 / self.streams.positions.rate_hz,
            milliseconds => 1e-3 * milliseconds,
        }
    }

    /// Minimum rate of each user in bit/s. Shape: K.
    pub fn min_rate_bps(&self) -> Vec<f64> {
        match &self.users.min_rate_mbps {
            MinRate::All(rate) => vec![rate * 1e6; self.users.count],
            MinRate::Each(rates) => rates.iter().map(|rate| rate * 1e6).collect(),
        }
    }
}

/// The first 16 digits of the SHA-256 of a text or of the bytes of a file, as `sha256sum` prints them.
pub fn short_hash(content: impl AsRef<[u8]>) -> String {
    Sha256::digest(content).iter().take(8).map(|byte| format!("{byte:02x}")).collect()
}

/// Reads a text of TOML; an error names where it is from.
pub(crate) fn parse<T: DeserializeOwned>(origin: &str, text: &str) -> Result<T, ScenarioError> {
    from_toml(text).map_err(|reason| ScenarioError::Parse { origin: origin.into(), reason })
}

/// The scenario of a table that is no text of a user; an error names the key, and no line.
fn parse_table(origin: &str, table: &toml::Table) -> Result<Scenario, ScenarioError> {
    let text = toml::to_string(table).expect("every table has a TOML form");
    from_toml(&text)
        .map_err(|reason: TomlError| ScenarioError::Parse { origin: origin.into(), reason: reason.without_line() })
}

/// Adds the line of the refused key, if the file sets it.
pub(crate) fn with_line(error: ScenarioError, text: &str) -> ScenarioError {
    match error {
        ScenarioError::Invalid { key, value, expected, line: None } => {
            let line = line_of(text, &key);
            ScenarioError::Invalid { key, value, expected, line }
        }
        ScenarioError::Renamed { found, expected, line: None } => {
            let line = line_of(text, &found);
            ScenarioError::Renamed { found, expected, line }
        }
        other => other,
    }
}
